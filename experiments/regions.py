"""How often the truth lies in the reported 50 % and 95 % regions (judged modulo symmetry).

Generated problems with true sigmas: contacts drawn on the surface (can: on its side; box: three faces; meshes:
uniform over the area), noise 0.5 mm and 2 degrees per axis, vision off by a Gaussian draw of 20 mm and 15 degrees
root mean square that its covariance states truthfully. The truth is moved along the declared symmetries to the
pose nearest to the answer; it is inside when (δp, δθ)ᵀ information (δp, δθ) is below the χ² quantile with as many
degrees of freedom as the information has directions. YCB meshes are used where the data folder is present.
"""

import numpy as np
from scipy.special import chdtri

import handsight as hs
import report
import scenes
import ycb
from handsight import se3
from handsight.objects.symmetry import nearest

MESHES = ("006_mustard_bottle", "021_bleach_cleanser")
LEVELS = (0.50, 0.95)
ERROR = (0.020, np.deg2rad(15))
NOISE = (5e-4, np.deg2rad(2))


def objects():
    """Name → (model, how five contacts are drawn on it)."""
    found = {
        "can": (hs.ObjectModel.cylinder(**scenes.CAN), scenes.on_can_side),
        "box": (hs.ObjectModel.box(scenes.BOX), scenes.on_box_faces),
    }
    folder = ycb.data_folder()
    for name in MESHES if folder else ():
        model = hs.ObjectModel.from_file(folder / "ycb_meshes" / f"{name}.ply")
        found[name] = (model, scenes.anywhere_on(model))
    return found


def trial(model, draw, rng):
    """How far the truth is from the answer in the answer's own units, and the degrees of freedom."""
    scene = scenes.grasp(*draw(rng), rng, noise=NOISE, error=ERROR)
    estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision)
    truth = nearest(model.symmetries, scene.T_palm_object, estimate.T_palm_object, model.radius)
    delta = se3.difference(truth, estimate.T_palm_object)
    squared = float(delta @ estimate.information @ delta)
    scale = np.repeat([1.0, 1 / model.radius], 3)
    freedom = np.linalg.matrix_rank(estimate.information * scale[:, None] * scale, hermitian=True)
    row = {"squared": squared, "freedom": int(freedom), "outliers": len(estimate.outliers)}
    return row | {f"in {level:.0%}": squared < chdtri(freedom, 1 - level) for level in LEVELS}


def main():
    """Runs the experiment."""
    options, _ = report.parsed(report.parser(__doc__), trials=500, quick_trials=25)
    rows, table = [], []
    for o, (name, (model, draw)) in enumerate(objects().items()):
        trials = report.progress(range(options.trials), name)
        mine = [{"object": name, **trial(model, draw, options.rng(o, k))} for k in trials]
        rows += mine
        shares = [np.mean([row[f"in {level:.0%}"] for row in mine]) for level in LEVELS]
        spread = [np.sqrt(s * (1 - s) / len(mine)) for s in shares]
        table.append([name, *(f"{100 * s:.1f}±{100 * e:.1f} %" for s, e in zip(shares, spread, strict=True))])
    report.print_table(
        f"Truth inside the reported region, {options.trials} problems each (synthetic contacts)",
        ["object", "50 % region", "95 % region"],
        table,
        "± one standard error. Vision off by 20 mm / 15° rms, contacts by 0.5 mm / 2° per axis, all stated truthfully.",
    )
    report.write_csv(options.output / "regions.csv", rows)
    draw_figure(rows, options.output / "regions.png")


def draw_figure(rows, path):
    """Share of truths inside against the region's probability: the diagonal is honest."""
    plt = report.pyplot()
    figure, axes = plt.subplots(figsize=(4.6, 4.4), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="honest")
    levels = np.linspace(0.02, 0.98, 49)
    for name in dict.fromkeys(row["object"] for row in rows):
        mine = [row for row in rows if row["object"] == name]
        inside = [np.mean([r["squared"] < chdtri(r["freedom"], 1 - level) for r in mine]) for level in levels]
        axes.plot(levels, inside, label=name)
    axes.set_xlabel("probability of the region")
    axes.set_ylabel("share of truths inside")
    axes.set_aspect("equal")
    axes.legend(loc="upper left")
    report.save_figure(figure, path)


if __name__ == "__main__":
    main()
