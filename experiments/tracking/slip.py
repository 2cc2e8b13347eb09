"""Is a slip noticed, and what does it cost to know the pose through it? Pulls that make can and box slip in the hand.

Each pull: the hand lifts the object, holds still, and something pulls it along its tips with a force that grows as a
ramp, in steps, as a sine, or in jerks of 60 ms, or follows it slowly (creep, 3-10 mm/s), up to 3-9 N (box) or 6-16 N
(can; jerks half as much again), every other one with a torque of up to 0.08 N m (twice that on the can); friction is
0.3 to 0.8; once it has slipped by 5 to 20 mm it is let go, and then tilted by 20 degrees. Carrying: the manipulations
of `handsight simulate`, without a pull, friction 0.5 and 1. All usual nuisances are on; thresholds were chosen on other
draws. A run counts until the object is dropped. Synthetic (MuJoCo, whose cone is the ellipsoid that the detector
knows).

It slips in truth where each tip that presses it (over 0.2 N) slides at more than 3 mm/s, a turn about the normal
counted 5 mm from it; below 0.5 mm/s it holds; between, it creeps, and neither answer is wrong.

  precision  alarms that are right: of the samples in alarm, those within 20 ms of more than 0.5 mm/s
  strict     the same of more than 3 mm/s
  recall     samples that slip that are in alarm
  delay      from the begin of a slip of at least 1 mm to the alarm; an alarm before it is below zero
  friction   what was learnt, when the pull begins and in the end, off the truth
  way        angle between the motion that loads say and the true one, over all tips
  inside     truths in the tracker's 95 % region from the first slip on, where the hand keeps the object
  error      of the object's middle: before the slip, and in the end, 2 s after the tilt began; with the object's weight
             as evidence and without
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

import handsight as hs
from experiments.shared import slips
from handsight import se3
from handsight.forces import FRICTION, SlipDetector, slip_twist
from handsight.simulation import Nuisances, Sample, Scenario, model_of, rig_of, simulate
from handsight.simulation.scenario import OBJECT_MASS
from handsight.tracking import FingertipSensors
from testbed import report, scenes
from testbed.report import Array, Row, Rows

RATE, CARRY_RATE = 250.0, 100.0
"""Samples a second."""
ERRORS = ("before", "most", "end")
WAYS = (("without weight", ""), ("weighed", "weighed "))
"""Name of each way in the table, and the prefix of its columns in a row."""


@dataclass(frozen=True)
class Felt:
    """Detections and truth, sample by sample, from when the object is in the hand."""

    stamps: Array
    alarms: Array
    friction: Array
    speeds: Array
    """Speed of the finger that slips least [m/s]."""
    ways: Array
    """Angles [deg] while the object slips, else NaN."""


def followed(samples: list[Sample]) -> Felt:
    """Returns the detections in a run."""
    rig = rig_of(Scenario())
    sensors, detector, rows = FingertipSensors(rig), SlipDetector(rig), []
    for sample in samples:
        felt = sensors.contacts(sample.observation)
        T_world_palm = sample.observation.T_world_palm
        assert T_world_palm is not None
        R = T_world_palm[:3, :3]
        said = detector.update(sample.observation.stamp, felt.fingers, felt.loads, R_world_palm=R)
        speed = slips.speed(sample)
        way = np.nan
        if speed > slips.FAST and said.slipping and felt.contacts is not None and felt.loads is not None:
            way = off_by(sample, slip_twist(felt.contacts, felt.loads, np.zeros(3)))
        row = (said.slipping, said.friction, speed, way)
        rows.append([sample.observation.stamp, *(np.nan if value is None else value for value in row)])
    held = [
        row
        for row, sample in zip(rows, samples, strict=True)
        if sample.phase != "close" and not sample.dropped
    ]
    return Felt(*np.array(held, dtype=float).T)


def off_by(sample: Sample, twist: Array | None) -> float:
    """Returns the angle between the object's motion along the tips by an estimated twist, and the true one [deg]."""
    if twist is None:
        return np.nan
    said, true = [], []
    for touch in sample.touches.values():
        n, v = touch.normal_palm, touch.velocity_palm
        mine = twist[:3] + np.cross(twist[3:], touch.point_palm)
        said.append([*(mine - (mine @ n) * n), FRICTION.torsion * (n @ twist[3:])])
        true.append([*(v[:3] - (v[:3] @ n) * n), FRICTION.torsion * (n @ v[3:])])
    a, b = np.ravel(said), np.ravel(true)
    return float(np.rad2deg(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1, 1))))


def pull_row(name: str, seed: int) -> Row:
    """Returns the row of one pull; a short one where the hand did not hold the object until then."""
    scenario = slips.scenario(name, seed, RATE)
    samples, mu = list(simulate(scenario)), scenario.nuisances.friction
    pulled = [i for i, sample in enumerate(samples) if sample.phase == "pull"]
    row: Row = {"object": name, "seed": seed, "motion": scenario.motion, "friction": mu}
    if samples[pulled[0]].dropped:
        return row
    felt = followed(samples)
    first = felt.friction[np.searchsorted(felt.stamps, samples[pulled[0]].observation.stamp)]
    delays = slips.delays(felt.alarms > 0, felt.speeds, felt.stamps)
    row |= {"learnt first": 100 * (first / mu - 1), "learnt": 100 * (felt.friction[-1] / mu - 1)}
    row |= {"slips": len(delays), "delays": " ".join("-" if d is None else f"{1e3 * d:.0f}" for d in delays)}
    row |= {"way": float(np.nanmedian(felt.ways)) if np.isfinite(felt.ways).any() else np.nan}
    row |= slips.counted(felt.alarms > 0, felt.speeds, 1 / RATE) | tracked(
        samples, model_of(Scenario(object=name))
    )
    known = model_of(Scenario(object=name)).with_weight(mass=OBJECT_MASS, center_of_mass=np.zeros(3))
    return row | {f"weighed {key}": value for key, value in tracked(samples, known).items()}


