"""One correction as a `Problem`, with its inputs checked and as records for the kernels; its options and its budget."""

import time
from collections.abc import Generator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from handsight import checks
from handsight._kernels.records import CONSTRAINTS, CONTACT, DESCENT
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction.depth import DepthPoints
from handsight.correction.estimate import PosePrior
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

Records = NDArray[np.void]
"""NumPy structured values of a type in `_kernels/records.py`."""

T = TypeVar("T")
Steps = Generator[None, None, T]
"""A computation that pauses every millisecond or so: `finished` runs all of it, a tracker a few steps an update."""

MOST_CONTACTS = 20_000
"""Contacts of one correction; time and memory are linear in their number."""
MOST_STARTS = 1_000_000


@dataclass(frozen=True, slots=True)
class TwoPhase:
    """A `TwoPhase` has the options of handsight's own method."""

    starts: int | None = None
    """Number of descents, from draws of the prior; None: as many as the prior's width requires, and more if none fits.
    Without vision it has no effect."""
    reject_outliers: bool = True
    """Whether a wrong contact is searched for when the contacts do not fit together."""

    def __post_init__(self) -> None:
        given = self.starts
        is_integer = isinstance(given, int) and not isinstance(given, bool)
        if given is not None and not (is_integer and 1 <= given <= MOST_STARTS):
            raise InvalidInput(
                f"starts: expected a whole number from 1 to {MOST_STARTS}, got {checks.brief(given)}"
            )


@dataclass(slots=True)
class Budget:
    """A `Budget` is the time at which a search has to end, and whether it was cut short by that."""

    ends: float = np.inf
    """The end of the search, by `time.perf_counter` [s]."""
    cut_short: bool = False

    @classmethod
    def of(cls, seconds: float | None) -> "Budget":
        """Returns a budget of so many seconds from now; None: without an end. Raises InvalidInput."""
        return cls() if seconds is None else cls(time.perf_counter() + checks.positive(seconds, "budget"))

    def spent(self) -> bool:
        """Returns whether the time is over; then it sets `cut_short`, as the caller skips the rest of the search."""
        self.cut_short = self.cut_short or time.perf_counter() >= self.ends
        return self.cut_short


@dataclass(frozen=True)
class Problem:
    """A `Problem` is the evidence of one correction."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    outside: Records
    """(m,) OUTSIDE."""
    weight: WeightEvidence | None = None
    depth: DepthPoints | None = None
    taxels: int = 0
    """How many of the contacts, the last ones, are pressed taxels of tactile arrays."""
    on_skin: bool = False
    """Whether taxels of tactile arrays are among the evidence."""
    starts: Array | None = None
    """(K, 4, 4) poses to descend from on the fine field; None: draws from the prior, in two phases."""
    doubted: bool = False
    """Whether one descent from vision's pose is known not to be enough."""

    def __post_init__(self) -> None:
        check_number(len(self.contacts), MOST_CONTACTS, "contacts", "contacts")

    @property
    def blind(self) -> bool:
        """Whether there is no vision."""
        return self.vision is None

    @cached_property
    def constraints(self) -> Records:
        """(1,) CONSTRAINTS: the prior, the object's weight and depth points, each if it is given."""
        record = np.zeros(1, dtype=CONSTRAINTS) if self.vision is None else self.vision.record
        for evidence in (self.weight, self.depth):
            record = record if evidence is None else evidence.added_to(record)
        return record

    @cached_property
    def rows_each(self) -> Indices:
        """(n,) the rows of evidence of each contact."""
        return np.asarray(1 + 2 * self.contacts.has_normal)

    @cached_property
    def rows(self) -> int:
        """The rows of evidence beside the prior."""
        return self.freedom(np.ones((1, len(self.contacts)), dtype=bool)) + (6 if self.blind else 0)

    def arguments(self, used: Mask) -> tuple[Records, Any, Records, Records, Records]:
        """Returns model, nodes, contacts, constraints and outside rows as kernels take them, the contacts once for each
        row of `used` (K, n)."""
        return *self.model.record[:2], self.sets(used), self.constraints, self.outside

    def sets(self, used: Mask) -> Records:
        """Returns (K, n) CONTACT: the contacts once for each row of `used` (K, n)."""
        contacts = np.empty(used.shape, dtype=CONTACT)
        plain(contacts)[:] = plain(self.contacts.record)
        contacts["used"] = used
        return contacts

    def freedom(self, used: Mask) -> int:
        """Returns the degrees of freedom of the χ² at a mode: the rows of evidence, less six if there is no prior."""
        rows = int(np.count_nonzero(used[0]) + 2 * np.count_nonzero(used[0] & self.contacts.has_normal))
        rows += 0 if self.weight is None else 3
        if self.depth is not None:
            rows += min(len(self.depth), 6)  # all of them together count as the one pose of their image
        return max(rows - 6, 1) if self.blind else rows


def finished(steps: Steps[T]) -> T:
    """Returns the result of a computation, without a pause."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]


def check_number(n: int, most: int, name: str, what: str) -> None:
    """Raises InvalidInput, which begins with `name`, where `n` is more than `most`; `what` is what is counted."""
    if n > most:
        raise InvalidInput(f"{name}: expected at most {most} {what}, got {n}")


def plain(records: Records) -> Array:
    """Returns records (...) as a view of their numbers (..., w), which NumPy copies ten times faster."""
    return records.view(np.float64).reshape(*records.shape, -1)


def taken(records: Records, rows: Indices) -> Records:
    """Returns `records[rows]`, a copy, in a tenth of the time."""
    return np.asarray(plain(records)[rows].view(records.dtype)[:, 0])


def descents_at(Ts_palm_object: Array) -> Records:
    """Returns (K,) DESCENT whose poses are the given ones (K, 4, 4), and the rest zero."""
    descents = np.zeros(len(Ts_palm_object), dtype=DESCENT)
    descents["pose"]["rotation"] = Ts_palm_object[:, :3, :3]
    descents["pose"]["position"] = Ts_palm_object[:, :3, 3]
    return descents


def poses_of(descents: Records) -> Array:
    """Returns the poses (K, 4, 4) of descents, or of other records with a POSE."""
    Ts = np.zeros((len(descents), 4, 4))
    Ts[:, :3, :3], Ts[:, :3, 3] = descents["pose"]["rotation"], descents["pose"]["position"]
    Ts[:, 3, 3] = 1.0
    return Ts
