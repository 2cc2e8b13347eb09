"""All that a tracker knows at one instant, as a value: later observations do not change it."""

import math
from dataclasses import dataclass

from handsight.correction import PoseEstimate
from handsight.forces import WeightSensor
from handsight.observation import Observation
from handsight.tracking.answer import Correction
from handsight.tracking.belief import Belief
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.grasp import ContactMemory
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.monitor import NOTHING_YET, Monitor
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.tracking.slip_update import SlipUpdate

NO_CONTACTS = FingertipContacts((), None, {})


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """All that is touched at one instant, and what let go a moment ago."""

    memory: ContactMemory
    fingertips: FingertipContacts = NO_CONTACTS
    skin: SkinContacts = NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """A correction that goes on: it solves more problems than one update may."""

    started: "TrackState"
    """The state after the observation by which it corrects."""
    answers: tuple[PoseEstimate | None, ...] = ()
    """Those of the problems that were solved, in their order."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackState:
    """All that is known of one object in one hand after some observations, see `Follower.step`.

    It can be kept, copied and pickled. To undo an observation, continue from the state before it.
    """

    stamp: float = -math.inf
    """Stamp of the last observation [s]."""
    belief: Belief
    """The object's pose by all but touch."""
    images: ImageVision
    touch: Touch
    slip: SlipUpdate
    weight: WeightSensor
    """`images`, `slip` and `weight` are objects that change in place: a step updates copies of them."""
    offsets: JointOffsets
    """The joints' constant errors, learnt from all grips before this one."""
    learnt_from: Correction | None = None
    """The last correction from which the offsets were learnt."""
    search: Search | None = None
    """The correction that goes on; None: none does."""
    correction: Correction | None = None
    """The last correction since the object was grasped; None before the first one."""
    estimate: PoseEstimate | None = None
    """The object's pose in the palm; None before there was one."""
    monitor: Monitor = NOTHING_YET
    """How well evidence has fitted, and how far the estimate can be trusted."""
    processed: Observation | None = None
    """The last observation, its vision replaced by the pose from its image, if it had one."""

    def __repr__(self) -> str:
        """Returns the stamp, the label and the reason."""
        known = self.monitor
        trust = f"{known.label} {known.reason}".strip()
        return f"<TrackState at {self.stamp:.6g} s: {trust}, {known.corrections} corrections>"
