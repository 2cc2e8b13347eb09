"""Several fingertips with a wrench each, sensed in one call: what a hand does at every instant."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from handsight.checks import Array
from handsight.contact.contact import REASON_NAMES, ReasonName
from handsight.contact.fingertip import Fingertip


@dataclass(frozen=True, slots=True, eq=False)
class Sensed:
    """What n tips feel; rows of tips that feel no contact hold nothing."""

    reasons: tuple[Literal["contact"] | ReasonName, ...]
    """(n,) `contact`, or why there is none; `invalid` for a wrench that is not finite."""
    points: Array
    """(n, 3) in each tip's frame [m]."""
    normals: Array
    """(n, 3) unit, outward from the object, in each tip's frame."""
    covariances: Array
    """(n, 6, 6) of point and normal."""


class Several:
    """Fingertips, laid out to be sensed together; each answers as by `contact_from_wrench`."""

    def __init__(self, fingertips: Sequence[Fingertip], sigmas: Array) -> None:
        """`sigmas` (n, 6): one standard deviation per axis of each one's force [N] and torque [N m]."""
        self._tips = np.array([tip._numbers for tip in fingertips])
        self._sigmas = np.ascontiguousarray(sigmas, dtype=np.float64)

    def sense(self, loads: Array) -> Sensed:
        """What the wrenches (n, 6), forces [N] and torques [N m] of the object on each tip, say of contacts."""
        from handsight._kernels import sensing  # numba takes half a second

        n = len(self._tips)
        reasons, vectors, covariances = np.empty(n, dtype=np.int8), np.empty((n, 3, 3)), np.empty((n, 6, 6))
        sensing.sense_each(loads, self._tips, self._sigmas, reasons, vectors, covariances)
        names = tuple(REASON_NAMES[reason] for reason in reasons.tolist())
        return Sensed(names, vectors[:, 0], vectors[:, 1], covariances)
