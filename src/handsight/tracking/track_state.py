"""All that a tracker knows at one instant, as a value: later observations do not change it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, PosePrior
from handsight.forces import WeightSensor
from handsight.observation import Observation
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.grasp import ContactMemory, GraspState
from handsight.tracking.images import ImageVision
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.misfit import NO_INNOVATIONS, Innovations
from handsight.tracking.skin import NOTHING, SkinContacts
from handsight.tracking.slip_update import SlipUpdate
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.table import TableEvidence

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """A correction that has started and not ended: it takes longer than one update may."""

    started: "TrackState"
    """The state after the observation by which it corrects."""
    steps: int = 0
    """How many of its steps were done."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Says why a correction has ended without an answer."""

    stamp: float
    """Of the observation by which it began [s]."""
    reason: str

    @classmethod
    def of(cls, started: "TrackState", error: Exception) -> "Failure":
        """Returns the failure of a correction that began at a state; its reason names the evidence."""
        evidence = [f"finger {name}" for name in started.fingertips.fingers]
        evidence += ["skin"] * started.skin.pressed + ["vision"] + ["the table"] * (started.table is not None)
        by = f"the correction by {', '.join(evidence)} at {started.stamp:.3f} s failed"
        return cls(started.stamp, f"{by}: {str(error) or type(error).__name__}")


NO_CONTACTS = FingertipContacts((), None, {})


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """The answer of a correction, with its inputs."""

    estimate: PoseEstimate
    contacts: Contacts
    """The n contacts of `fingers` at `stamp`, in the palm frame."""
    by_error: Array | None
    """(n, 6, j) the effect of the joints' errors on the contacts, see `FingertipContacts.by_error`."""
    records: NDArray[np.void] | None
    """See `FingertipContacts.records`."""
    prior: PosePrior
    """The object's pose without touch."""
    fingers: tuple[str, ...]
    """The fingers that touched the object."""
    stamp: float
    """[s]"""
    variance: float
    """Largest variance of the position of the object's middle [m²]."""
    T_world_palm: Array | None = None
    """(4, 4) the palm's pose; None where it was not known."""
    skin: SkinContacts = NOTHING
    """What the tactile arrays measured."""
    modes: Sequence[np.void] = ()
    """ANSWER of each mode of this prior, the estimate's own first, when other modes were last searched for."""
    searched_at: float = -math.inf
    """When that was [s]."""
    disputed_at: float | None = None
    """Since when corrections have contradicted the estimate, which is then an earlier one's [s]; None: they do not."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackState:
    """All that is known of one object in one hand after some observations, see `Follower.step`.

    It can be kept, copied and pickled. To undo an observation, continue from the state before it.
    """

    start: PosePrior | None = None
    """The object's pose in the palm at the start of the track, given by the user; None: unknown."""
    stamp: float = -math.inf
    """Stamp of the last observation [s]."""
    label: State = "lost"
    """How far the answer can be trusted."""
    reason: str = NO_POSE
    """Why it cannot be trusted further; empty while tracking."""
    estimate: PoseEstimate | None = None
    """The object's pose in the palm; None before there was one."""
    progress: Progress | None = None
    """The correction that goes on; None: none does."""
    corrections: int = 0
    """How often the pose was corrected."""
    failure: Failure | None = None
    """Why the last correction has no answer; None where it has one."""
    T_world_palm: Array | None = None
    """(4, 4) the last known pose of the palm; None before it was measured."""
    fingertips: FingertipContacts = NO_CONTACTS
    """What the fingertips measure."""
    skin: SkinContacts = NOTHING
    """What the tactile arrays measure."""
    processed: Observation | None = None
    """The last observation, its vision replaced by the pose from its image, if it had one."""
    smoother: PoseBiasSmoother | None
    """The pose and vision's bias, estimated from vision alone; None before there was a start or vision."""
    table: TableEvidence | None = None
    """What the table tells of the object since it was grasped on it; None where it was not."""
    correction: Correction | None = None
    """The last correction since the object was grasped; None before the first one."""
    grasp: GraspState
    memory: ContactMemory
    vision: VisionUpdate
    images: ImageVision
    slip: SlipUpdate
    weight: WeightSensor
    """`images`, `slip` and `weight` are objects that change in place: a step updates copies of them."""
    offsets: JointOffsets
    """The joints' constant errors, learnt from all grips before this one."""
    learnt_from: Correction | None = None
    """The last correction from which the offsets were learnt."""
    innovations: Innovations = NO_INNOVATIONS
    """How well evidence has fitted the model lately."""
    measured_at: float = -math.inf
    """When something was last touched or detected by vision [s]."""
    observed_at: float = -math.inf
    """When vision last measured the pose [s]."""
    fits_at: float = -math.inf
    """When contacts last fitted the estimate; the first estimate counts as a fit [s]."""
    propagated_to: float = -math.inf
    """The stamp up to which process noise has inflated the estimate's covariance [s]."""
    recovered_at: float = -math.inf
    """When another pose was last searched for because the contacts did not fit the estimate [s]."""
    links_checked_at: float = -math.inf
    """When links were last compared with the object [s]."""

    def __repr__(self) -> str:
        """Returns the stamp, the label and the reason."""
        trust = f"{self.label} {self.reason}".strip()
        return f"<TrackState at {self.stamp:.6g} s: {trust}, {self.corrections} corrections>"
