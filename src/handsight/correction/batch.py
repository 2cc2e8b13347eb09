"""Many problems of one object in one call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from handsight.contact import Contacts
from handsight.correction.correct import correct_pose
from handsight.correction.estimate import PoseEstimate, checked_prior
from handsight.correction.mean import with_means
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import MOST_CONTACTS, Problem, check_number
from handsight.correction.solve import solve_batch
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

AT_ONCE = 4096
"""Problems solved in one call of the kernels."""
KEYS = ("contacts", "vision", "outside", "answer", "samples", "budget", "weight", "method")


Arguments = dict[str, Any]
"""Of `correct_pose`, by name."""


def correct_poses(model: ObjectModel, problems: Iterable[object]) -> list[PoseEstimate]:
    """Returns the estimates of many problems of one object, in their order: `correct_pose` of each, on all cores.

    A problem is a mapping of `correct_pose`'s arguments by name (`contacts`, `vision`, `outside`, `answer`, `samples`,
    `budget`, `weight`, `method`), a pair `(contacts, vision)`, or contacts alone, which is blind. Raises InvalidInput
    naming the problem, `problems[3].vision: ...`, before any is solved.
    """
    if not isinstance(model, ObjectModel):
        raise InvalidInput(f"model: expected an ObjectModel, got {type(model).__name__}")
    if isinstance(problems, Contacts | Mapping) or not isinstance(problems, Iterable):
        raise InvalidInput(f"problems: expected a sequence of problems, got {type(problems).__name__}")
    each = [_arguments(problem, f"problems[{i}]") for i, problem in enumerate(problems)]
    found: list[PoseEstimate | None] = [None] * len(each)
    usual = [i for i, problem in enumerate(each) if set(problem) == {"contacts", "vision"}]
    for begin in range(0, len(usual), AT_ONCE):
        rows = usual[begin : begin + AT_ONCE]
        pairs = [(each[i]["contacts"], each[i]["vision"]) for i in rows]
        for i, pair, estimate in zip(rows, pairs, solve_batch(model, pairs), strict=True):
            if estimate is not None:
                found[i] = with_means(Problem(model, *pair, NO_OUTSIDE), estimate, "best")
    return [
        _solved(model, problem, f"problems[{i}]") if estimate is None else estimate
        for i, (problem, estimate) in enumerate(zip(each, found, strict=True))
    ]


def _solved(model: ObjectModel, problem: Arguments, name: str) -> PoseEstimate:
    try:
        return correct_pose(model, **problem)
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {error}") from None


def _arguments(problem: object, name: str) -> Arguments:
    """Returns what `correct_pose` is to be called with; arguments that say nothing are left out."""
    if isinstance(problem, Contacts):
        given: Arguments = {"contacts": problem}
    elif isinstance(problem, Mapping):
        given = dict(problem)
    elif isinstance(problem, tuple | list) and len(problem) == 2:
        given = {"contacts": problem[0], "vision": problem[1]}
    else:
        expected = "expected a mapping, (contacts, vision) or Contacts"
        raise InvalidInput(f"{name}: {expected}, got {type(problem).__name__}")
    for key in given:
        if key not in KEYS:
            raise InvalidInput(f"{name}: expected {', '.join(KEYS)}, got {key!r}")
    contacts = given.get("contacts")
    if not isinstance(contacts, Contacts):
        raise InvalidInput(f"{name}.contacts: expected Contacts, got {type(contacts).__name__}")
    check_number(len(contacts), MOST_CONTACTS, f"{name}.contacts", "contacts")
    given["vision"] = checked_prior(given.get("vision"), f"{name}.vision")
    return {key: value for key, value in given.items() if value is not None}
