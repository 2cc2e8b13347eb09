"""A box gripped by two fingers and a thumb on opposite faces: what the contacts leave open, and what helps.

Box 60 x 90 x 140 mm, gripped across its 90 mm side; contact noise 1.6 mm and 4 degrees per axis (what joint
offsets of 1 degree leave), vision off by 80 mm on average in the plane of the table, 3 mm in height, 10 degrees
(root mean square), its covariance stated truthfully. The contacts bound the slide along the gripped faces but do
not fix it: the maximum of the density ends at the interval's end, its mean, the default's answer, in the middle.
Synthetic.

  slide    error along the gripped faces, horizontally; gap: across them; up: vertically
  turned   boxes left turned by more than 20 degrees (modulo symmetry)
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from shared import figures, report, scenes
from shared.grips import ON_TABLE, gripped
from testbed.report import Array, Row, Rows

ANSWERS: dict[str, dict[str, Any]] = {
    "maximum": {"answer": "maximum"},
    "best": {},
    "samples": {"samples": 4000},
}
"""What `correct_pose` is asked for: the maximum, the default, or the mean of so many posterior samples."""
COLOURS = {
    "vision": figures.INITIAL,
    "maximum": figures.RESULT,
    "best": figures.TRUTH,
    "samples": "0.5",
}


def errors(model: hs.ObjectModel, T: Array, T_true: Array) -> Row:
    """Slide, gap, up [mm] and turn [deg]."""
    delta = se3.difference(T, scenes.nearest_truth(model, T_true, T))
    slide, gap, up = 1e3 * np.abs(T_true[:3, :3].T @ delta[:3])
    return {"slide": slide, "gap": gap, "up": up, "turn": np.rad2deg(np.linalg.norm(delta[3:]))}


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=200, quick_trials=15)
    model, rows = scenes.box(), []
    for k in report.progress(range(options.trials), "gripped box"):
        rng = options.rng(k)
        contacts, vision, T = gripped(scenes.across_box(rng), rng, ON_TABLE)
        rows.append({"trial": k, "answer": "vision", **errors(model, vision.T_palm_object, T)})
        for answer, how in ANSWERS.items():
            correct = partial(hs.correct_pose, model, contacts, vision=vision, **how)
            estimate, seconds = report.timed(correct)
            row = {"trial": k, "answer": answer, **errors(model, estimate.T_palm_object, T)}
            axis = T[:3, 0]
            sigma = 1e3 * np.sqrt(axis @ estimate.covariance[:3, :3] @ axis)
            rows.append(row | {"ms": 1e3 * seconds, "sigma_slide": sigma})
    print_table(rows, options.trials)
    report.write_csv(options.output / "gripped_box.csv", rows)
    draw_figure(rows, options.output / "gripped_box.png")


def print_table(rows: Rows, trials: int) -> None:
    """Mean errors of each answer."""
    table = []
    for answer in COLOURS:
        mine = report.chosen(rows, answer=answer)
        cells = [report.plus_minus(report.values(mine, key), 1) for key in ("slide", "gap", "up", "turn")]
        corrected = answer in ANSWERS
        sigma = report.plus_minus(report.values(mine, "sigma_slide"), 1) if corrected else ""
        ms = f"{np.median(report.values(mine, 'ms')):.1f}" if corrected else ""
        table.append([answer, *cells, sigma, (report.values(mine, "turn") > 20).sum(), ms])
    best, maximum = (report.values(rows, "slide", answer=a).mean() for a in ("best", "maximum"))
    report.print_table(
        f"Mean absolute error, {trials} grips (synthetic)",
        ["answer", "slide mm", "gap mm", "up mm", "turn °", "σ of slide mm", "turned > 20°", "ms"],
        table,
        f"± one standard error. The default's slide error is {best / maximum:.2f} of the maximum's.",
    )


def draw_figure(rows: Rows, path: Path) -> None:
    """How far each answer is off along the slide."""
    figure, axes = figures.pyplot().subplots(figsize=(5.6, 3.4), layout="constrained")
    for answer, colour in COLOURS.items():
        values = np.clip(report.values(rows, "slide", answer=answer), 0, 59.9)
        axes.hist(values, np.linspace(0, 60, 31), histtype="step", linewidth=1.8, color=colour, label=answer)
    axes.set(xlabel="slide error [mm] (last bin: and above)", ylabel="grips")
    axes.legend()
    figures.save(figure, path)


if __name__ == "__main__":
    main()
