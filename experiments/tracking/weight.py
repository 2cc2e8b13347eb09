"""What the weight of a held object tells: its mass, its centre of mass, and through that its pose. Simulated.

The hand lifts an object, tilts it by 20° about two axes, holding still between, and then shakes it (`simulate --motion
weigh`). Usual nuisances; grasps that drop the object are counted. Tables:

  weighing  after so many orientations: error of the centre of mass in the palm [mm] (one: across gravity), that over
            what is claimed (NEES per freedom), error of the mass, of those that are believed; and how many are not
  pose      error of the object's middle [mm] by contacts, vision and the hand, without the weight and with it; what of
            it is across gravity, and along what the fingers grip; and the turn
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
from experiments.shared import wrong_weights
from experiments.shared.grasp_trials import exact_model, fingertips, rig, trial_of
from handsight import se3
from handsight.correction import WeightEvidence
from handsight.forces import SlipDetector, Weigher
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.simulation import Nuisances, Scenario, simulate
from handsight.simulation.motion import AT_REST, LEGS
from handsight.simulation.world import Payload
from handsight.tracking import JointOffsets
from testbed import report, ycb
from testbed.report import Array, Row, Rows

DATA = Path(hs.__file__).parent / "data"
"""The built-in recordings."""
ENDS = AT_REST + np.cumsum(LEGS["weigh"][:, 0])
LIFTED, HOLDS, MOVES = ENDS[1], ENDS[[2, 4, 6, 8, 10]], ENDS[10]
"""When it is lifted, when the holds of the five orientations end, and when it begins to be shaken [s]."""
SIGMA = 1e-3
"""How well the centre of mass in the object is known, per axis [m]."""
MASS = Nuisances().object_mass
ACCELERATIONS = (0.4, 1.0, 2.0)
"""Bounds of the classes of acceleration over which means are taken [m/s²]."""
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
    return Run(scenario, samples, touched, model, center)


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


def evidence(run: Run, weigher: Weigher) -> WeightEvidence | None:
    """The centre of mass as evidence."""
    found = weigher.believed
    if found is None:
        return None
    return WeightEvidence(
        run.center_object, found.center_palm, found.covariance_center + SIGMA**2 * np.eye(3)
    )


def trial(name: str, seed: int) -> Rows:
    """All rows of one grasp."""
    run = recorded(Scenario(object=name, seed=seed, motion="weigh"))
    key = {"object": name, "seed": seed}
    if run is None:
        return [{**key, "table": "dropped"}]
    rows = [{**key, "table": "weighing", **row} for row in _weighing(run)]
    rows += [{**key, "table": "moving", **row} for row in _moving(run)]
    return rows + [{**key, "table": "wrong", **row} for row in wrong_weights.rows(name, seed, HOLDS[2])]


def _weighing(run: Run) -> Iterator[Row]:
    seen: Any = next(s for s in run.samples if s.observation.vision is not None)
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
            "orientations": count, "error": off, "nees": nees, "mass error": 100 * abs(found.mass / MASS - 1),
            "refused": float(given is None), "left out": float(answer.weight_fits is False),
            **{f"without {k}": v for k, v in without.items()}, **{f"with {k}": v for k, v in with_weight.items()},
        }  # fmt: skip


def _moving(run: Run) -> Iterator[Row]:
    """Each mean of 0.2 s from the last hold on: by itself across gravity, and with all that was kept of the holds."""
    kept = {
        sample.observation.stamp: error(run, sample, both, across=False)
        for sample, both in weighed(run, Weigher(rig()))
        if sample.observation.stamp > HOLDS[-1] - 0.6
    }
    for sample, one in weighed(run, Weigher(rig())):
        load, stamp = one._last, sample.observation.stamp
        if load is not None and stamp in kept:
            off, nees = error(run, sample, one, across=True)
            off_kept, nees_kept = kept[stamp]
            yield {"acceleration": faster(np.sqrt(3) * load.acceleration), "error": off, "nees": nees,
                   "error kept": off_kept, "nees kept": nees_kept}  # fmt: skip
        one.forget("")


def faster(acceleration: float) -> str:
    """Returns the class of an acceleration."""
    bounds = (0.0, *ACCELERATIONS, np.inf)
    k = int(np.searchsorted(bounds[1:], acceleration, side="right"))
    return f"{bounds[k]:g} to {bounds[k + 1]:g} m/s²"


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


def numbers(*columns: str) -> dict[str, report.Cell]:
    """Returns cells of means; of those that name millimetres their 90 % quantile too."""
    cells: dict[str, report.Cell] = {}
    for column in columns:
        title, _, name = column.partition(": ")
        cells[title] = report.of(name)
        if title.endswith("mm"):
            cells[f"{title}, p90"] = report.of(name, ".2f", report.quantile(0.9))
    return cells


WEIGHING = {"grasps": report.count} | numbers("mm: error", "NEES: nees", "mass %: mass error")
POSE = numbers(
    "without mm: without pose", "with mm: with pose", "turn °: without turn", "with °: with turn",
)  # fmt: skip
"""What the manual has; the file has the errors across gravity and along normals too."""
MOVING = {"means": report.count} | numbers(
    "mm: error", "NEES: nees", "kept mm: error kept", "its NEES: nees kept"
)
WRONG = {"grasps": report.count} | numbers(
    "noticed by then: ever", "at last: now", "pose: pose", "without: without"
)
WRONG["worse by at most"] = report.of("worse", ".1f", np.max)


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=12, quick_trials=2)
    tasks = [(name, options.first_seed + k) for name in ("box", "can") for k in range(options.trials)]
    rows = [row for found in ycb.in_parallel(trial, tasks, "weight") for row in found]
    tables = {name: report.chosen(rows, table=name) for name in ("weighing", "moving", "wrong", "dropped")}
    for name, mine in tables.items():
        if mine:
            report.write_csv(options.output / f"weight_{name}.csv", mine)
    refused = report.chosen(tables["weighing"], refused=1.0)
    note = f"Refused: {len(refused)} weighings. Dropped: {len(tables['dropped'])} grasps."
    believed = report.chosen(tables["weighing"], refused=0.0)
    report.print_by("Weighing", believed, "object, orientations", WEIGHING, note)
    report.print_by("Pose", tables["weighing"], "object, orientations", POSE)
    report.print_by("Moving", tables["moving"], "object, acceleration", MOVING, detail=True)
    wrong = [row | {"worse": row["pose"] - row["without"]} for row in tables["wrong"]]
    report.print_by("Wrong", wrong, "what", WRONG)
    report.print_by("Wrong, by object", wrong, "what, object", WRONG, detail=True)
    for weighed in (False, True):
        mean, most = after_the_tilt(weighed=weighed)
        told = "with the weight" if weighed else "without"
        print(f"box.mcap after its tilt, {told}: {1e3 * mean:.1f} mm, {1e3 * most:.1f} at most")


if __name__ == "__main__":
    main()
