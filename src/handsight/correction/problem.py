"""One correction as a `Problem`, with its inputs checked and as records for the kernels."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._compiled.records import CONSTRAINTS, DESCENT
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction.estimate import PosePrior
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

Records = NDArray[np.void]
"""NumPy structured values of a type in `_compiled/records.py`."""

FEW = 64
"""Contacts up to which all of them take part in the search, if none share an error; of more, so many do."""
MOST_CONTACTS = 20_000
"""Contacts of one correction; time and memory are linear in their number."""


@dataclass(frozen=True)
class Problem:
    """The evidence of one correction."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    outside: Records
    """(m,) OUTSIDE."""
    weight: WeightEvidence | None = None
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
    def registered(self) -> bool:
        """Whether the contacts are so many, or share errors, that the pose is found by registration."""
        return is_registered(self.contacts)

    @property
    def blind(self) -> bool:
        """Whether there is no vision."""
        return self.vision is None

    @cached_property
    def constraints(self) -> Records:
        """(1,) CONSTRAINTS: the prior and the object's weight, each if it is given."""
        record = np.zeros(1, dtype=CONSTRAINTS) if self.vision is None else self.vision.record
        return record if self.weight is None else self.weight.added_to(record)

    @property
    def everyone(self) -> Mask:
        """(1, n) that all contacts are in use."""
        return np.ones((1, len(self.contacts)), dtype=bool)

    @cached_property
    def rows_each(self) -> Indices:
        """(n,) the rows of evidence of each contact."""
        return np.asarray(1 + 2 * self.contacts.has_normal)

    @cached_property
    def rows(self) -> int:
        """The rows of evidence beside the prior."""
        return self.freedom(self.everyone) + (6 if self.blind else 0)

    def arguments(self, used: Mask) -> tuple[Records, Any, Records, Records, Records]:
        """Returns model, nodes, contacts, constraints and outside rows as kernels take them, the contacts once for each
        row of `used` (K, n)."""
        return *self.model.record[:2], self.sets(used), self.constraints, self.outside

    def sets(self, used: Mask) -> Records:
        """Returns (K, n) CONTACT: the contacts once for each row of `used` (K, n)."""
        contacts = np.repeat(self.contacts.record[None], len(used), axis=0)
        contacts["used"] = used
        return contacts

    def freedom(self, used: Mask, walls: int = 0) -> int:
        """Returns the degrees of freedom of the χ² at a mode that meets so many walls, links or planes: the rows of
        evidence, less six if there is no prior."""
        rows = int(used[0] @ self.rows_each) + walls
        if self.weight is not None:
            rows += 3
        return max(rows - 6, 1) if self.blind else rows


def is_registered(contacts: Contacts) -> bool:
    """Returns whether a correction by these contacts is by registration."""
    return len(contacts.points_palm) > FEW or len(contacts.shared_covariance) > 0


def check_number(n: int, most: int, name: str, what: str) -> None:
    """Raises InvalidInput, which begins with `name`, where `n` is more than `most`; `what` is what is counted."""
    if n > most:
        raise InvalidInput(f"{name}: expected at most {most} {what}, got {n}")


def descents_at(Ts_palm_object: Array) -> Records:
    """Returns (K,) DESCENT whose poses are the given ones (K, 4, 4), and the rest zero."""
    descents = np.zeros(len(Ts_palm_object), dtype=DESCENT)
    descents["pose"]["rotation"] = Ts_palm_object[:, :3, :3]
    descents["pose"]["position"] = Ts_palm_object[:, :3, 3]
    return descents


def poses_of(descents: Records | np.void) -> Array:
    """Returns the poses (..., 4, 4) of descents (...), or of other records with a POSE."""
    return se3.compose(descents["pose"]["rotation"], descents["pose"]["position"])
