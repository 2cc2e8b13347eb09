"""Fig. 1 of the paper: what the camera sees, and the robot's posture with the object where vision says it is.

A simulated can grasp (MuJoCo). Left: the camera's own image. Right: the hand as its joints have it and the object
at vision's pose: fingers are inside of it, or far from it. How deep, the table says. Needs EGL or OSMesa; without, it
says so and ends.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from experiments.shared.grasp_trials import last_instant, rig, surface, typical
from handsight import se3
from testbed import figures, report
from testbed.report import Array, Row

MIDDLE = slice(130, 466), slice(200, 600)
"""The part of the camera's image that is shown."""


def depths_mm(trial: Any, T_palm_object: Array) -> Row:
    """How deep the hand is in the object, and how far the nearest and the farthest contact are off its surface."""
    points = surface().points_palm(trial.sample.observation.joint_positions)
    inside, touched = (
        1e3 * trial.model.fine.evaluate(se3.apply(se3.inverse(T_palm_object), p)).distance
        for p in (points, trial.contacts.points_palm)
    )
    return {
        "deepest_in_hand": float(max(0.0, -inside.min())),
        "contact_least": float(np.abs(touched).min()),
        "contact_most": float(np.abs(touched).max()),
    }


@report.or_skip
def main() -> None:
    """Chooses a grasp, draws it twice."""
    options = report.options(__doc__, trials=11, quick_trials=3)
    trial = typical("can", options.trials, options.first_seed)
    view: Any = last_instant(replace(trial.scenario, images=True)).observation.color
    seen = trial.vision.T_palm_object
    posture = figures.close_up(trial, seen)
    poses = {"vision": seen, "truth": trial.sample.T_palm_object}
    rows = [{"pose": name, **depths_mm(trial, T)} for name, T in poses.items()]
    cells = [[r["pose"], *(f"{value:.1f}" for key, value in r.items() if key != "pose")] for r in rows]
    columns = ["object at", "deepest in hand mm", "nearest contact off by", "farthest contact off by"]
    report.print_table(f"Hand of {len(rig().fingers)} fingers, object where it is said to be", columns, cells)
    report.write_csv(options.output / "figure_1.csv", rows)
    figure, panels = figures.pyplot().subplots(1, 2, figsize=(10, 4.3), layout="constrained")
    titles = "the camera's point of view", "posture, object as vision has it"
    figures.show_pictures(panels, list(zip(titles, (view[MIDDLE], posture), strict=True)))
    figures.save(figure, options.output / "figure_1.png")


if __name__ == "__main__":
    main()
