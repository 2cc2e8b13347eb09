"""All that a tracker knows at one instant, as a value that later observations do not change."""

import math
from dataclasses import dataclass

from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.observation import Observation
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.grasp import ContactMemory, GraspState
from handsight.tracking.hand_outside import LinkMargins
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.propagation import Correction
from handsight.tracking.skin import NOTHING, SkinContacts, SkinSensors
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.status import State, TrackStatus
from handsight.tracking.weight_update import WeightUpdate

NO_POSE = "no pose yet: neither a start nor vision"
NO_CONTACTS, NO_MARGINS = FingertipContacts((), None, {}), LinkMargins()


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackState:
    """A `TrackState` is what is known of one object in one hand after some observations; see `Follower.step`, which
    makes the next one.

    It can be kept, copied and pickled. Undoing an observation is going on from the state before it.
    """

    start: PosePrior | None = None
    """Where the user has said that the object is at first, or goes back to when it is in no hand; None: unknown."""
    stamp: float = -math.inf
    """Of the last observation [s]."""
    label: State = "lost"
    """How far the answer is to be trusted."""
    reason: str = NO_POSE
    """Why no further; empty while tracking."""
    estimate: PoseEstimate | None = None
    """The object's pose in the palm; None before there was one."""
    corrections: int = 0
    """How often the pose was corrected."""
    T_world_palm: Array | None = None
    """(4, 4) where the palm was last."""
    fingertips: FingertipContacts = NO_CONTACTS
    """What the fingertips measure."""
    skin: SkinContacts = NOTHING
    """What the tactile arrays measure."""
    processed: Observation | None = None
    """The last observation, with what its image says as its vision."""
    smoother: PoseBiasSmoother | None
    """The pose and vision's bias by vision alone; None before there was either."""
    correction: Correction | None = None
    """The last one since the object was grasped."""
    status: TrackStatus
    """When something was last measured, and when contacts last fitted."""
    grasp: GraspState
    memory: ContactMemory
    vision: VisionUpdate
    images: ImageVision
    slip: SlipUpdate
    weight: WeightUpdate
    skin_sensors: SkinSensors
    offsets: JointOffsets
    """The joints' constant errors, by all grips before this one."""
    learnt_from: Correction | None = None
    """The last correction of the grips that the offsets are by."""
    margins: LinkMargins = NO_MARGINS
    """How much smaller links are than their shapes."""
    propagated_to: float = -math.inf
    """When the covariance was last inflated by process noise [s]."""
    recovered_at: float = -math.inf
    """When another pose was last searched for because contacts fitted none [s]."""
    links_checked_at: float = -math.inf
    """When links were last compared with the object [s]."""

    def __repr__(self) -> str:
        """Says when it is, the label and the reason."""
        trust = f"{self.label} {self.reason}".strip()
        return f"<TrackState at {self.stamp:.6g} s: {trust}, {self.corrections} corrections>"
