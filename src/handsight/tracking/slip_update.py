"""The effect of a slip on the pose: it is more uncertain along the slip, and has to be corrected at once."""

from typing import NamedTuple

import numpy as np

from handsight.copies import shallow_copy
from handsight.forces import Slip, SlipDetector, slip_twist
from handsight.forces.object_motion import LENGTH
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.smoother import PoseBiasSmoother


class SlipUpdateOptions(NamedTuple):
    """`SlipUpdateOptions` say how a slip moves the estimate."""

    sigma_speed: float = 0.05  # of slips [m/s]
    max_travel: float = 0.03  # how far one takes an object that is still in the hand [m]
    lateral_share: float = 0.3
    """Sigma of the motion across the direction that loads say, in parts of that along it: they are off by some 15°."""
    onset_delay: float = 0.03  # how long before it is noticed a slip may have begun [s]
    period: float = 0.02  # of corrections while it slips [s]


SLIP_UPDATE = SlipUpdateOptions()

ISOTROPIC = np.diag(np.repeat([1.0, 1 / LENGTH**2], 3))
"""Covariance (6, 6) of a motion by one metre in an unknown direction."""


class SlipUpdate:
    """A `SlipUpdate` detects slips over time, and adds what they may have moved to the pose's covariance."""

    def __init__(self, rig: Rig) -> None:
        """Starts without any load."""
        self.detector = SlipDetector(rig)
        self._sigma = 0.0
        """Of how far this slip has taken the object, as far as the smoother has it [m]."""

    def copied(self) -> "SlipUpdate":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.detector = shallow_copy(self.detector)
        copy.detector.friction = shallow_copy(self.detector.friction)
        return copy

    @property
    def now(self) -> Slip:
        """After the last observation."""
        return self.detector.now

    def update(
        self, stamp: float, fingertips: FingertipContacts, smoother: PoseBiasSmoother
    ) -> PoseBiasSmoother:
        """Returns the smoother after an observation's loads, the same one where the object does not slip.

        A slip goes on in one direction, so its sigma, not its variance, grows with time.
        """
        now = self.detector.update(stamp, fingertips.fingers, fingertips.loads)
        if not now.slipping or fingertips.contacts is None or fingertips.loads is None:
            self._sigma = 0.0
            return smoother
        before, lasts = self._sigma, stamp - now.began + SLIP_UPDATE.onset_delay
        self._sigma = min(SLIP_UPDATE.sigma_speed * lasts, SLIP_UPDATE.max_travel)
        state = smoother.now
        twist = slip_twist(fingertips.contacts, fingertips.loads, state.T_palm_object[:3, 3])
        along = ISOTROPIC
        if twist is not None:
            along = np.outer(twist, twist) + SLIP_UPDATE.lateral_share**2 * ISOTROPIC
        return smoother.restarted(state.spread(max(self._sigma**2 - before**2, 0.0) * along))

    def news(self, corrected: float) -> bool:
        """Returns whether a slip has begun or ended since a correction of that stamp [s], or goes on."""
        now = self.now
        if now.slipping and self.detector.stamp - corrected >= SLIP_UPDATE.period - 1e-9:
            return True
        return max(now.began, now.ended) > corrected
