"""A tracker: observations are checked and put in order, and the state of the track is kept."""

from __future__ import annotations

import math
from dataclasses import replace

from handsight import checks
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.errors import InvalidInput
from handsight.forces import ObjectWeight, Slip
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
from handsight.tracking.track_state import State, TrackState
from handsight.tracking.warm import warm_tracker

__all__ = ["State", "Tracker", "TrackerSettings"]

MAX_LEFT_OUT = 100
"""The object is lost once so many observations in a row were late or wrong."""


class Tracker:
    """A `Tracker` follows one object in one hand: it is given every observation, and answers with the object's pose.

    Between corrections the object is fixed in the palm (the paper's assumption) with growing uncertainty; while it is
    not grasped, it is fixed in the world. It is corrected when a finger touches or lets go, when a contact has moved,
    when the object slips, when vision arrives, or at a set rate.

    Stamps must increase; an observation older than the last one is late, and left out. `handsight.tracking.clock` says
    how a clock that jumps differs from a pause: a jump ahead is undone if the next stamp contradicts it, and where the
    clock was set back a new track starts, from `start` or from vision, which `reason` says for a second.

    All that it knows of the object is one value, `track_state`, which `Follower.step` takes from one observation to the
    next. A tracker can be copied and pickled, and `resume` lets it go on from any such value.
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
        """`start`: where the object is in the palm at first; None: the first pose from vision is the start.

        `joint_offsets`: those of a tracker that followed another object in this hand; None: as the rig says.
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
        self.rig, self.model, self.settings = rig, model, settings or TrackerSettings()
        self.follower = Follower(rig, model, self.settings)
        """Takes one state to the next."""
        self.track_state = self.follower.initial(start, offsets)
        """All that is known of the object, as a value."""
        self._clock = TrackClock()
        self.late = self.undone = self.refused = 0
        """How many observations were left out: late ones, those undone because the next one showed that their stamps
        were wrong, and those that were wrong in themselves."""
        self.state: State = "lost"
        """How far to trust the answer."""
        self.reason = self.track_state.reason
        """Why no further; empty while tracking."""
        self._left_out_in_a_row = 0

    def __repr__(self) -> str:
        """Returns which object is tracked, and how well."""
        trust = f"{self.state} ({self.reason})" if self.reason else self.state
        return f"<Tracker of {self.model.name}: {trust}, {self.corrections} corrections>"

    def update(self, observation: Observation) -> PoseEstimate | None:
        """Returns the pose in the palm now; None before there was a start or a pose from vision.

        `state` and `reason` say how far to trust it. The object is also lost once `MAX_LEFT_OUT` observations in a
        row, or all of `lost_after`, were left out. An observation older than the last one is counted in `late` and
        changes nothing else; the class says what a jump of the clock does. Raises InvalidInput for an observation that
        is wrong in itself, which is counted in `refused` and changes nothing else.
        """
        last = self.track_state
        try:
            clean = check_observation(observation)
            clock, known, undone = self._clock.at(clean.stamp, last)
            if known is None:  # a new track, for which what was learnt of the robot is kept
                known = replace(
                    self.follower.initial(last.start, last.offsets),
                    corrections=last.corrections,
                    learnt_from=last.learnt_from,
                    margins=last.margins,
                )
            late = clean.stamp < known.stamp
            state, estimate = (known, known.estimate) if late else self.follower.step(known, clean)
        except Exception as error:
            self.refused += 1
            self._leave_out(getattr(observation, "stamp", None), str(error))
            raise
        self._clock, self.track_state = clock, state
        if undone:
            self.undone, self._left_out_in_a_row = self.undone + undone, 0
        if state is not last:
            self.state, self.reason = state.label, state.reason
        if late:
            self.late += 1
            self._leave_out(clean.stamp, "older than the last one")
            return estimate
        self._left_out_in_a_row = 0
        if clock.message and (estimate is None or clean.stamp - clock.restarted_at <= MAX_JUMP):
            self.state = "lost" if self.state == "lost" else "uncertain"
            self.reason = "; ".join(filter(None, (clock.message, self.reason)))
        return estimate

    def resume(self, track_state: TrackState) -> None:
        """Goes on from a state of this tracker, or of another one with the same rig, object and settings."""
        if not isinstance(track_state, TrackState):
            raise InvalidInput(f"track_state: expected a TrackState, got {type(track_state).__name__}")
        self.track_state, self._clock, self._left_out_in_a_row = track_state, TrackClock(), 0
        self.state, self.reason = track_state.label, track_state.reason

    def vision_bias(self) -> tuple[Array, Array] | None:
        """Returns vision's constant bias (6,), as `PoseAndBias.vision_bias` has it, and its covariance (6, 6).

        It is by vision and contacts together; None before there were both.
        """
        known = self.track_state
        if known.smoother is None or known.correction is None or known.vision.mount is None:
            return None
        estimate = known.correction.estimate
        state = known.smoother.now.given_pose(estimate.T_palm_object, estimate.information)
        return state.vision_bias, state.covariance[6:, 6:]

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
        """The last observation, its vision replaced by what its image says."""
        return self.track_state.processed

    @property
    def vision(self) -> VisionUpdate:
        """Takes vision's measurements, and counts those that it rejects."""
        return self.track_state.vision

    @property
    def smoother(self) -> PoseBiasSmoother | None:
        """The pose and vision's bias by vision alone; None before there was either."""
        return self.track_state.smoother

    @property
    def joint_offsets(self) -> JointOffsets:
        """The joints' constant errors by all grips so far, for the tracker of the next object in this hand."""
        return self.follower.joint_offsets(self.track_state)

    @property
    def sigma(self) -> float:
        """The largest standard deviation of the position of the object's middle [m]; infinite without a pose."""
        return self.follower.sigma(self.track_state)

    @property
    def slip(self) -> Slip:
        """Whether the object slips, and how near each finger is to slipping."""
        return self.track_state.slip.now

    @property
    def weight(self) -> ObjectWeight | None:
        """The object's weight and centre of mass; None where it was not weighed since the grasp."""
        return self.track_state.weight.of(self.estimate)

    @property
    def unweighed(self) -> str:
        """Why the object is not weighed now, or why its weight is not believed; empty where it is."""
        return self.track_state.weight.weigher.reason

    @property
    def images(self) -> dict[str, int]:
        """How many depth images were `looked_at`, in how many the object was seen, ...; empty without images."""
        return self.track_state.images.counts

    @property
    def links(self) -> tuple[str, ...]:
        """Links of the hand whose shapes the object cannot be inside."""
        return self.follower.hand.links

    @property
    def link_margins(self) -> dict[str, float]:
        """By link that would be inside an object that contacts fit: how much smaller it is than its shape [m]."""
        return self.track_state.margins.known

    @property
    def unconfirmed(self) -> int:
        """How many of the last observations were jumps ahead that the next one may still undo."""
        return len(self._clock.unconfirmed)

    def _leave_out(self, stamp: object, reason: str) -> None:
        """Counts an observation that was left out; the object is lost after too many."""
        self._left_out_in_a_row += 1
        age = stamp - self.stamp if type(stamp) is float and self.stamp > -math.inf else 0.0
        if self._left_out_in_a_row >= MAX_LEFT_OUT or age > self.settings.lost_after:
            self.state = "lost"
            self.reason = f"left out {self._left_out_in_a_row} observations in a row, the last: {reason}"
