"""Tactile arrays as evidence of a correction: which taxels touch the object, and how wrong an array is as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.contact.taxels import SkinTouch
from handsight.errors import InvalidInput
from handsight.representation import short_repr


@dataclass(frozen=True, slots=True, eq=False)
class SkinEvidence:
    """A `SkinEvidence` says where the taxels of tactile arrays touch the object, and where it does not reach.

    A pressed taxel is a contact and an untouched one a point outside the object, but all are wrong together with their
    array, so the answer is as uncertain as that. A face that lies on the array ends where the untouched taxels begin,
    which gives the cost no slope: the search has starts of its own.
    """

    contacts: Contacts | None
    """The pressed taxels in the palm; None where none is."""
    untouched_palm: Array
    """(m, 3) points above untouched taxels, which the object does not cover [m]."""
    sigmas: Array
    """(6,) how wrong the arrays are as a whole: one standard deviation per axis of shift [m] and turn [rad], along the
    palm's axes."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        if not isinstance(self.contacts, Contacts | None):
            raise InvalidInput(
                f"skin.contacts: expected Contacts or None, got {type(self.contacts).__name__}"
            )
        points = np.reshape(np.asarray(self.untouched_palm, dtype=np.float64), (-1, 3))
        object.__setattr__(self, "untouched_palm", checks.position(points, "skin.untouched_palm", (None, 3)))
        object.__setattr__(self, "sigmas", checks.finite(self.sigmas, "skin.sigmas", (6,)))

    @classmethod
    def of(cls, touch: SkinTouch, T_palm_frame: ArrayLike, by_error: ArrayLike | None = None) -> SkinEvidence:
        """Returns the evidence of an array's taxels.

        `T_palm_frame` (4, 4): the pose of its link. `by_error` (6, j): how that moves [m] and turns [rad] in the palm
        for one standard deviation of each of j errors of its joints; None: it is fixed in the palm.
        """
        array = touch.array
        # Its height is as wrong at one side as at the other: what is soft gives way more where it is pressed more.
        turn = 2 * array.sigma_mount / (array.pitch * min(array.shape))
        variance = np.repeat([array.sigma_mount**2, turn**2], 3)
        if by_error is not None:
            variance = variance + (np.asarray(by_error) ** 2).sum(axis=1)
        return cls(touch.contacts(T_palm_frame), touch.outside(T_palm_frame), np.sqrt(variance))

    def joined(self, other: SkinEvidence) -> SkinEvidence:
        """Returns the evidence of both; an answer by both is as uncertain as the worse of the two, axis by axis."""
        mine, theirs = self.contacts, other.contacts
        return SkinEvidence(
            mine.joined(theirs) if mine is not None and theirs is not None else mine or theirs,
            np.concatenate([self.untouched_palm, other.untouched_palm]),
            np.maximum(self.sigmas, other.sigmas),
        )
