"""How often the truth is inside the reported 50 % and 95 % regions (judged modulo symmetry).

Generated problems with true sigmas: contacts drawn on the surface (can: on its side; box: three faces; meshes:
uniform over the area), noise 0.5 mm and 2 degrees per axis, vision off by a Gaussian draw of 20 mm and 15 degrees
root mean square that its covariance states truthfully. The truth is moved along the declared symmetries to the
pose nearest to the answer; it is inside when (δp, δθ)ᵀ information (δp, δθ) is below the χ² quantile with as many
degrees of freedom as the information has directions. YCB meshes are used where the data folder is present.

Grips that contacts bound and do not fix (two fingers and a thumb on opposite sides, contact noise 1.6 mm and 4
degrees, vision off by 64 mm per axis and 10 degrees root mean square; on a table 3 mm in height) are answered by the
mean of the slide.
"""

from collections.abc import Callable

import numpy as np

import handsight as hs
from experiments.shared.grips import IN_SPACE, ON_TABLE, gripped
from testbed import report, scenes, ycb
from testbed.report import Row, Rows

MESHES = ("006_mustard_bottle", "021_bleach_cleanser")
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


def gripped_rows(options: report.Options, first: int) -> Rows:
    """Rows of all grips."""
    rows = Rows()
    for o, (name, (model, draw, height)) in enumerate(grips().items(), start=first):
        for k in report.progress(range(options.trials), name):
            rng = options.rng(o, k)
            contacts, vision, T = gripped(draw(rng), rng, height)
            estimate = hs.correct_pose(model, contacts, vision=vision)
            rows.append({"object": name} | scenes.region(model, estimate, T))
    return rows


def trial(model: hs.ObjectModel, draw: Draw, rng: np.random.Generator) -> Row:
    """How far the truth is from the answer in the answer's own units, and the degrees of freedom."""
    scene = scenes.random_scene(draw(rng), rng)
    estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision)
    return {"outliers": len(estimate.outliers), **scenes.region(model, estimate, scene.T_palm_object)}


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=500, quick_trials=25)
    rows = Rows()
    for o, (name, (model, draw)) in enumerate(objects().items()):
        for k in report.progress(range(options.trials), name):
            rows.append({"object": name, **trial(model, draw, options.rng(o, k))})
    rows += gripped_rows(options, len(objects()))
    report.print_by(
        f"Truth inside the reported region, {options.trials} problems each (synthetic contacts)",
        rows,
        "object",
        {"50 % region": share("in 50%"), "95 % region": share("in 95%")},
        "± one standard error. Vision off by 20 mm / 15° rms, contacts by 0.5 mm / 2° per axis; gripped: by 64 mm per "
        "axis / 10° rms, 3 mm in height on a table, contacts by 1.6 mm / 4°; all stated truthfully.",
    )
    report.write_csv(options.output / "regions.csv", rows)


def share(level: str) -> report.Cell:
    """The cell of a share and its standard error, in percent."""

    def cell(rows: Rows) -> str:
        inside = report.values(rows, level).mean()
        error = np.sqrt(inside * (1 - inside) / len(rows))
        return f"{100 * inside:.1f}±{100 * error:.1f} %"

    return cell


if __name__ == "__main__":
    main()
