"""The effect of a slip on the pose: it becomes uncertain along the slip, and is corrected at once."""

from typing import NamedTuple

import numpy as np

from handsight.copies import shallow_copy
from handsight.forces import Slip, SlipDetector, slip_twist
from handsight.forces.object_motion import LENGTH
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.smoother import PoseBiasSmoother


class SlipUpdateOptions(NamedTuple):
    """`SlipUpdateOptions` say how uncertain a slip makes the pose."""

    sigma_speed: float = 0.05  # standard deviation of the speed of slips [m/s]
    max_travel: float = 0.03  # the farthest that an object slips without leaving the hand, one sigma [m]
    lateral_share: float = 0.3
    """Sigma of the motion lateral to the slip's direction, relative to that along it: loads give the direction to some
    15°."""
    onset_delay: float = 0.03  # how long before its detection a slip may have begun [s]
    period: float = 0.02  # time between corrections while the object slips [s]


SLIP_UPDATE = SlipUpdateOptions()

ISOTROPIC = np.diag(np.repeat([1.0, 1 / LENGTH**2], 3))
"""Covariance (6, 6) of a motion by one metre in an unknown direction."""


class SlipUpdate:
    """A `SlipUpdate` detects slips over time, and adds their possible motion to the pose's covariance."""

    def __init__(self, rig: Rig) -> None:
        """Starts without any load."""
        self.detector = SlipDetector(rig)
        self._sigma = 0.0
        """Standard deviation of this slip's motion that the smoother includes already [m]."""

    def copied(self) -> "SlipUpdate":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.detector = shallow_copy(self.detector)
        copy.detector.friction = shallow_copy(self.detector.friction)
        return copy

    @property
    def now(self) -> Slip:
        """Whether the object slips, after the last observation."""
        return self.detector.now

    def update(
        self, stamp: float, fingertips: FingertipContacts, smoother: PoseBiasSmoother
    ) -> PoseBiasSmoother:
        """Returns the smoother after an observation's loads; it is unchanged where the object does not slip.

        A slip keeps its direction, so its sigma, not its variance, grows in proportion to time.
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
        """Returns whether a correction is due, `corrected` being the stamp of the last one [s].

        It is where a slip has begun or ended since then, and again and again while a slip lasts.
        """
        now = self.now
        if now.slipping and self.detector.stamp - corrected >= SLIP_UPDATE.period - 1e-9:
            return True
        return max(now.began, now.ended) > corrected
