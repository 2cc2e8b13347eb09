"""What a hand learns of its own joints from grip to grip: constant errors of 1 degree at each joint.

Each hand grasps can and box in turn, 16 grasps of the simulator whose joints then read what this hand's would, and the
tracker of each begins with the joint offsets of the one before (`Tracker(..., joint_offsets=...)`), or with none.
Synthetic (MuJoCo).

  seen     error of the object's middle in what contacts observe
  turn     the same of its turn
  left     root mean square of what is left of the joints' errors; claimed: what is said to be left
  inside   truths in the answer's 95 % region
"""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight.evaluation import correction_errors
from handsight.simulation import Nuisances, Sample, Scenario, rig_of, simulate
from handsight.tracking import JointOffsets
from testbed import report, scenes
from testbed.report import Array, Row, Rows

GRASPS, QUICK_GRASPS = 8, 4
"""Of each object."""
RATE, QUICK_RATE = 50.0, 20.0
"""Observations a second."""
SIGMA = float(np.deg2rad(1.0))
OBJECTS = {"can": scenes.can, "box": scenes.box}
WAYS = {"as new": False, "learnt": True}
CELLS = {
    "seen mm": report.error_of("seen", 2),
    "turn °": report.error_of("turn", 2),
    "left °": report.of("left"),
    "claimed °": report.of("claimed"),
    "inside": report.of("inside", ".0%"),
}


@cache
def grasped(name: str, seed: int, rate: float) -> tuple[Sample, ...] | None:
    """Returns a grasp by a hand without joint offsets; None where it drops the object."""
    perfect = Nuisances(joint_offset=0.0)
    samples = tuple(simulate(Scenario(object=name, seed=seed, rate=rate, nuisances=perfect)))
    return None if samples[-1].dropped else samples


def followed(
    tracker: hs.Tracker, samples: tuple[Sample, ...], offsets: dict[str, float]
) -> hs.PoseEstimate | None:
    """Returns the last estimate of a tracker whose hand's joints have errors `offsets`."""
    estimate = None
    for sample in samples:
        joints = sample.observation.joint_positions or {}
        read = {joint: angle + offsets[joint] for joint, angle in joints.items()}
        estimate = tracker.update(replace(sample.observation, joint_positions=read))
    return estimate


def hand(rng: np.random.Generator, first_seed: int, quick: bool) -> Rows:
    """Returns a row for each grasp of one hand and each way."""
    grasps, rate = (QUICK_GRASPS, QUICK_RATE) if quick else (GRASPS, RATE)
    rig = rig_of(Scenario())
    offsets = dict(zip(rig.hand.joint_names, SIGMA * rng.normal(size=len(rig.hand.joint_names)), strict=True))
    order = [(name, first_seed + k) for k in rng.permutation(grasps) for name in OBJECTS]
    rows = []
    for way, learns in WAYS.items():
        known: JointOffsets | None = None
        held = ((name, samples) for name, seed in order if (samples := grasped(name, seed, rate)))
        for number, (name, samples) in enumerate(held):
            model = OBJECTS[name]()
            tracker = hs.Tracker(rig, model, joint_offsets=known if learns else None)
            estimate = followed(tracker, samples, offsets)
            known = tracker.joint_offsets
            first = number // 4 * 4 + 1
            row = {"offsets": way, "grips": f"{first}-{first + 3}", "grip": number, "object": name}
            if estimate is None:  # nothing was seen
                continue
            rows.append(row | errors(model, estimate, samples[-1].T_palm_object) | left(known, offsets))
    return rows


def errors(model: hs.ObjectModel, estimate: hs.PoseEstimate, T: Array) -> Row:
    """Returns the errors of an estimate."""
    found = correction_errors(model, estimate.T_palm_object, T, estimate.unobservable)
    squared, freedom = scenes.chi2(model, estimate.T_palm_object, estimate.information, T)
    inside = bool(squared < chdtri(freedom, 0.05))
    return {"seen": 1e3 * found.shift_observable, "turn": np.rad2deg(found.turn), "inside": inside}


def left(known: JointOffsets, offsets: dict[str, float]) -> Row:
    """Returns the errors of the offsets after a grip [deg]."""
    off = known.mean - [offsets[joint] for joint in known.joints]
    claimed = np.sqrt(np.trace(known.covariance) / len(off))
    return {"left": np.rad2deg(np.sqrt(np.mean(off**2))), "claimed": np.rad2deg(claimed)}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=20, quick_trials=2)
    rows = []
    for k in report.progress(range(options.trials), "hands"):
        rows += [{"hand": k, **row} for row in hand(options.rng(k), options.first_seed, options.quick)]
    title = f"Grips of one hand after another, {options.trials} hands (synthetic)"
    report.print_by(title, rows, "offsets, grips", CELLS, "± one standard error.")
    report.write_csv(options.output / "joint_offsets.csv", rows)


if __name__ == "__main__":
    main()
