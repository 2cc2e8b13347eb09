"""All that a tracker knows at one instant, as a value that later observations do not change."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from handsight._kernels.posterior import propagation
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior
from handsight.forces import WeightSensor
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.grasp import ContactMemory, GraspState
from handsight.tracking.hand_outside import LinkMargins
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import PoseBiasSmoother

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"
NO_CONTACTS, NO_MARGINS = FingertipContacts((), None, {}), LinkMargins()


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """A `Correction` is the answer of a correction, and what it was computed from."""

    estimate: PoseEstimate
    contacts: Contacts
    """Touched by `fingers` at `stamp` [s]."""
    by_error: Array | None
    """(n, 6, j) of the contacts, see `FingertipContacts`."""
    prior: PosePrior
    """The object's pose without touch."""
    fingers: tuple[str, ...]
    stamp: float
    variance: float
    """The largest of the position of the object's middle [m²]."""
    skin: SkinContacts = NOTHING


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackState:
    """A `TrackState` is what is known of one object in one hand after some observations, see `Follower.step`.

    It can be kept, copied and pickled. Undoing an observation is going on from the state before it.
    """

    start: PosePrior | None = None
    """Where the object is before the first grasp, given by the user, and again once no hand holds it; None: unknown."""
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
    """The last observation, its vision replaced by what its image says."""
    smoother: PoseBiasSmoother | None
    """The pose and vision's bias by vision alone; None before there was either."""
    correction: Correction | None = None
    """The last one since the object was grasped."""
    grasp: GraspState
    memory: ContactMemory
    vision: VisionUpdate
    images: ImageVision
    slip: SlipUpdate
    weight: WeightSensor
    """`images`, `slip` and `weight` change in place: a step updates copies of them."""
    offsets: JointOffsets
    """The joints' constant errors, by all grips before this one."""
    learnt_from: Correction | None = None
    """The last correction of the grips from which the offsets were learnt."""
    margins: LinkMargins = NO_MARGINS
    """By how much links are smaller than their shapes."""
    measured_at: float = -math.inf
    """When something was last touched or detected by vision [s]."""
    fits_at: float = -math.inf
    """When contacts last fitted the estimate; the first estimate counts as a fit [s]."""
    propagated_to: float = -math.inf
    """When the covariance was last inflated by process noise [s]."""
    recovered_at: float = -math.inf
    """When another pose was last searched for because contacts fitted none [s]."""
    links_checked_at: float = -math.inf
    """When links were last compared with the object [s]."""

    def __repr__(self) -> str:
        """Returns the stamp, the label and the reason."""
        trust = f"{self.label} {self.reason}".strip()
        return f"<TrackState at {self.stamp:.6g} s: {trust}, {self.corrections} corrections>"


def point_uncertainty(estimate: PoseEstimate, model: ObjectModel, point_object: Array) -> tuple[Array, float]:
    """Returns the covariance (3, 3) of a point (3,) of the object in the palm [m²], and its largest eigenvalue.

    A direction in which a declared symmetry leaves the information at zero is not uncertain.
    """
    covariance, arm = np.empty((3, 3)), estimate.T_palm_object[:3, :3] @ point_object
    return covariance, propagation.at_point(np.array(estimate.information), model.radius, arm, covariance)
