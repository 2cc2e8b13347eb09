"""What the weight of a held object tells: its mass, its centre of mass, and through that its pose. Simulated.

The hand lifts an object, tilts it by 20° about two axes, holding still between, and then shakes it (`simulate --motion
weigh`). Usual nuisances; grasps that drop the object are counted. Tables:

  weighing  after so many orientations: error of the centre of mass in the palm [mm] (one: across gravity), that over
            what is claimed (NEES per freedom), error of the mass, of those that are believed; and how many are not
  gains     the same where each axis of each sensor reads too much by a share of 3 %, one sigma
  pose      error of the object's middle [mm] by contacts, vision and the hand, without the weight, with it, and with
            their joints' errors shared; what of it is across gravity, and along what the fingers grip; and the turn
  moving    the centre by the palm's acceleration: by single means of 0.2 s (across gravity less the acceleration, along
            which it hangs), and with what was kept of the holds before (in space)
  wrong     whether a tracker says that something is wrong, until the third hold and at its end, and the pose's error
            there with the weight and without it; vision stays on

At last the demo's recording of a box, tracked without vision after its first second: how far the pose is off after the
tilt [mm], with the weight and without.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.correction import WeightEvidence
from handsight.forces import SlipDetector, Weigher
from handsight.objects import Symmetries
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.simulation import MOTION, Nuisances, Scenario, simulate
from handsight.simulation.motion import WEIGH_LEGS
from handsight.simulation.world import Payload
from handsight.tracking import JointOffsets
from shared import report, wrong_weights, ycb
from shared.grasp_trials import exact_model, fingertips, rig, trial_of
from shared.weight_tables import show
from testbed.report import Array, Row, Rows

DATA = Path(hs.__file__).parent / "data"
"""The built-in recordings."""
ENDS = MOTION.at_rest + np.cumsum(WEIGH_LEGS[:, 0])
LIFTED, HOLDS, MOVES = ENDS[1], ENDS[[2, 4, 6, 8, 10]], ENDS[10]
"""When it is lifted, when the holds of the five orientations end, and when it begins to be shaken [s]."""
SIGMA = 1e-3
"""How well the centre of mass in the object is known, per axis [m]."""
MASSES = (
    (0.15, 0.0),
    (0.05, 0.02),
    (0.1, 0.02),
    (0.2, 0.02),
    (0.3, 0.02),
    (0.08, 0.0),
    (0.4, 0.0),
    (0.5, 0.0),
)
"""Mass [kg], and how far its centre is off the middle [m]."""
GAIN = 0.03
"""Sigma of the relative error of each axis of a sensor, in the table of gains."""
SEEN_FOR, TILTED = 1.0, 12.5
"""How long vision measures the demo's box, and when its tilt begins [s]."""


@dataclass(frozen=True)
class Run:
    """Returns a weighing, with sensors read a hundred times a second."""

    scenario: Scenario
    samples: Sequence[Any]
    touched: Sequence[Any]
    """The contacts of each sample."""
    model: hs.ObjectModel
    center_object: Array


def recorded(scenario: Scenario) -> Run | None:
    """Returns the run from the lift on; None where the object was dropped."""
    samples = list(simulate(scenario))
    if samples[-1].dropped:
        return None
    samples = [sample for sample in samples if sample.observation.stamp >= LIFTED]
    touched = [fingertips().contacts(sample.observation) for sample in samples]
    model, center = exact_model(scenario.object), Payload.of(scenario).scene.model.body("object").ipos.copy()
    if np.linalg.norm(center) > 1e-6:
        model = model.with_symmetries(Symmetries())  # what is heavier on one side is not symmetric
    return Run(scenario, samples, touched, model, center)


def gained(run: Run) -> Run:
    """Returns the run as sensors with wrong gains would have read it."""
    rng, samples = np.random.default_rng((run.scenario.seed, 13)), []
    gains = {name: GAIN * rng.normal(size=6) for name in rig().fingers}
    for sample in run.samples:
        observation, wrenches = sample.observation, {}
        for name, wrench in observation.wrenches.items():
            known = rig().fingers[name].calibration
            unloaded = np.concatenate([known.bias_force, known.bias_torque])
            wrenches[name] = wrench + gains[name] * (wrench - unloaded)
        samples.append(replace(sample, observation=replace(observation, wrenches=wrenches)))
    touched = [fingertips().contacts(sample.observation) for sample in samples]
    return replace(run, samples=samples, touched=touched)


