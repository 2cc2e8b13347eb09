"""A palm's tactile array: what its pressed and its untouched taxels say beside three fingertips. All synthetic.

First static scenes: a box (60 x 90 x 140 mm) that lies flat, one long edge on the array, and a can that lies on its
side, one end on the array or both beyond it. Array 60 x 80 mm of 4 mm, of foam, 10 % noise, each taxel off by 0.1 mm,
all by 0.5 mm; fingertips on the far side, 1.2 mm and 2° per axis; vision 30 mm, 6° per axis. Then the simulated hand
(MuJoCo), which presses the can on its palm, upper end on the array; the tracker knows of no table.

  slide    error across the edge on the array (along the can's axis)
  open     error along the array the other way
  turn     modulo symmetry
  in 95 %  share of the answer's 95 % regions that hold the truth
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.simulation.taxels import RUBBER
from testbed import report, scenes, skin_scenes
from testbed.report import Array, Row, Rows

WITH = ("tips", "+ pressed", "+ untouched")
HELD_OUT = 14
"""A key of the scenes that no constant was chosen on."""
SCENES: dict[str, Any] = {
    "box, an edge on it": skin_scenes.box_on_skin,
    "the same, hard skin": lambda rng, array: skin_scenes.box_on_skin(rng, array, springs=RUBBER),
    "can, an end on it": skin_scenes.can_on_skin,
    "can, both ends off": lambda rng, array: skin_scenes.can_on_skin(rng, array, end=False),
}
HAND = "hand presses the can"
CELLS = {
    "n": report.count,
    "slide mm": report.error_of("slide"),
    "p90": report.of("slide", ".1f", report.quantile(0.9)),
    "open mm": report.error_of("open"),
    "turn °": report.error_of("turn"),
    "in 95 %": report.of("in 95%", ".0%"),
    "NEES": report.of("nees"),
    "ms": report.of("ms", ".1f", np.median),
}


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=100, quick_trials=8)
    array, rows = skin_scenes.palm_array(), []
    for n, (name, draw) in enumerate(SCENES.items()):
        for k in report.progress(range(options.trials), name):
            scene = draw(options.rng(HELD_OUT, n, k), array)
            rows += [{"trial": k, "scene": name, **row} for row in answers(scene, scene.touch(array))]
    for k in report.progress(range(max(2, options.trials // 5)), "in the hand"):
        rows += [{"trial": k, "scene": HAND, **row} for row in held(options.first_seed + 200 + k)]
    note = "± one standard error. NEES per degree of freedom."
    report.print_by("Mean absolute error (synthetic)", rows, "scene, with", CELLS, note)
    report.write_csv(options.output / "skin.csv", rows)


def answers(scene: skin_scenes.SkinScene, touch: Any) -> Rows:
    """The errors of a static scene by the tips, with pressed taxels, and with all."""
    everything, rows = hs.SkinEvidence.of(touch, np.eye(4)), []
    # Without the untouched ones the array's height is as uncertain.
    pressed = replace(everything, untouched_palm=np.empty((0, 3)))
    for name, skin in zip(WITH, (None, pressed, everything), strict=True):
        correct = partial(hs.correct_pose, scene.model, scene.tips, vision=scene.vision, skin=skin)
        estimate, seconds = report.timed(correct)
        row = errors(scene.model, estimate, scene.T_palm_object, scene.across, np.array([0.0, 0, 1]))
        rows.append({"with": name, **row, "ms": 1e3 * seconds})
    return rows


def errors(model: hs.ObjectModel, estimate: hs.PoseEstimate, T_true: Array, across: Array, up: Array) -> Row:
    """Slide, open [mm], turn [deg], and whether the 95 % region holds the truth."""
    T = estimate.T_palm_object
    delta = se3.difference(T, scenes.nearest_truth(model, T_true, T))
    region = scenes.region(model, estimate, T_true)
    return {
        "slide": 1e3 * abs(delta[:3] @ across),
        "open": 1e3 * abs(delta[:3] @ np.cross(up, across)),
        "turn": np.rad2deg(np.linalg.norm(delta[3:])),
        "in 95%": region["in 95%"],
        "nees": region["squared"] / region["freedom"],
    }


def held(seed: int) -> Rows:
    """The errors at the end of a simulated power grasp, without the array and with it."""
    scenario = Scenario(object="can", seed=seed, motion="grasp", rate=50, skin=True)
    samples, model = list(simulate(scenario)), model_of(scenario)
    if samples[-1].dropped:
        return []
    rig, truth, rows = replace(rig_of(scenario), table=None), samples[-1].T_palm_object, []
    for name in ("tips", "+ untouched"):
        tracker = hs.Tracker(rig, model)
        for sample in samples:
            seen = sample.observation
            tracker.update(seen if name != "tips" else replace(seen, skin={}))
        if tracker.estimate is not None:
            row = errors(model, tracker.estimate, truth, truth[:3, 2], np.array([0.0, -1, 0]))
            rows.append({"with": name, **row})
    return rows


if __name__ == "__main__":
    main()
