"""An object that is moved, lifted and turned in the hand: its pose over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import handsight as hs
from experiments.shared.grasp_errors import pose_errors
from experiments.shared.grasp_methods import LEAST_FINGERS, PAPER
from experiments.shared.grasp_trials import OUTSIDE, exact_model, fingertips, rig, seen_in_palm, vision_prior
from handsight import se3
from handsight.simulation import Sample, Scenario, simulate
from handsight.tracking import TrackerSettings
from handsight.tracking.replay import Step, Tally, replay
from testbed.report import Row, Rows

RATE = 50.0
"""Observations per second; vision measures ten times a second."""
LAST = 2 / 3
"""Share of a run after which errors count: the palm has turned by 75 degrees by then."""
PAPER_TRACKED = "paper-lm, w_n 5 cm"


@dataclass(frozen=True)
class Tracked:
    """The settings of one tracker."""

    outside: bool = False
    table: bool = True


TRACKED = {
    "best": Tracked(table=False),
    "best, table": Tracked(),
    "best, outside, table": Tracked(outside=True),
}


def recorded(name: str, seed: int) -> list[Sample]:
    """Returns all samples of a manipulation."""
    return list(simulate(Scenario(object=name, seed=seed, motion="manipulate", rate=RATE)))


def tracked(name: str, samples: Sequence[Sample], how: Tracked) -> list[Step]:
    """Returns the tracker's estimates in a run."""
    robot = rig() if how.table else replace(rig(), table=None)
    outside = OUTSIDE if how.outside else 0
    settings = TrackerSettings(outside=outside)
    tracker = hs.Tracker(robot, exact_model(name), settings=settings)
    return list(replay((sample.observation for sample in samples), tracker, Tally()))


def turned(samples: Sequence[Any]) -> float:
    """Returns the largest rotation of the palm from the first instant of a run [°]."""
    first = samples[0].observation.T_world_palm[:3, :3]
    turns = [se3.rotation_log(s.observation.T_world_palm[:3, :3] @ first.T) for s in samples]
    return float(np.rad2deg(np.linalg.norm(turns, axis=1).max()))


def run_rows(name: str, seed: int, ways: Mapping[str, Tracked]) -> Rows | None:
    """Returns a row of mean errors for each method, where vision measures late in a run; None if it was dropped."""
    samples = recorded(name, seed)
    if samples[-1].dropped:
        return None
    model, turn = exact_model(name), turned(samples)
    late = {s.observation.stamp: s for s in samples[int(LAST * len(samples)) :] if s.observation.vision}
    rows = []
    for method, how in ways.items():
        steps = [step for step in tracked(name, samples, how) if step.stamp in late]
        found = [
            (step.estimate.T_palm_object, step.estimate.unobservable, late[step.stamp]) for step in steps
        ]
        rows.append(_run_row(model, method, found, [step.fingers for step in steps]))
    found, iterations = by_paper(model, samples)
    last = [one for one in found if one[2].observation.stamp in late]
    rows.append(_run_row(model, PAPER_TRACKED, last, []) | {"iterations": float(np.mean(iterations))})
    return [{"object": name, "seed": seed, "palm turned": turn, **row} for row in rows]


def by_paper(model: hs.ObjectModel, samples: Sequence[Sample]) -> tuple[list[Any], list[int]]:
    """Returns the paper's poses where vision measures, as (pose in the palm, no directions, sample), and iterations."""
    found, iterations = [], []
    for sample in samples:
        if sample.observation.vision is None:
            continue
        T = seen_in_palm(sample.observation)
        contacts = fingertips().contacts(sample.observation).contacts
        if contacts is not None and len(contacts) >= LEAST_FINGERS:
            vision = vision_prior(sample.observation)
            estimate = hs.correct_pose(model, contacts, vision=vision, method=PAPER[PAPER_TRACKED])
            T = estimate.T_palm_object
            iterations.append(estimate.iterations)
        found.append((T, (), sample))
    return found, iterations


def _run_row(model: hs.ObjectModel, method: str, found: Sequence[Any], fingers: Sequence[Any]) -> Row:
    """Returns the mean errors of poses, given as (pose, unobservable directions, sample), and of vision's."""
    ours = [pose_errors(model, T, sample, directions) for T, directions, sample in found]
    seen = [pose_errors(model, seen_in_palm(s.observation), s, directions) for _, directions, s in found]
    row = {"method": method, **{key: float(np.mean([e[key] for e in ours])) for key in ours[0]}}
    row |= {f"vision {key}": float(np.mean([e[key] for e in seen])) for key in seen[0]}
    return row | {"contacts": float(np.mean([len(f) for f in fingers])) if fingers else float("nan")}
