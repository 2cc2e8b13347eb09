"""Fig. 8 of the paper: x and y of the centre of the object's base while it is manipulated, by vision and corrected.

One can and one box, simulated (MuJoCo) with all usual nuisances: moved over the table, lifted, turned by 75 degrees
and back. Rings: where vision sees the object; line: the tracker's pose, of the can the maximum, of the box the
posterior mean with outside evidence (with --quick the maximum, which takes a second instead of 20); dots: the truth,
as often as the paper could read it. x and y are the table's.
"""

import numpy as np

import report
from grasp_errors import pose_errors
from grasp_trials import OBJECTS, exact_model, seen_in_palm
from handsight import se3
from handsight.errors import MissingExtra
from handsight.evaluation import base_center
from handsight.objects.symmetry import nearest
from manipulations import WITH_MEAN, recorded, tracked

WAYS = {"can": "maximum, table", "box": "mean, outside, table"}
QUICK = "maximum, outside, table"
COLOURS = {"x": "#2b5fd0", "y": "#2e9e4f"}
TRUTH = "#d02b2b"
RINGS_APART, DOTS_APART = 0.3, 1.5
"""Seconds between those drawn."""


def base_on_table(model, T_palm_object, sample):
    """(2,) x, y of the centre of the base [cm], in the world, of the pose's equivalent nearest to the truth."""
    T_world_palm = sample.observation.T_world_palm
    T = nearest(model.symmetries, T_palm_object, sample.T_palm_object, model.radius)
    base = base_center(model, sample.T_world_object)
    return 100 * se3.apply(T_world_palm @ T, base[None])[0, :2]


def curves(name, seed, way):
    """Time, x and y [s, cm, cm] of vision, of the tracker and of the truth; and a row of mean errors."""
    samples = recorded(name, seed)
    model = exact_model(name)
    by_stamp = {sample.observation.stamp: sample for sample in samples}
    steps = tracked(name, samples, WITH_MEAN[way])
    seen = [sample for sample in samples if sample.observation.vision]
    lines = {
        "vision": [
            (s.observation.stamp, *base_on_table(model, seen_in_palm(s.observation), s)) for s in seen
        ],
        "corrected": [
            (step.stamp, *base_on_table(model, step.estimate.T_palm_object, by_stamp[step.stamp]))
            for step in steps
        ],
        "truth": [(s.observation.stamp, *base_on_table(model, s.T_palm_object, s)) for s in samples],
    }
    held = [step for step in steps if by_stamp[step.stamp].phase != "close"]
    ours = [pose_errors(model, s.estimate.T_palm_object, by_stamp[s.stamp])["read"] for s in held]
    free = [s for s in seen if s.phase != "close"]
    vision = [pose_errors(model, seen_in_palm(s.observation), s)["read"] for s in free]
    row = {
        "object": name,
        "seed": seed,
        "method": way,
        "vision_mm": float(np.mean(vision)),
        "corrected_mm": float(np.mean(ours)),
    }
    return {key: np.array(line) for key, line in lines.items()}, row


def thinned(line, apart):
    """Rows at least so many seconds apart."""
    kept = [0]
    for i, stamp in enumerate(line[:, 0]):
        if stamp - line[kept[-1], 0] >= apart - 1e-9:
            kept.append(i)
    return line[kept]


def draw(found, path):
    """A panel an object."""
    plt = report.pyplot()
    figure, panels = plt.subplots(2, 1, figsize=(9, 7.5), sharex=True, layout="constrained")
    for axes, (name, (lines, row)) in zip(panels, found.items(), strict=True):
        rings, dots = thinned(lines["vision"], RINGS_APART), thinned(lines["truth"], DOTS_APART)
        for k, (axis, colour) in enumerate(COLOURS.items(), start=1):
            axes.plot(rings[:, 0], rings[:, k], "o", mfc="none", mec=colour, ms=5, label=f"{axis}, vision")
            corrected = lines["corrected"]
            axes.plot(corrected[:, 0], corrected[:, k], color=colour, lw=1.8, label=f"{axis}, corrected")
            axes.plot(
                dots[:, 0], dots[:, k], "o", color=TRUTH, ms=4, zorder=5, label="truth" if k == 2 else None
            )
        axes.set_title(
            f"{name}: mean error {row['vision_mm']:.0f} mm by vision, {row['corrected_mm']:.1f} mm corrected"
        )
        axes.set_ylabel("centre of the base, table [cm]")
        axes.grid(color="0.93")
        axes.set_axisbelow(True)
    panels[-1].set_xlabel("time [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    report.save_figure(figure, path)


def main():
    """Runs both manipulations and draws them."""
    options, _ = report.parsed(report.parser(__doc__), trials=2, quick_trials=2)
    try:
        found = {name: curves(name, options.seed, QUICK if options.quick else WAYS[name]) for name in OBJECTS}
    except MissingExtra as error:
        report.say(f"skipped: {error}")
        return
    rows = [row for _, row in found.values()]
    cells = [[r["object"], r["method"], f"{r['vision_mm']:.1f}", f"{r['corrected_mm']:.1f}"] for r in rows]
    note = "x, y of the base's centre against the truth by eq. 8, from letting go on."
    report.print_table(
        "Mean error over one manipulation, mm (synthetic)",
        ["object", "tracker", "vision", "corrected"],
        cells,
        note,
    )
    report.write_csv(options.output / "figure_8.csv", rows)
    draw(found, options.output / "figure_8.png")


if __name__ == "__main__":
    main()
