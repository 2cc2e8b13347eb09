"""Slips of the object in the hand, and their effect on the pose.

A slip makes the pose uncertain along its direction, and it is corrected at once. Where vision tells that a contact
moves over the object, friction is learnt from it, even if it slides straight.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.copies import shallow_copy
from handsight.forces import Slip, SlipDetector, slip_twist
from handsight.forces.object_motion import LENGTH
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.tracking.smoother import Motion, PoseBiasSmoother


class SlipUpdateOptions(NamedTuple):
    """`SlipUpdateOptions` say how uncertain a slip makes the pose."""

    sigma_speed: float = 0.05  # standard deviation of the speed of slips [m/s]
    max_travel: float = 0.03  # the farthest that an object slips without leaving the hand, one sigma [m]
    lateral_share: float = 0.3
    """Sigma of the motion lateral to the slip's direction, relative to that along it: loads give the direction to some
    15°."""
    onset_delay: float = 0.03  # how long before its detection a slip may have begun [s]
    period: float = 0.02  # time between corrections while the object slips [s]
    slide: float = 0.003
    """A contact slides if vision has it move over the object by this, more than it rolls [m]"""
    slide_sigmas: float = 4.0  # and by so many standard deviations of that motion
    slide_time: float = 1.0  # in this time at most [s]


SLIP_UPDATE = SlipUpdateOptions()

ISOTROPIC = np.diag(np.repeat([1.0, 1 / LENGTH**2], 3))
"""Covariance (6, 6) of a motion by one metre in an unknown direction."""


class SlipUpdate:
    """A `SlipUpdate` detects slips over time, and adds their possible motion to the pose's covariance."""

    def __init__(self, rig: Rig, model: ObjectModel | None = None) -> None:
        """Starts without any load, and with the friction that the rig's fingers and the model declare."""
        mu = None if model is None else model.friction
        self.detector = SlipDetector(rig, None if model is None or mu is None else (mu, model.sigma_friction))
        self._visible: tuple[GaussianPose, Array, Motion] | None = None
        """Vision's last pose that was compared."""
        self._anchors: Mapping[str, tuple[float, Array]] = {}
        """By finger, a stamp, and where its contact was on the object (3,) by vision then."""
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
        self,
        stamp: float,
        fingertips: FingertipContacts,
        smoother: PoseBiasSmoother,
        vision: VisionUpdate | None = None,
        skin: SkinContacts = NOTHING,
    ) -> PoseBiasSmoother:
        """Returns the smoother after an observation's loads; it is unchanged where the object does not slip.

        Loads are those on fingertips and on the taxels of other links, `skin`.
        A slip keeps its direction, so its sigma, not its variance, grows in proportion to time.
        """
        sliding = () if vision is None else self._sliding(stamp, fingertips, vision)
        names, contacts, loads = fingertips.fingers, fingertips.contacts, fingertips.loads
        if skin.bears:
            links, beside, more = skin.beside_tips()
            names, contacts = (*names, *links), beside if contacts is None else contacts.joined(beside)
            loads = more if loads is None else np.concatenate([loads, more])
        now = self.detector.update(stamp, names, loads, sliding, fingertips.by_taxels)
        if not now.slipping or contacts is None or loads is None:
            self._sigma = 0.0
            return smoother
        before, lasts = self._sigma, stamp - now.began + SLIP_UPDATE.onset_delay
        self._sigma = min(SLIP_UPDATE.sigma_speed * lasts, SLIP_UPDATE.max_travel)
        state = smoother.now
        twist = slip_twist(contacts, loads, state.T_palm_object[:3, 3])
        along = ISOTROPIC
        if twist is not None:
            along = np.outer(twist, twist) + SLIP_UPDATE.lateral_share**2 * ISOTROPIC
        return smoother.restarted(state.spread(max(self._sigma**2 - before**2, 0.0) * along))

    def _sliding(self, stamp: float, fingertips: FingertipContacts, vision: VisionUpdate) -> list[str]:
        """Returns the fingers that have slid over the object since their anchors, by vision's last pose if it is new.

        Vision's constant error moves a contact by as much at both ends, so only its noise and its drift count.
        """
        last, contacts = vision.last, fingertips.contacts
        if last is None or last is self._visible:
            return []
        self._visible = last
        if contacts is None or vision.rejected_in_a_row:
            self._anchors = {}
            return []
        pose, T_mount_palm, _ = last
        points = se3.apply(se3.inverse(pose.T_a_b) @ T_mount_palm, contacts.points_palm)
        variances, (*drift, lasts) = pose.covariance.diagonal(), vision.camera.drift.tolist()
        drifted = 1 - math.exp(-SLIP_UPDATE.slide_time / lasts)
        position = variances[:3].max() + drifted * drift[0]
        rotation = variances[3:].max() + drifted * drift[1]
        noise = 2 * (position + (points**2).sum(axis=1) * rotation)
        sliding, anchors = list[str](), dict[str, tuple[float, Array]]()
        for name, point, variance in zip(fingertips.fingers, points, noise, strict=True):
            then, anchor = self._anchors.get(name, (-math.inf, point))
            far = max(SLIP_UPDATE.slide, SLIP_UPDATE.slide_sigmas * math.sqrt(variance))
            slid = float(np.linalg.norm(point - anchor)) > far
            sliding += [name] if slid else []
            stays = not slid and stamp - then <= SLIP_UPDATE.slide_time
            anchors[name] = (then, anchor) if stays else (stamp, point)
        self._anchors = anchors
        return sliding

    def news(self, corrected: float) -> bool:
        """Returns whether a correction is due, `corrected` being the stamp of the last one [s].

        It is where a slip has begun or ended since then, and again and again while a slip lasts.
        """
        now = self.now
        if now.slipping and self.detector.stamp - corrected >= SLIP_UPDATE.period - 1e-9:
            return True
        return max(now.began, now.ended) > corrected
