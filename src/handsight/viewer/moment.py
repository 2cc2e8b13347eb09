"""A tracker's estimate and evidence at one instant, as the viewer shows them, and a sentence that sums them up."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import InvalidInput
from handsight.forces import Slip
from handsight.rig import Rig
from handsight.tracking import FingertipContacts, State, Tracker
from handsight.tracking.judge import sigma
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.viewer.picture import Picture

VISION_FOR = 1.0  # how long the last measurement of vision is shown [s]
LIKELY = 0.02  # smallest probability of another mode that is shown
NEAR_SLIPPING = 0.8  # share of what friction holds from which the sentence says it


class Measured(NamedTuple):
    """The last pose that vision measured."""

    stamp: float  # [s]
    T_palm_object: Array  # (4, 4), vision's bias included


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Moment:
    """An estimate and the observation after which it was computed."""

    stamp: float  # [s]
    state: State
    reason: str  # why the state is no better; empty while tracking
    estimate: PoseEstimate | None  # none: nothing is known of the object yet
    sigma: float  # largest sigma of the position of the object's middle [m]; infinite without an estimate
    fingertips: FingertipContacts
    T_world_palm: Array | None  # (4, 4)
    joint_positions: Mapping[str, float] | None  # by name [rad]
    vision: Measured | None = None  # None where vision has measured nothing for `VISION_FOR`
    picture: Picture | None = None  # the last image; None before the first
    slip: Slip = field(default_factory=Slip)  # whether the object slips, and how near to slipping it is
    skin: SkinContacts = NOTHING  # contacts of tactile arrays

    @classmethod
    def now(cls, tracker: Tracker) -> "Moment":
        """Returns the moment of a tracker after the last observation that it has processed.

        It is of one state, which is a value: another thread may update the tracker meanwhile.
        """
        known = tracker.track_state
        observation = known.processed
        belief, touch = known.belief, known.touch
        T_vision = belief.vision.in_palm(observation, belief.T_world_palm)
        return cls(
            stamp=known.stamp,
            state=known.monitor.label,
            reason=known.monitor.reason,
            estimate=known.estimate,
            sigma=sigma(tracker.model, known),
            fingertips=touch.fingertips,
            T_world_palm=belief.T_world_palm,
            slip=known.slip.now,
            skin=touch.skin,
            joint_positions=None if observation is None else observation.joint_positions,
            vision=None if T_vision is None else Measured(known.stamp, T_vision),
        )

    def after(self, last: "Moment | None", picture: Picture | None) -> "Moment":
        """Returns this moment with a new picture, else the last one's, and vision's last pose while it is fresh."""
        if last is None:
            return replace(self, picture=picture)
        old = last.vision
        fresh = old is not None and 0 <= self.stamp - old.stamp < VISION_FOR
        vision = self.vision or (old if fresh else None)
        return replace(self, vision=vision, picture=last.picture if picture is None else picture)

    @property
    def outliers(self) -> tuple[str, ...]:
        """Fingers whose contacts the estimate rejects."""
        return () if self.estimate is None else self.fingertips.rejected_by(self.estimate)

    def links(self, rig: Rig) -> dict[str, Array]:
        """Returns T_palm_link (4, 4) of the links whose pose is known, by name."""
        try:
            return rig.hand.link_poses(self.joint_positions or {})
        except InvalidInput:  # the tracker rejects these joints too, and its reason says why
            return {}

    def forces(self) -> dict[str, Array]:
        """Returns the force (3,) of the object on each finger that touches and measures it, in the palm [N]. Without
        the palm's pose in the world the weight of the tips is included."""
        touch = self.fingertips
        if touch.contacts is None or touch.loads is None:
            return {}
        forces = touch.loads[:, :3] + touch.loads[:, 3:4] * touch.contacts.normals_palm
        named = zip(touch.fingers, forces, strict=True)
        return {name: force for name, force in named if np.isfinite(force).all()}

    @property
    def sentence(self) -> str:
        """A sentence with the state, why it is no better, and the evidence for the estimate."""
        estimate = self.estimate
        fingers = self.fingertips.fingers
        parts = [self.reason] if self.reason else []
        if fingers:
            fit = " and fit the object" if estimate is not None and estimate.consistent else ""
            parts.append(f"{', '.join(fingers)} touch{fit}")
        elif "touched" not in self.reason:
            parts.append("no finger touches")
        if estimate is not None:
            least = self.slip.least or 0.0
            if least >= NEAR_SLIPPING and not self.slip.slipping:
                parts.append(f"the grip uses {least:.0%} of what friction holds")
            if self.outliers:
                parts.append(f"{', '.join(self.outliers)} left out as wrong")
            if math.isfinite(self.sigma) and "known to" not in self.reason:
                parts.append(f"the position is known to {1000 * self.sigma:.1f} mm")
            if fingers and len(estimate.unobservable):
                parts.append(f"touch leaves {len(estimate.unobservable)} of 6 directions open")
            if others := [mode.weight for mode in estimate.hypotheses[1:] if mode.weight >= LIKELY]:
                parts.append(f"another pose is likely by {others[0]:.0%}")
        return f"{self.state.capitalize()}: {'; '.join(parts)}."
