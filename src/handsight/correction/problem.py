"""One correction, its inputs checked, as kernels take it; and how long it may search."""

import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

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

MOST_CONTACTS = 256
"""Contacts of one correction: more than any hand has, and time and memory grow with their number."""
MOST_STARTS = 1_000_000


@dataclass(frozen=True, slots=True)
class TwoPhase:
    """A `TwoPhase` says how handsight's own method runs; the defaults choose themselves from the problem."""

    starts: int | None = None
    """Number of descents from draws of the prior; None: by the prior's width, and more if none fits."""
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
    """A `Budget` is the time at which a search has to end, and whether that has cut it short."""

    ends: float = np.inf
    """By `time.perf_counter` [s]."""
    cut_short: bool = False

    @classmethod
    def of(cls, seconds: float | None) -> "Budget":
        """Returns a budget from now on; None: without an end. Raises InvalidInput."""
        return cls() if seconds is None else cls(time.perf_counter() + checks.positive(seconds, "budget"))

    def spent(self) -> bool:
        """Returns whether it is over, and notes it, for the caller then leaves something out."""
        self.cut_short = self.cut_short or time.perf_counter() >= self.ends
        return self.cut_short


@dataclass(frozen=True)
class Problem:
    """A `Problem` is one correction."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    outside: Records
    """(m,) OUTSIDE."""
    weight: WeightEvidence | None = None
    depth: DepthPoints | None = None
    starts: Array | None = None
    """(K, 4, 4) to descend from on the fine field; None: from the prior, in two phases."""

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
        """Returns the degrees of freedom of the χ² at a mode: the rows of evidence, less six where the pose is free."""
        rows = int((used * (1 + 2 * self.contacts.has_normal)).sum()) + (0 if self.weight is None else 3)
        rows += (
            0 if self.depth is None else min(len(self.depth), 6)
        )  # they stand for the one pose of their image
        return max(rows - 6, 1) if self.blind else rows


def check_number(n: int, most: int, name: str, what: str) -> None:
    """Raises InvalidInput where there are more than `most` of them."""
    if n > most:
        raise InvalidInput(f"{name}: expected at most {most} {what}, got {n}")


def plain(records: Records) -> Array:
    """Returns the numbers (..., w) of records (...), which NumPy copies ten times faster than structured rows."""
    return records.view(np.float64).reshape(*records.shape, -1)


def taken(descents: Records, rows: Indices) -> Records:
    """Returns the descents (K,) at K indices of descents (n,)."""
    return np.asarray(plain(descents)[rows].view(DESCENT)[:, 0])


def descents_at(Ts_palm_object: Array) -> Records:
    """Returns (K,) DESCENT that begin at poses (K, 4, 4)."""
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
