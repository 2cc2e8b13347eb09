"""The built-in example: a can and a box held by five fingers, vision 8 cm off. Synthetic, with known truth."""

import contextlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from handsight import se3
from handsight.batch.problems import Problem, Reader, answer
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.objects.symmetry import nearest

NAMES = ("can", "box")


@dataclass(frozen=True)
class Comparison:
    """One example's errors against its truth, modulo the object's symmetry: vision's first, then corrected."""

    name: str
    problem: Problem
    answered: dict[str, Any]
    shift: tuple[float, float]
    """Of the object's middle [m]."""
    shift_seen: tuple[float, float]
    """The part of it that the contacts can see [m]."""
    turn: tuple[float, float]
    """[rad]."""
    gap: tuple[float, float]
    """Mean distance of the contacts to the object's surface [m]."""


def examples() -> Iterator[Comparison]:
    """Solves the problems of `data/demo.jsonl` and compares them with `data/demo_truth.jsonl`."""
    reader = Reader(Path.cwd())
    for name, line, truth in zip(NAMES, _lines("demo.jsonl"), _lines("demo_truth.jsonl"), strict=True):
        problem = reader.read(line.encode())
        answered = answer(problem)
        yield compared(name, problem, answered, json.loads(truth))


@contextlib.contextmanager
def recordings() -> Iterator[dict[str, Path]]:
    """By object, the built-in recordings, each with its rig beside it."""
    with contextlib.ExitStack() as stack:
        data = resources.files("handsight").joinpath("data")
        folder = stack.enter_context(resources.as_file(data))
        yield {name: folder / f"{name}.mcap" for name in NAMES}


def compared(name: str, problem: Problem, answered: dict[str, Any], truth: dict[str, Any]) -> Comparison:
    """The errors of vision and of an answer against the true pose, given as the contract writes poses."""
    if problem.vision is None:
        raise InvalidInput("vision: expected a pose to compare with, got none")
    T_true = se3.from_position_quaternion(truth["position"], truth["quaternion_xyzw"])
    T_answer = se3.from_position_quaternion(answered["position"], answered["quaternion_xyzw"])
    poses = (problem.vision.T_palm_object, T_answer)
    open_directions = np.asarray(answered["unobservable"]).reshape(-1, 6)
    errors = [_errors(problem, T, T_true, open_directions) for T in poses]
    first, second = errors
    gaps = [_gap(problem, T) for T in poses]
    return Comparison(
        name,
        problem,
        answered,
        shift=(first[0], second[0]),
        shift_seen=(first[1], second[1]),
        turn=(first[2], second[2]),
        gap=(gaps[0], gaps[1]),
    )


def _errors(problem: Problem, T: Array, T_true: Array, open_directions: Array) -> tuple[float, float, float]:
    model = problem.model
    equivalent = nearest(model.symmetries, T_true, T, model.radius)
    delta = se3.difference(T, equivalent) * np.array([1.0] * 3 + [model.radius] * 3)
    seen = delta - open_directions.T @ (open_directions @ delta)
    return (
        float(np.linalg.norm(delta[:3])),
        float(np.linalg.norm(seen[:3])),
        float(np.linalg.norm(delta[3:]) / model.radius),
    )


def _gap(problem: Problem, T: Array) -> float:
    points_object = se3.apply(se3.inverse(T), problem.contacts.points_palm)
    return float(np.abs(problem.model.fine.evaluate(points_object).distance).mean())


def _lines(name: str) -> list[str]:
    return resources.files("handsight").joinpath("data", name).read_text(encoding="utf-8").splitlines()