def weighed(run: Run, weigher: Weigher) -> Iterator[tuple[Any, Weigher]]:
    """Yields each sample that completes a new weighing."""
    offsets, slip = JointOffsets.of(rig()), SlipDetector(rig())
    joints = offsets.mean, offsets.root
    for sample, touch in zip(run.samples, run.touched, strict=True):
        pivots = slip.update(sample.observation.stamp, touch.fingers, touch.loads).pivots
        if weigher.update(sample.observation, touch.fingers, touch.contacts, joints, pivots=pivots):
            yield sample, weigher


def error(run: Run, sample: Any, weigher: Weigher, *, across: bool) -> tuple[float, float]:
    """Returns the error of the centre of mass in the palm [mm], and its NEES per freedom, horizontally or in space."""
    found, T, load = weigher.weighing, sample.T_palm_object, weigher._last
    assert found is not None
    assert load is not None
    # What hangs on an accelerated hand hangs along gravity less the acceleration.
    axes = np.linalg.svd(load.gravity[None])[2][1:] if across else np.eye(3)
    off = axes @ (found.center_palm - (T[:3, :3] @ run.center_object + T[:3, 3]))
    nees = off @ np.linalg.solve(axes @ found.covariance_center @ axes.T, off) / len(off)
    return 1e3 * float(np.linalg.norm(off)), float(nees)


def across_gravity(sample: Any) -> Array:
    """Returns two horizontal directions (2, 3) in the palm."""
    down = sample.observation.T_world_palm[2:3, :3]
    return np.asarray(np.linalg.svd(down)[2][1:])


def gripped(run: Run, sample: Any) -> Array:
    """Returns the unit direction (3,) in the palm along which most of the contacts' normals are, up to its sign."""
    held = trial_of(run.scenario, sample, run.model)
    assert held is not None
    return np.asarray(np.linalg.svd(held.contacts.normals_palm)[2][0])


def of_hold(stamp: float) -> int:
    """Returns the number of the orientation whose last mean ends at a stamp, from 1 on; 0: none."""
    near = np.flatnonzero((HOLDS - stamp > -1e-6) & (HOLDS - stamp < 0.2))
    return int(near[0]) + 1 if len(near) else 0


def pose_error(run: Run, sample: Any, weight: WeightEvidence | None) -> tuple[Row, Any]:
    """Returns the pose's error [mm] with and without a weight, by contacts, vision and the hand; and the estimate."""
    trial = trial_of(run.scenario, sample, run.model)
    assert trial is not None
    found = hs.correct_pose(
        run.model, trial.contacts, vision=trial.vision, outside=trial.outside, weight=weight
    )
    return errors_of(run, sample, found.T_palm_object), found


def errors_of(run: Run, sample: Any, T: Array) -> Row:
    """Returns errors of a pose: the middle's in space, horizontally and along the grip [mm], and the rotation's [°]."""
    T_true, middle = sample.T_palm_object, run.model.center_object
    T = run.model.nearest(T, T_true)
    off = (T[:3, :3] @ middle + T[:3, 3]) - (T_true[:3, :3] @ middle + T_true[:3, 3])
    return {
        "pose": 1e3 * float(np.linalg.norm(off)),
        "across": 1e3 * float(np.linalg.norm(across_gravity(sample) @ off)),
        "normal": 1e3 * abs(float(gripped(run, sample) @ off)),
        "turn": float(np.rad2deg(np.linalg.norm(se3.rotation_log(T[:3, :3] @ T_true[:3, :3].T)))),
    }


def shared(run: Run, sample: Any, weigher: Weigher, answer: Any) -> Row:
    """Returns the errors after contacts and weight have shared their joints' errors."""
    trial, weighing = trial_of(run.scenario, sample, run.model), weigher.believed
    assert trial is not None
    given = evidence(run, weigher)
    if weighing is None or given is None or trial.touch.by_error is None or not answer.weight_fits:
        return errors_of(run, sample, answer.T_palm_object)
    touch, offsets = (trial.contacts, trial.touch.by_error), JointOffsets.of(rig())
    found = offsets.shared(run.model, answer, touch, trial.vision, (weighing, given))
    return errors_of(run, sample, found.T_palm_object)


def evidence(run: Run, weigher: Weigher) -> WeightEvidence | None:
    """The centre of mass as evidence."""
    found = weigher.believed
    if found is None:
        return None
    return WeightEvidence(
        run.center_object, found.center_palm, found.covariance_center + SIGMA**2 * np.eye(3)
    )


