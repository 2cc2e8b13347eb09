"""What a slip does to what is known of the pose: more uncertain along the slip, and a reason to correct at once."""

from typing import NamedTuple

import numpy as np

from handsight.copies import shallow_copy
from handsight.forces import Slip, SlipDetector, slip_twist
from handsight.forces.slip_motion import LENGTH
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

EVERY_WAY = np.diag(np.repeat([1.0, 1 / LENGTH**2], 3))
"""Covariance (6, 6) of a motion of a metre whichever way."""


class SlipUpdate:
    """A `SlipUpdate` says whether the object slips, over time, and what that does; what changes is bound anew."""

    def __init__(self, rig: Rig) -> None:
        """Nothing is felt yet."""
        self.detector = SlipDetector(rig)
        self._spread = 0.0

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
        """Returns the smoother after loads were felt, the same one where the object holds.

        A slip goes on in one direction, so its sigma, not its variance, grows with time.
        """
        now = self.detector.update(stamp, fingertips.fingers, fingertips.loads)
        if not now.slipping or fingertips.contacts is None or fingertips.loads is None:
            self._spread = 0.0
            return smoother
        before, self._spread = (
            self._spread,
            min(
                SLIP_UPDATE.sigma_speed * (stamp - now.began + SLIP_UPDATE.onset_delay),
                SLIP_UPDATE.max_travel,
            ),
        )
        more = max(self._spread**2 - before**2, 0.0)
        state = smoother.now
        twist = slip_twist(fingertips.contacts, fingertips.loads, state.T_palm_object[:3, 3])
        along = (
            EVERY_WAY if twist is None else np.outer(twist, twist) + SLIP_UPDATE.lateral_share**2 * EVERY_WAY
        )
        return smoother.restarted(state.spread(more * along))

    def asks(self, corrected: float) -> bool:
        """Returns whether a correction of that stamp [s] is no longer good: a slip has begun or ended since, or goes
        on."""
        now = self.now
        if now.slipping and self.detector.stamp - corrected >= SLIP_UPDATE.period - 1e-9:
            return True
        return max(now.began, now.ended) > corrected
