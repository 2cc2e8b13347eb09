"""How often the truth is inside the reported 50 % and 95 % regions (judged modulo symmetry).

Generated problems with true sigmas: contacts drawn on the surface (can: on its side; box: three faces; meshes:
uniform over the area), noise 0.5 mm and 2 degrees per axis, vision off by a Gaussian draw of 20 mm and 15 degrees
root mean square that its covariance states truthfully. The truth is moved along the declared symmetries to the
pose nearest to the answer; it is inside when (δp, δθ)ᵀ information (δp, δθ) is below the χ² quantile with as many
degrees of freedom as the information has directions. YCB meshes are used where the data folder is present.

Grips that contacts bound and do not fix (two fingers and a thumb on opposite sides, contact noise 1.6 mm and 4
degrees, vision off by 64 mm per axis and 10 degrees root mean square; on a table 3 mm in height) are answered by the
default, the mean of the slide, and by the maximum.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.special import chdtri

import handsight as hs
from shared import figures, report, scenes, ycb
from shared.grips import IN_SPACE, ON_TABLE, gripped
from testbed.report import Row, Rows

MESHES = ("006_mustard_bottle", "021_bleach_cleanser")
LEVELS = ("in 50%", "in 95%")
Draw = Callable[..., scenes.Surface]


def objects() -> dict[str, tuple[hs.ObjectModel, Draw]]:
    """Name → (model, how five contacts are drawn on it)."""
    found: dict[str, tuple[hs.ObjectModel, Draw]] = {}
    for name, (make, draw) in scenes.OBJECTS.items():
        found[name] = make(), draw
    folder = ycb.data_folder()
    for name in MESHES if folder else ():
        model = hs.ObjectModel.from_file(f"{folder}/ycb_meshes/{name}.ply")
        found[name] = model, scenes.anywhere_on(model)
    return found


def grips() -> dict[str, tuple[hs.ObjectModel, Draw, float]]:
    """Name → (model, how its contacts are drawn, one standard deviation of vision's height [m])."""
    draws: dict[str, Draw] = {
        "can": lambda rng: scenes.opposed(rng, scenes.CAN["radius"], flat=False),
        "box": scenes.across_box,
    }
    return {
        f"gripped {name}, {where}": (scenes.OBJECTS[name][0](), draw, height)
        for name, draw in draws.items()
        for where, height in (("table", ON_TABLE), ("no table", IN_SPACE))
    }


def judged(name: str, answer: str, mine: Rows) -> list[str]:
    """A line of the table."""
    inside = [report.values(mine, level).mean() for level in LEVELS]
    spread = [np.sqrt(s * (1 - s) / len(mine)) for s in inside]
    shares = (f"{100 * s:.1f}±{100 * e:.1f} %" for s, e in zip(inside, spread, strict=True))
    return [name, answer, *shares]


def gripped_rows(options: report.Options, first: int) -> tuple[Rows, list[list[str]]]:
    """Rows of all grips by each answer, and their lines of the table."""
    rows, table = Rows(), []
    for o, (name, (model, draw, height)) in enumerate(grips().items(), start=first):
        mine: dict[str, Rows] = {"best": [], "maximum": []}
        for k in report.progress(range(options.trials), name):
            rng = options.rng(o, k)
            contacts, vision, T = gripped(draw(rng), rng, height)
            for answer, kept in mine.items():
                estimate = hs.correct_pose(model, contacts, vision=vision, answer=answer)
                kept.append({"object": f"{name}, {answer}"} | scenes.region(model, estimate, T))
        table += [judged(name, answer, kept) for answer, kept in mine.items()]
        rows += [row for kept in mine.values() for row in kept]
    return rows, table


def trial(model: hs.ObjectModel, draw: Draw, rng: np.random.Generator) -> Row:
    """How far the truth is from the answer in the answer's own units, and the degrees of freedom."""
    scene = scenes.random_scene(draw(rng), rng)
    estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision)
    return {"outliers": len(estimate.outliers), **scenes.region(model, estimate, scene.T_palm_object)}


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=500, quick_trials=25)
    rows, table = [], []
    for o, (name, (model, draw)) in enumerate(objects().items()):
        trials = report.progress(range(options.trials), name)
        mine = [{"object": name, **trial(model, draw, options.rng(o, k))} for k in trials]
        rows += mine
        table.append(judged(name, "best", mine))
    bounded, lines = gripped_rows(options, len(objects()))
    report.print_table(
        f"Truth inside the reported region, {options.trials} problems each (synthetic contacts)",
        ["object", "answer", "50 % region", "95 % region"],
        table + lines,
        "± one standard error. Vision off by 20 mm / 15° rms, contacts by 0.5 mm / 2° per axis; gripped: by 64 mm per "
        "axis / 10° rms, 3 mm in height on a table, contacts by 1.6 mm / 4°; all stated truthfully.",
    )
    report.write_csv(options.output / "regions.csv", rows)
    report.write_csv(options.output / "regions_gripped.csv", bounded)
    draw_figure(rows, options.output / "regions.png")


def draw_figure(rows: Rows, path: Path) -> None:
    """Share of truths inside against the region's probability: the diagonal is honest."""
    figure, axes = figures.pyplot().subplots(figsize=(4.6, 4.4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="honest")
    levels = np.linspace(0.02, 0.98, 49)
    for name in report.distinct(rows, "object"):
        squared, freedom = (report.values(rows, key, object=name) for key in ("squared", "freedom"))
        inside = [np.mean(squared < chdtri(freedom, 1 - level)) for level in levels]
        axes.plot(levels, inside, label=name)
    axes.set(xlabel="probability of the region", ylabel="share of truths inside", aspect="equal")
    axes.legend(loc="upper left")
    figures.save(figure, path)


if __name__ == "__main__":
    main()
