"""What a tracker knows at one instant, as it is shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.contact import compensate
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.forces import Slip
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import FingertipContacts, State, Tracker
from handsight.tracking.replay import Step
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.viewer.picture import Picture

VISION_FOR = 1.0
"""How long what vision has measured is shown [s]."""


class Measured(NamedTuple):
    """A `Measured` is what vision said last."""

    stamp: float
    """When [s]."""
    T_palm_object: Array
    """(4, 4), its bias still in it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Moment:
    """A `Moment` is an answer with the observation it answers."""

    stamp: float
    """[s]"""
    state: State
    reason: str
    """Why the state is no better; empty while tracking."""
    estimate: PoseEstimate | None
    """None: nothing is known of the object yet."""
    sigma: float
    """Standard deviation of the position of the object's middle, its largest [m]; infinite before there is one."""
    fingertips: FingertipContacts
    T_world_palm: Array | None
    """(4, 4)."""
    joint_positions: Mapping[str, float] | None
    """By name [rad]."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By finger, as its sensor reads."""
    vision: Measured | None = None
    """The last that vision said; None where it has said nothing for a while."""
    picture: Picture | None = None
    """The last image; None where there was none."""
    slip: Slip = field(default_factory=Slip)
    """Whether the object slips, and how near to that it is."""
    skin: SkinContacts = NOTHING
    """What tactile arrays feel."""

    @classmethod
    def now(cls, tracker: Tracker) -> "Moment":
        """Returns the moment of a tracker, after the last observation that it has taken."""
        vision = tracker.vision.in_palm(tracker.processed, tracker.T_world_palm)
        return cls._from_tracker(tracker, tracker.processed, vision)

    @classmethod
    def of(cls, step: Step, observation: Observation) -> "Moment":
        """Returns the moment of a step of a replay, and the observation of that stamp."""
        return cls._from_tracker(step, observation, step.T_palm_object_vision)

    @classmethod
    def _from_tracker(
        cls, known: Tracker | Step, taken: Observation | None, T_palm_object_vision: Array | None
    ) -> "Moment":
        T_vision = T_palm_object_vision
        return cls(
            stamp=known.stamp,
            state=known.state,
            reason=known.reason,
            estimate=known.estimate,
            sigma=known.sigma,
            fingertips=known.fingertips,
            T_world_palm=known.T_world_palm,
            joint_positions=None if taken is None else taken.joint_positions,
            wrenches={} if taken is None else taken.wrenches,
            vision=None if T_vision is None else Measured(known.stamp, T_vision),
            slip=known.slip,
            skin=known.skin,
        )

    def after(self, last: "Moment | None", picture: Picture | None) -> "Moment":
        """Returns this moment with a picture, where there is a new one, and with what is still shown of the last
        moment."""
        if last is None:
            return replace(self, picture=picture)
        old = last.vision
        fresh = old is not None and 0 <= self.stamp - old.stamp < VISION_FOR
        return replace(
            self,
            vision=self.vision or (old if fresh else None),
            picture=last.picture if picture is None else picture,
        )

    @property
    def outliers(self) -> tuple[str, ...]:
        """Fingers whose contacts the answer rejects as wrong."""
        return () if self.estimate is None else self.fingertips.rejected_by(self.estimate)

    def links(self, rig: Rig) -> dict[str, Array]:
        """Returns T_palm_link (4, 4) of the links that are known of."""
        try:
            return rig.hand.link_poses(self.joint_positions or {})
        except InvalidInput:  # the tracker has refused it, and says so
            return {}

    def forces(self, rig: Rig) -> dict[str, Array]:
        """Returns (3,) what the object exerts on each finger that touches, in the palm [N]; fingers without a reading
        left out.

        Without the palm's pose in the world the tips' weight is still in it.
        """
        if self.joint_positions is None:
            return {}
        Ts = dict(zip(rig.hand.tips, rig.hand.Ts_palm_tip(self.joint_positions), strict=True))
        T_world_palm = np.eye(4) if self.T_world_palm is None else self.T_world_palm
        gravity = np.zeros(3) if self.T_world_palm is None else rig.gravity
        found = {}
        for name in self.fingertips.fingers:
            if name in self.wrenches:
                finger, reading = rig.fingers[name], np.asarray(self.wrenches[name])
                T_surface_sensor = finger.tip.T_surface_sensor
                T_palm_surface = Ts[name] @ finger.T_frame_surface
                R = (T_palm_surface if T_surface_sensor is None else T_palm_surface @ T_surface_sensor)[
                    :3, :3
                ]
                gravity_sensor = R.T @ T_world_palm[:3, :3].T @ gravity
                force, _ = compensate(reading[:3], reading[3:], gravity_sensor, finger.calibration)
                found[name] = R @ force
        return found
