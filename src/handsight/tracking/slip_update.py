"""Slips of the object in the hand, and their effect on the pose.

A slip makes the pose uncertain along its direction, and it is corrected at once.
"""

from copy import copy

import numpy as np

from handsight.checks import Array
from handsight.forces import Slip, SlipDetector, slip_twist
from handsight.forces.object_motion import LENGTH
from handsight.objects import ObjectModel
from handsight.observation import seconds
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts

SIGMA_SPEED = 0.05  # standard deviation of the speed of slips [m/s]
MAX_TRAVEL = 0.03  # the farthest that an object slips without leaving the hand, one sigma [m]
LATERAL_SHARE = 0.3
"""Sigma of the motion lateral to the slip's direction, relative to that along it: loads give the direction to some
15°."""
ONSET_DELAY = 0.03  # how long before its detection a slip may have begun [s]
SLIP_PERIOD = 0.02  # time between corrections while the object slips [s]


EYE = np.eye(3)
ISOTROPIC = np.diag(np.repeat([1.0, 1 / LENGTH**2], 3))
"""Covariance (6, 6) of a motion by one metre in an unknown direction."""


class SlipUpdate:
    """Detects slips over time, and adds their possible motion to the pose's covariance."""

    def __init__(self, rig: Rig, model: ObjectModel | None = None) -> None:
        """Starts without any load, and with the friction that the rig's fingers and the model declare."""
        mu = None if model is None else model.friction
        self.detector = SlipDetector(rig, None if model is None or mu is None else (mu, model.sigma_friction))
        self._sigma = 0.0
        """Standard deviation of this slip's motion that the smoother includes already [m]."""

    def copied(self) -> "SlipUpdate":
        """Returns a copy that evolves apart from this one."""
        other = copy(self)
        other.detector = copy(self.detector)
        other.detector.friction = copy(self.detector.friction)
        return other

    @property
    def now(self) -> Slip:
        """Whether the object slips, after the last observation."""
        return self.detector.now

    def update(
        self,
        stamp: float,
        fingertips: FingertipContacts,
        T_palm_object: Array,
        T_world_palm: Array | None = None,
    ) -> Array | None:
        """Returns the covariance (6, 6) of the motion that an observation's loads add to an object at T_palm_object
        (4, 4) [m², rad²]; None where it does not slip.

        Without T_world_palm (4, 4), a load that a turn of the palm turns seems to have turned by itself. A slip keeps
        its direction, so its sigma, not its variance, grows in proportion to time.
        """
        contacts, loads = fingertips.contacts, fingertips.loads
        R_world_palm = EYE if T_world_palm is None else T_world_palm[:3, :3]
        now = self.detector.update(stamp, fingertips.fingers, loads, fingertips.by_taxels, R_world_palm)
        if not now.slipping or contacts is None or loads is None:
            self._sigma = 0.0
            return None
        before = self._sigma
        lasts = seconds(stamp, now.began) + ONSET_DELAY
        self._sigma = min(SIGMA_SPEED * lasts, MAX_TRAVEL)
        twist = slip_twist(contacts, loads, T_palm_object[:3, 3])
        along = ISOTROPIC
        if twist is not None:
            along = np.outer(twist, twist) + LATERAL_SHARE**2 * ISOTROPIC
        return np.asarray(max(self._sigma**2 - before**2, 0.0) * along)

    def news(self, corrected: float) -> bool:
        """Returns whether a correction is due, `corrected` being the stamp of the last one [s].

        It is where a slip has begun or ended since then, and again and again while a slip lasts.
        """
        now = self.now
        if now.slipping and seconds(self.detector.stamp, corrected) >= SLIP_PERIOD:
            return True
        return max(now.began, now.ended) > corrected
