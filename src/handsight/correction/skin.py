"""Tactile arrays as evidence: which taxels touch the object, which do not, and the common error of an array."""

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
    """The pressed and the untouched taxels of tactile arrays in the palm.

    A pressed taxel is a contact, an untouched one a point outside the object. All taxels of an array share the error of
    its position, which is added to the covariance of the answer. A face of the object that lies on an array ends where
    untouched taxels begin; the cost has no slope that leads there, so the answer is the mean of draws (`open_draws`).
    """

    contacts: Contacts | None
    """The pressed taxels in the palm frame; None if no taxel is pressed."""
    untouched_palm: Array
    """(m, 3) points just above untouched taxels, which cannot be inside the object [m]."""
    sigmas: Array
    """(6,) one standard deviation per axis of the arrays' common error, shift [m] and turn [rad] along the palm's
    axes."""
    sigma_untouched: ArrayLike = 3e-4
    """One standard deviation of each of those points along the normal [m], one for all or (m,)."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        if not isinstance(self.contacts, Contacts | None):
            raise InvalidInput(
                f"skin.contacts: expected Contacts or None, got {type(self.contacts).__name__}"
            )
        points = self.untouched_palm
        if checks.ndim(points) and not len(points):
            points = np.empty((0, 3))
        object.__setattr__(self, "untouched_palm", checks.position(points, "skin.untouched_palm", (None, 3)))
        object.__setattr__(self, "sigmas", checks.finite(self.sigmas, "skin.sigmas", (6,)))
        shape = (len(self.untouched_palm),) if checks.ndim(self.sigma_untouched) else ()
        sigma = checks.finite(self.sigma_untouched, "skin.sigma_untouched", shape)
        object.__setattr__(self, "sigma_untouched", np.maximum(sigma, checks.MIN_SIGMA))

    @classmethod
    def of(cls, touch: SkinTouch, T_palm_frame: ArrayLike, by_error: ArrayLike | None = None) -> SkinEvidence:
        """Returns the evidence of an array's taxels.

        `T_palm_frame` (4, 4): the pose of the array's link. `by_error` (6, j): the shift [m] and the turn [rad] of the
        link in the palm by one standard deviation of each of j joint errors; None: the link is fixed in the palm.
        """
        contacts = touch.contacts(T_palm_frame, by_error)
        untouched = touch.outside(T_palm_frame)
        return cls(contacts, untouched, touch.sigmas_common(by_error), touch.sigma_clearance)

    def joined(self, other: SkinEvidence) -> SkinEvidence:
        """Returns the taxels of both; the common error is the larger one of the two, axis by axis."""
        mine, theirs = self.contacts, other.contacts
        sigmas = [np.broadcast_to(e.sigma_untouched, len(e.untouched_palm)) for e in (self, other)]
        return SkinEvidence(
            mine.joined(theirs) if mine is not None and theirs is not None else mine or theirs,
            np.concatenate([self.untouched_palm, other.untouched_palm]),
            np.maximum(self.sigmas, other.sigmas),
            np.concatenate(sigmas),
        )
