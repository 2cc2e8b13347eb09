"""The door of tracking: observations are checked, their clock is watched, and the state of the track is kept."""

from __future__ import annotations

import math
from dataclasses import replace

from handsight import checks
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.errors import InvalidInput
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.observation import Observation, check_observation
from handsight.rig import Rig
from handsight.tracking.clock import MAX_JUMP, TrackClock
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.follower import Follower
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinContacts
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.status import State
from handsight.tracking.track_state import TrackState
from handsight.tracking.warm import warm_tracker
from handsight.tracking.weight_update import ObjectWeight

__all__ = ["State", "Tracker", "TrackerSettings"]

MAX_LEFT_OUT = 100
"""So many observations in a row, late or wrong, may be left out before the object counts as lost."""


class Tracker:
    """A `Tracker` is one object in one hand. Give it every observation; it answers with the pose at each.

    The object is fixed in the palm between corrections (the paper's assumption), its uncertainty growing; while it is
    not grasped, it is fixed in the world. It is corrected when a finger touches or lets go, when a contact has moved,
    when the object slips, when vision arrives, or at a set rate.

    Stamps are to go on; what is older than the last one is late, and left out. Clocks jump all the same, and how that
    is told from a pause says `handsight.tracking.clock`: a jump ahead is taken back if the next stamp contradicts it,
    and where the clock was set back a new track starts, from `start` or from vision, as `reason` says for a second.

    All that it knows of the object is one value, `track_state`, which `Follower.step` takes from one observation to the
    next. A tracker can be copied and pickled, and goes on from any such value by `resume`.
    """

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        start: PosePrior | None = None,
        settings: TrackerSettings | None = None,
        joint_offsets: JointOffsets | None = None,
    ) -> None:
        """`start`: where the object is in the palm at first, if the user knows; else vision's first pose starts.

        `joint_offsets`: those of a tracker that followed another object in this hand before, else as the rig says.
        """
        if not isinstance(rig, Rig) or not isinstance(model, ObjectModel):
            came = f"{type(rig).__name__} and {type(model).__name__}"
            raise InvalidInput(f"tracker: expected a Rig and an ObjectModel, got {came}")
        for name, given, kind in (
            ("start", start, PosePrior),
            ("settings", settings, TrackerSettings),
            ("joint_offsets", joint_offsets, JointOffsets),
        ):
            if not isinstance(given, kind | None):
                expected = f"expected a {kind.__name__} or None"
                raise InvalidInput(f"{name}: {expected}, got {type(given).__name__}")
        offsets = joint_offsets or JointOffsets.of(rig)
        if offsets.joints != rig.hand.moving:
            came = checks.brief(", ".join(offsets.joints))
            raise InvalidInput(f"joint_offsets: expected those of this hand's joints, got those of {came}")
        warm_tracker()
        self.follower = Follower(rig, model, settings or TrackerSettings())
        """What takes one state to the next."""
        self.track_state = self.follower.initial(start, offsets)
        """All that is known of the object: a value."""
        self._clock = TrackClock()
        self.late = self.undone = self.refused = 0
        """How many observations were left out: late ones, those taken back when the next told that their stamps were
        wrong, and those that were wrong in themselves."""
        self.state: State = "lost"
        """How far to trust the answer."""
        self.reason = self.track_state.reason
        """Why no further; empty while tracking."""
        self._left_out_in_a_row = 0

    def __repr__(self) -> str:
        """Says which object is tracked, and how well."""
        trust = f"{self.state} {self.reason}".strip()
        return f"<Tracker of {self.model.name}: {trust}, {self.corrections} corrections>"

    def update(self, observation: Observation) -> PoseEstimate | None:
        """Returns the pose in the palm now; None as long as there has been neither a start nor a pose from vision.

        `state` and `reason` say how far to trust it; lost it is, too, once `MAX_LEFT_OUT` observations in a row, or
        all of `lost_after`, were left out. An observation older than the last one is counted in `late` and changes
        nothing else; of jumps of the clock see the class. Raises InvalidInput for what is wrong with the observation
        itself, which is counted in `refused` and changes nothing else.
        """
        before = self.track_state, self._clock, self.late, self.undone, self.state, self.reason
        try:
            clean = check_observation(observation)
            if not self._is_next(clean.stamp):
                self.late += 1
                self._leave_out(clean.stamp, "older than the last one")
                return self.estimate
            self.track_state, estimate = self.follower.step(self.track_state, clean)
        except BaseException as error:
            self.track_state, self._clock, self.late, self.undone, self.state, self.reason = before
            if isinstance(error, Exception):
                self.refused += 1
                self._leave_out(getattr(observation, "stamp", None), str(error))
            raise
        self._left_out_in_a_row = 0
        self.state, self.reason = self.track_state.label, self.track_state.reason
        if self._clock.message and (estimate is None or clean.stamp - self._clock.restarted_at <= MAX_JUMP):
            self.state = "lost" if self.state == "lost" else "uncertain"
            self.reason = "; ".join(filter(None, (self._clock.message, self.reason)))
        return estimate

    def resume(self, track_state: TrackState) -> None:
        """Goes on from a state, of this tracker or of another one with the same rig, object and settings."""
        if not isinstance(track_state, TrackState):
            raise InvalidInput(f"track_state: expected a TrackState, got {type(track_state).__name__}")
        self.track_state, self._clock, self._left_out_in_a_row = track_state, TrackClock(), 0
        self.state, self.reason = track_state.label, track_state.reason

    def vision_bias(self) -> tuple[Array, Array] | None:
        """Returns vision's constant bias (6,) and its covariance (6, 6), by vision and contacts together.

        See `PoseAndBias.vision_bias`. None before there were both.
        """
        known = self.track_state
        if known.smoother is None or known.correction is None or known.vision.mount is None:
            return None
        estimate = known.correction.estimate
        state = known.smoother.now.given_pose(estimate.T_palm_object, estimate.information)
        return state.vision_bias, state.covariance[6:, 6:]

    @property
    def rig(self) -> Rig:
        """The robot."""
        return self.follower.rig

    @property
    def model(self) -> ObjectModel:
        """The object."""
        return self.follower.model

    @property
    def settings(self) -> TrackerSettings:
        """When it corrects, and what it expects."""
        return self.follower.settings

    @property
    def stamp(self) -> float:
        """Of the last observation [s]."""
        return self.track_state.stamp

    @property
    def estimate(self) -> PoseEstimate | None:
        """The object's pose in the palm; None before there was one."""
        return self.track_state.estimate

    @property
    def corrections(self) -> int:
        """How often the pose was corrected."""
        return self.track_state.corrections

    @property
    def T_world_palm(self) -> Array | None:
        """(4, 4) where the palm was last."""
        return self.track_state.T_world_palm

    @property
    def fingertips(self) -> FingertipContacts:
        """What the fingertips measure."""
        return self.track_state.fingertips

    @property
    def skin(self) -> SkinContacts:
        """What the tactile arrays measure."""
        return self.track_state.skin

    @property
    def processed(self) -> Observation | None:
        """The last observation, with what its image says as its vision."""
        return self.track_state.processed

    @property
    def vision(self) -> VisionUpdate:
        """What has become of vision's measurements."""
        return self.track_state.vision

    @property
    def smoother(self) -> PoseBiasSmoother | None:
        """The pose and vision's bias by vision alone; None before there was either."""
        return self.track_state.smoother

    @property
    def joint_offsets(self) -> JointOffsets:
        """The joints' constant errors, by all grips so far: for the tracker of the next object in this hand."""
        return self.follower.joint_offsets(self.track_state)

    @property
    def sigma(self) -> float:
        """Standard deviation of the position of the object's middle, its largest [m]; infinite before there is one."""
        return self.follower.sigma(self.track_state)

    @property
    def slip(self) -> Slip:
        """Whether the object slips, and how near to that each finger is."""
        return self.track_state.slip.now

    @property
    def weight(self) -> ObjectWeight | None:
        """What the object weighs, and where its centre of mass is; None where it was not weighed since the grasp."""
        return self.track_state.weight.of(self.estimate)

    @property
    def unweighed(self) -> str:
        """Why the object is not weighed now, or what it weighs not believed; empty where it is."""
        return self.track_state.weight.weigher.reason

    @property
    def images(self) -> dict[str, int]:
        """What has become of depth images: how many were `looked_at`, and so on; empty where there were none."""
        return self.track_state.images.counts

    @property
    def links(self) -> tuple[str, ...]:
        """Links of the hand whose shapes keep the object out."""
        return self.follower.hand.links

    @property
    def link_margins(self) -> dict[str, float]:
        """By link that would be inside the object though contacts fit: how much smaller it is than its shape [m]."""
        return self.track_state.margins.known

    @property
    def unconfirmed(self) -> int:
        """How many of the last observations were jumps ahead that the next may yet take back."""
        return len(self._clock.unconfirmed)

    def _is_next(self, stamp: float) -> bool:
        """Returns whether an observation of that stamp goes on from the last one, wherever the clock has jumped."""
        last = self.track_state
        self._clock, known, undone = self._clock.at(stamp, last)
        if undone:
            self.undone, self._left_out_in_a_row = self.undone + undone, 0
        if known is None:  # what was learnt of the robot outlives the track
            known = replace(
                self.follower.initial(last.start, last.offsets),
                corrections=last.corrections,
                learnt_from=last.learnt_from,
                margins=last.margins,
            )
        if known is not last:
            self.track_state, self.state, self.reason = known, known.label, known.reason
        return stamp >= known.stamp

    def _leave_out(self, stamp: object, reason: str) -> None:
        """Takes note of an observation that was left out."""
        self._left_out_in_a_row += 1
        age = stamp - self.stamp if type(stamp) is float and self.stamp > -math.inf else 0.0
        if self._left_out_in_a_row >= MAX_LEFT_OUT or age > self.settings.lost_after:
            self.state = "lost"
            self.reason = f"left out {self._left_out_in_a_row} observations in a row, the last: {reason}"
