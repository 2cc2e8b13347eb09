"""How often the truth lies in the reported 50 % and 95 % regions (judged modulo symmetry).

Generated problems with true sigmas: contacts drawn on the surface (can: on its side; box: three faces; meshes:
uniform over the area), noise 0.5 mm and 2 degrees per axis, vision off by a Gaussian draw of 20 mm and 15 degrees
root mean square that its covariance states truthfully. The truth is moved along the declared symmetries to the
pose nearest to the answer; it is inside when (δp, δθ)ᵀ information (δp, δθ) is below the χ² quantile with as many
degrees of freedom as the information has directions. YCB meshes are used where the data folder is present.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.special import chdtri

import handsight as hs
from shared import figures, report, scenes, ycb
from shared.report import Row, Rows

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
        inside = [report.values(mine, level).mean() for level in LEVELS]
        spread = [np.sqrt(s * (1 - s) / len(mine)) for s in inside]
        table.append([name, *(f"{100 * s:.1f}±{100 * e:.1f} %" for s, e in zip(inside, spread, strict=True))])
    report.print_table(
        f"Truth inside the reported region, {options.trials} problems each (synthetic contacts)",
        ["object", "50 % region", "95 % region"],
        table,
        "± one standard error. Vision off by 20 mm / 15° rms, contacts by 0.5 mm / 2° per axis, all stated truthfully.",
    )
    report.write_csv(options.output / "regions.csv", rows)
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
