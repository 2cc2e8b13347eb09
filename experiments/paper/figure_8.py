"""Fig. 8 of the paper: x and y of the centre of the object's base while it is manipulated, by vision and corrected.

One can and one box, simulated (MuJoCo) with all usual nuisances: moved over the table, lifted, turned by 75 degrees
and back. Rings: where vision sees the object; line: the tracker's pose, of the box with outside evidence; dots:
the truth, as often as the paper could read it. x and y are the table's.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from experiments.shared.grasp_errors import pose_errors
from experiments.shared.grasp_trials import OBJECTS, exact_model, seen_in_palm
from experiments.shared.manipulations import TRACKED, recorded, tracked
from handsight import se3
from handsight.evaluation import base_center
from handsight.simulation import Sample
from testbed import figures, report, scenes
from testbed.report import Array, Row

WAYS = {"can": "best, table", "box": "best, outside, table"}
COLOURS = {"x": "#2b5fd0", "y": "#2e9e4f"}
TRUTH = "#d02b2b"
RINGS_APART, DOTS_APART = 0.3, 1.5
"""Seconds between those drawn."""
Curves = dict[str, Array]
"""By vision, corrected, truth: rows of time, x and y [s, cm, cm]."""


def base_on_table(model: hs.ObjectModel, T_palm_object: Array, sample: Sample) -> Array:
    """(2,) x, y of the centre of the base [cm], in the world, of the pose's equivalent nearest to the truth."""
    T = scenes.nearest_truth(model, T_palm_object, sample.T_palm_object)
    base = base_center(model, sample.T_world_object)
    return 100 * se3.apply(sample.observation.T_world_palm @ T, base[None])[0, :2]


def curves(name: str, seed: int, way: str) -> tuple[Curves, Row]:
    """What is drawn, and a row of mean errors."""
    model, samples = exact_model(name), recorded(name, seed)
    by_stamp = {sample.observation.stamp: sample for sample in samples}
    steps = tracked(name, samples, TRACKED[way])
    by = {
        "vision": [(s, seen_in_palm(s.observation)) for s in samples if s.observation.vision],
        "corrected": [(by_stamp[step.stamp], step.estimate.T_palm_object) for step in steps],
        "truth": [(s, s.T_palm_object) for s in samples],
    }
    row: Row = {"object": name, "seed": seed, "method": way}
    for key in ("vision", "corrected"):
        held = [pose_errors(model, T, s)["read"] for s, T in by[key] if s.phase != "close"]
        row[f"{key}_mm"] = float(np.mean(held))
    lines = {
        key: np.array([(s.observation.stamp, *base_on_table(model, T, s)) for s, T in found])
        for key, found in by.items()
    }
    return lines, row


def thinned(line: Array, apart: float) -> Array:
    """Rows at least so many seconds apart."""
    kept = [0]
    for i, stamp in enumerate(line[:, 0]):
        if stamp - line[kept[-1], 0] >= apart - 1e-9:
            kept.append(i)
    return line[kept]


def draw(found: dict[str, tuple[Curves, Row]], path: Path) -> None:
    """A panel an object."""
    figure, panels = figures.pyplot().subplots(2, 1, figsize=(9, 7.5), sharex=True, layout="constrained")
    for axes, (name, (lines, row)) in zip(panels, found.items(), strict=True):
        draw_curves(axes.plot, lines)
        vision, ours = row["vision_mm"], row["corrected_mm"]
        axes.set_title(f"{name}: mean error {vision:.0f} mm by vision, {ours:.1f} mm corrected")
        axes.set_ylabel("centre of the base, table [cm]")
        axes.grid(color="0.93")
        axes.set_axisbelow(True)
    panels[-1].set_xlabel("time [s]")
    figures.legend_below(figure, panels[0], 5)
    figures.save(figure, path)


def draw_curves(plot: Callable[..., Any], lines: Curves) -> None:
    """Rings, line and dots of x and of y."""
    rings, dots = thinned(lines["vision"], RINGS_APART), thinned(lines["truth"], DOTS_APART)
    corrected = lines["corrected"]
    for k, (axis, colour) in enumerate(COLOURS.items(), start=1):
        plot(rings[:, 0], rings[:, k], "o", mfc="none", mec=colour, ms=5, label=f"{axis}, vision")
        plot(corrected[:, 0], corrected[:, k], color=colour, lw=1.8, label=f"{axis}, corrected")
        label = "truth" if k == 2 else None
        plot(dots[:, 0], dots[:, k], "o", color=TRUTH, ms=4, zorder=5, label=label)


@report.or_skip
def main() -> None:
    """Runs both manipulations and draws them."""
    options = report.options(__doc__, trials=2, quick_trials=2)
    found = {name: curves(name, options.seed, WAYS[name]) for name in OBJECTS}
    rows = [row for _, row in found.values()]
    report.print_table(
        "Mean error over one manipulation, mm (synthetic)",
        ["object", "tracker", "vision", "corrected"],
        [[r["object"], r["method"], f"{r['vision_mm']:.1f}", f"{r['corrected_mm']:.1f}"] for r in rows],
        "x, y of the base's centre against the truth by eq. 8, from letting go on.",
    )
    report.write_csv(options.output / "figure_8.csv", rows)
    draw(found, options.output / "figure_8.png")


if __name__ == "__main__":
    main()