def tracked(samples: list[Sample], model: hs.ObjectModel) -> Row:
    """Returns the errors of a tracker through a pull, and how often its region contains the truth."""
    tracker, errors, inside, first = hs.Tracker(rig_of(Scenario()), model), [], [], None
    for sample in samples:
        estimate = tracker.update(sample.observation)
        if estimate is None:
            continue
        T, truth = estimate.T_palm_object, sample.T_palm_object
        off = se3.apply(T, model.center_object[None]) - se3.apply(truth, model.center_object[None])
        errors.append(1e3 * float(np.linalg.norm(off)))
        if sample.phase == "pull" and tracker.slip.slipping and first is None:
            first = len(errors) - 1
        if first is not None:
            squared, freedom = scenes.chi2(model, T, estimate.information, truth)
            inside.append(bool(squared < chdtri(freedom, 0.05)))
    if first is None or samples[-1].dropped:
        return {}
    found = {"before": errors[first], "most": max(errors[first:]), "end": errors[-1]}
    return found | {"inside": float(np.mean(inside))}


def carry_row(name: str, seed: int, friction: float) -> Row:
    """Returns the alarms while an object is carried, until it is dropped."""
    nuisances = Nuisances(friction=friction)
    scenario = Scenario(object=name, seed=seed, motion="manipulate", rate=CARRY_RATE, nuisances=nuisances)
    felt = followed(list(simulate(scenario)))
    counted = slips.counted(felt.alarms > 0, felt.speeds, 1 / CARRY_RATE)
    row: Row = {"object": name, "seed": seed, "friction": friction}
    row |= {"motion": "carried", "seconds": len(felt.stamps) / CARRY_RATE}
    return row | counted | {"learnt": 100 * (felt.friction[-1] / scenario.nuisances.friction - 1)}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=12, quick_trials=2)
    seeds = [options.first_seed + k for k in range(options.trials)]
    rows = Rows()
    for name, seed in report.progress([(name, seed) for seed in seeds for name in slips.FORCES], "pulls"):
        rows.append(pull_row(name, seed))
    few = seeds[: (options.trials + 1) // 2]
    carries = [(name, seed, mu) for seed in few for name in slips.FORCES for mu in (1.0, 0.5)]
    carried = [carry_row(*each) for each in report.progress(carries, "carried")]
    report.write_csv(options.output / "slip.csv", [*rows, *carried])
    print_pulls(rows)
    print_carried(carried)


def far_off(name: str) -> report.Cell:
    """Returns the cell of the median and the largest size of a column."""
    median, most = (
        report.of(name, ".1f", lambda each: np.median(np.abs(each))),
        report.of(name, ".1f", farthest),
    )
    return lambda rows: f"{median(rows)}, {most(rows)}"


def farthest(numbers: Array) -> float:
    """Returns the largest size."""
    return float(np.abs(numbers).max())


def delays(rows: Rows) -> list[float]:
    """Returns the delays of slips that were noticed [ms]."""
    return [float(each) for row in rows for each in row["delays"].split() if each != "-"]


PULLS: dict[str, report.Cell] = {
    "held": report.count,
    "slips": report.of("slips", ".0f", np.sum),
    "missed": lambda rows: str(sum(row["delays"].split().count("-") for row in rows)),
    "precision": report.ratio("right", "alarmed", ".3f"),
    "strict": report.ratio("strict", "alarmed", ".3f"),
    "recall": report.ratio("found", "slipped", ".3f"),
    "delay ms": lambda rows: f"{np.median(delays(rows)):.0f}" if delays(rows) else "-",
    "90 %": lambda rows: f"{np.quantile(delays(rows), 0.9):.0f}" if delays(rows) else "-",
    "friction first %": far_off("learnt first"),
    "end %": far_off("learnt"),
    "way °": report.of("way", ".0f", np.median),
}
THROUGH: dict[str, report.Cell] = {
    "slips kept in the hand": report.count,
    "inside": report.of("inside", ".3f"),
    "error before mm": report.of("before", ".1f", np.median),
    "most mm": report.of("most", ".1f", np.median),
    "in the end mm": report.of("end", ".1f", np.median),
    "most": report.of("end", ".1f", np.max),
}


def print_pulls(rows: Rows) -> None:
    """Prints a line of detections for each object, and two of the tracker's errors."""
    held = [row for row in rows if "slips" in row]
    title = f"Pulls, {len(rows)} in all (synthetic)"
    report.print_by(title, held, "object", PULLS, "friction: median and largest")
    kept = [row for row in held if "inside" in row]
    followed = [
        {"object": row["object"], "known": told, **{name: row[key + name] for name in ("inside", *ERRORS)}}
        for told, key in WAYS
        for row in kept
    ]
    report.print_by("The tracker through them", followed, "object, known", THROUGH, "errors: medians")


def print_carried(rows: Rows) -> None:
    """Alarms of what is carried."""
    cells: dict[str, report.Cell] = {
        "seconds": report.of("seconds", ".0f", np.sum),
        "in alarm s": report.of("alarmed", ".2f", np.sum, 1 / CARRY_RATE),
        "of these wrongly s": report.of("wrong", ".2f", np.sum, 1 / CARRY_RATE),
        "friction off %, most": report.of("learnt", ".1f", lambda learnt: np.abs(learnt).max()),
    }
    rows = [row | {"wrong": row["alarmed"] - row["right"]} for row in rows]
    report.print_by("Carried (synthetic)", rows, "object, friction", cells)


if __name__ == "__main__":
    main()