def trial(name: str, seed: int, mass: float, off: float) -> Rows:
    """All rows of one grasp."""
    nuisances = replace(Nuisances(), object_mass=mass, object_off_center=off)
    run = recorded(Scenario(object=name, seed=seed, motion="weigh", nuisances=nuisances))
    key = {"object": name, "seed": seed, "mass": mass, "off": 1e3 * off}
    if run is None:
        return [{**key, "table": "dropped"}]
    rows = [{**key, "table": "weighing", **row} for row in _weighing(run)]
    if mass == MASSES[0][0]:
        rows += [{**key, "table": "gains", **row} for row in _weighing(gained(run))]
        rows += [{**key, "table": "moving", **row} for row in _moving(run)]
        rows += [{**key, "table": "wrong", **row} for row in wrong_weights.rows(name, seed, HOLDS[2])]
    return rows


def _weighing(run: Run) -> Iterator[Row]:
    seen: Any = next(s for s in run.samples if s.observation.vision is not None)
    mass = run.scenario.nuisances.object_mass
    for sample, weigher in weighed(run, Weigher(rig())):
        count = of_hold(sample.observation.stamp)
        found = weigher.weighing
        if not count or found is None:
            continue
        # Vision sees ten times a second.
        stamp = sample.observation.stamp
        seen = next(
            s for s in run.samples if s.observation.vision is not None and s.observation.stamp > stamp - 0.1
        )
        off, nees = error(run, sample, weigher, across=count == 1)
        without, _ = pose_error(run, seen, None)
        given = evidence(run, weigher)
        with_weight, answer = pose_error(run, seen, given)
        yield {
            "orientations": count, "error": off, "nees": nees, "mass error": 100 * abs(found.mass / mass - 1),
            "refused": float(given is None), "left out": float(answer.weight_fits is False),
            **{f"without {k}": v for k, v in without.items()}, **{f"with {k}": v for k, v in with_weight.items()},
            **{f"shared {k}": v for k, v in shared(run, seen, weigher, answer).items()},
        }  # fmt: skip


def _moving(run: Run) -> Iterator[Row]:
    """Each mean of 0.2 s from the last hold on: by itself across gravity, and with all that was kept of the holds."""
    alone, kept = weighed(run, Weigher(rig())), weighed(run, Weigher(rig()))
    for (sample, one), (_, both) in zip(alone, kept, strict=True):
        load = one._last
        if load is not None and sample.observation.stamp > HOLDS[-1] - 0.6:
            off, nees = error(run, sample, one, across=True)
            off_kept, nees_kept = error(run, sample, both, across=False)
            yield {"acceleration": np.sqrt(3) * load.acceleration, "error": off, "nees": nees,
                   "error kept": off_kept, "nees kept": nees_kept}  # fmt: skip
        one.forget("")


def after_the_tilt(*, weighed: bool) -> tuple[float, float]:
    """Mean and most of the box's error in the demo's recording, with vision in its first second alone [m]."""
    robot = Rig.from_file(DATA / "box.rig.yaml")
    model = robot.objects["box"].model()
    tracker, errors = hs.Tracker(robot, model if weighed else replace(model, center_of_mass=None)), []
    with open_recording(DATA / "box.mcap", robot) as recording:
        observations, truth = list(recording.observations()), recording.truth
    stamps, begun = np.array([stamp for stamp, _ in truth]), observations[0].stamp
    for each in observations:
        seen = each.vision if each.stamp < begun + SEEN_FOR else None
        estimate = tracker.update(replace(each, vision=seen))
        if estimate is not None and each.stamp > begun + TILTED:
            T_palm_object = truth[int(np.abs(stamps - each.stamp).argmin())][1]
            errors.append(np.linalg.norm(estimate.T_palm_object[:3, 3] - T_palm_object[:3, 3]))
    return float(np.mean(errors)), float(np.max(errors))


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    arguments.add_argument(
        "--only", action="append", metavar="MASS", type=report.amount, help="[kg]; repeatable (default: all)"
    )
    options, given = report.parsed(arguments, trials=12, quick_trials=2)
    masses = [pair for pair in MASSES if given.only is None or pair[0] in given.only]
    masses = masses[:1] if options.quick else masses
    tasks = [
        (name, options.first_seed + k, mass, off)
        for name in ("box", "can")
        for mass, off in masses
        for k in range(options.trials if mass == MASSES[0][0] else max(options.trials // 3, 1))
    ]
    rows = [row for found in ycb.in_parallel(trial, tasks, "weight") for row in found]
    for table in ("weighing", "gains", "moving", "wrong"):
        if mine := report.chosen(rows, table=table):
            report.write_csv(options.output / f"weight_{table}.csv", mine)
    show(rows)
    for weighed in (False, True):
        mean, most = after_the_tilt(weighed=weighed)
        told = "with the weight" if weighed else "without"
        print(f"box.mcap after its tilt, {told}: {1e3 * mean:.1f} mm, {1e3 * most:.1f} at most")


if __name__ == "__main__":
    main()
