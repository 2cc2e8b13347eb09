"""One correction, its inputs checked, as kernels take it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from handsight import checks
from handsight._kernels.records import CONSTRAINTS, CONTACT, DESCENT
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction.estimate import PosePrior
from handsight.correction.weight import WeightEvidence
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

Records = NDArray[np.void]

MOST_CONTACTS = 256
"""Contacts of one correction. A hand has a few dozen at most; up to here time and memory grow as their number does."""
MOST_STARTS = 1_000_000
NO_CONSTRAINTS = np.zeros(1, dtype=CONSTRAINTS)


@dataclass(frozen=True, slots=True)
class TwoPhase:
    """A `TwoPhase` says how handsight's own method runs; the defaults choose themselves from the problem."""

    starts: int | None = None
    """Descents begun from draws of the prior; None: from the prior's width, and more if none fits."""
    reject_outliers: bool = True
    """Look for a contact that is wrong when the contacts do not fit together."""

    def __post_init__(self) -> None:
        given = self.starts
        is_integer = isinstance(given, int) and not isinstance(given, bool)
        if given is not None and not (is_integer and 1 <= given <= MOST_STARTS):
            raise InvalidInput(
                f"starts: expected a whole number from 1 to {MOST_STARTS}, got {checks.brief(given)}"
            )


@dataclass(frozen=True)
class Problem:
    """A `Problem` is one correction."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    outside: Records
    """(m,) OUTSIDE."""
    weight: WeightEvidence | None = None
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
        """(1,) CONSTRAINTS: the prior and the object's weight, each if it is given."""
        record = NO_CONSTRAINTS if self.vision is None else self.vision.record
        return record if self.weight is None else self.weight.added_to(record)

    def sets(self, used: Mask) -> Records:
        """Returns (K, n) CONTACT: the contacts once for each row of `used` (K, n)."""
        contacts = np.empty(used.shape, dtype=CONTACT)
        plain(contacts)[:] = plain(self.contacts.record)
        contacts["used"] = used
        return contacts

    def freedom(self, used: Mask) -> int:
        """Returns the degrees of freedom of the χ² at a mode: rows of evidence less what the pose can take up."""
        rows = int((used * (1 + 2 * self.contacts.has_normal)).sum()) + (0 if self.weight is None else 3)
        return max(rows - 6, 1) if self.blind else rows


def check_number(n: int, most: int, name: str, what: str) -> None:
    """Raises InvalidInput where there are more than `most` of them."""
    if n > most:
        raise InvalidInput(f"{name}: expected at most {most} {what}, got {n}")


def plain(records: Records) -> Array:
    """Returns (..., w) the numbers of records (...), for NumPy copies structured rows ten times slower than these."""
    return records.view(np.float64).reshape(*records.shape, -1)


def taken(descents: Records, rows: Indices) -> Records:
    """Returns (K,) those of descents (n,) that are at K indices."""
    return np.asarray(plain(descents)[rows].view(DESCENT)[:, 0])


def descents_at(Ts_palm_object: Array) -> Records:
    """Returns (K,) DESCENT that begin at poses (K, 4, 4)."""
    descents = np.zeros(len(Ts_palm_object), dtype=DESCENT)
    descents["pose"]["rotation"] = Ts_palm_object[:, :3, :3]
    descents["pose"]["position"] = Ts_palm_object[:, :3, 3]
    return descents


def poses_of(descents: Records) -> Array:
    """Returns (K, 4, 4) of descents, or whatever has a POSE."""
    Ts = np.zeros((len(descents), 4, 4))
    Ts[:, :3, :3], Ts[:, :3, 3] = descents["pose"]["rotation"], descents["pose"]["position"]
    Ts[:, 3, 3] = 1.0
    return Ts
