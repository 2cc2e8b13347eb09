"""A tracker: it checks observations, handles jumps of the clock, and keeps the state of the track."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.errors import InvalidInput
from handsight.forces import ObjectWeight, Slip
from handsight.objects import ObjectModel
from handsight.observation import MAX_JUMP, Observation, check_observation
from handsight.rig import Rig
from handsight.rig.units import Units, check_held
from handsight.tracking.fingertips import FingertipContacts
from handsight.tracking.follower import Follower
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.judge import sigma
from handsight.tracking.measurements import VisionUpdate
from handsight.tracking.monitor import State
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.skin import SkinContacts
from handsight.tracking.smoother import PoseBiasSmoother
from handsight.tracking.table import TableEstimate
from handsight.tracking.track_state import TrackState
from handsight.tracking.warm import warm_tracker
from handsight.vision import FirstPoseSource, locate

__all__ = ["State", "Tracker", "TrackerSettings"]

MAX_LEFT_OUT = 100
"""The object is lost once so many observations in a row were late or invalid."""


class Tracker:
    """Follows one object in one hand: each observation updates the object's pose.

    Between corrections the object is fixed in the palm (the paper's assumption) with growing uncertainty; while it is
    not grasped, it is fixed in the world. The pose is corrected when a finger touches or lets go, when a contact has
    moved, when the object slips, when vision arrives, or at a set rate.

    Stamps must increase; an observation older than the last one is late, and left out. An observation more than a
    second (`MAX_JUMP`) from the last one is held back until the next one: if that is nearer to it than to those before,
    both are used, else it is left out. Where the clock was set back so, a new track starts from `start` or from vision,
    and `reason` says so for a second.

    All that is known of the object is one value, `track_state`, from which `Follower.step` makes the next one. A
    tracker can be copied and pickled.
    """

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        start: PosePrior | None = None,
        settings: TrackerSettings | None = None,
        joint_offsets: JointOffsets | None = None,
        friction: tuple[float, float] | None = None,
        source: FirstPoseSource = locate,
    ) -> None:
        """`start`: the object's pose in the palm before the first observation; None: the first pose from vision.

        `joint_offsets`: those of a tracker that followed another object in this hand; None: zero, with the rig's sigma.
        `friction`: coefficient of friction between tips and object, and its sigma; None: that of the model, else of
        the rig's fingers, else it is learnt.
        `source`: finds the object in a depth image at first and when it was lost.
        """
        if not isinstance(rig, Rig) or not isinstance(model, ObjectModel):
            came = f"{type(rig).__name__} and {type(model).__name__}"
            raise InvalidInput(f"tracker: expected a Rig and an ObjectModel, got {came}")
        check_held(rig, model)
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
        if friction is not None:
            if not (isinstance(friction, tuple | list) and len(friction) == 2):
                raise InvalidInput(
                    f"friction: expected a coefficient and its sigma, got {checks.brief(friction)}"
                )
            model = model.with_friction(*friction)
        warm_tracker()
        self.rig = rig
        self.model = model
        self.settings = settings or TrackerSettings()
        self.follower = Follower(rig, model, self.settings, source)
        """Makes the next state of a state and an observation."""
        self.track_state = self.follower.initial(start, offsets)
        """All that is known of the object, as a value."""
        self._units = Units(rig)
        # The last observation, if its stamp jumped and no other has confirmed it yet.
        self._held: Observation | None = None
        # Why the track is a new one, and when it began [s].
        self._restarted = "", -math.inf
        self.late = self.refused = 0
        """How many observations were left out: those older than the last one or with a stamp that the next one
        contradicted, and invalid ones."""
        self.state: State = "lost"
        """How far to trust the answer."""
        self.reason = self.track_state.monitor.reason
        """Why it cannot be trusted further; empty while tracking."""
        self._left_out_in_a_row = 0

    def __repr__(self) -> str:
        """Returns which object is tracked, and how well."""
        trust = f"{self.state} ({self.reason})" if self.reason else self.state
        return f"<Tracker of {self.model.name}: {trust}, {self.corrections} corrections>"

    def update(self, observation: Observation) -> PoseEstimate | None:
        """Returns the object's pose in the palm now; None before there was a start or a pose from vision.

        `state` and `reason` say how far to trust it. The object is also lost once `MAX_LEFT_OUT` observations in a
        row, or all of the last `settings.lost_after` seconds, were left out. An observation that is late, or held back
        because its stamp jumped, changes nothing else; after one that was used, `stamp` is its stamp. Raises
        InvalidInput for an invalid observation, for a finger that the rig lacks, and for values that seem to be in a
        wrong unit; such an observation is counted in `refused` and changes nothing else.
        """
        last, held = self.track_state, self._held
        try:
            clean = self._complete(check_observation(observation))
            self._units.check_names(clean)
            ahead = clean.stamp - last.stamp
            jumps = last.stamp > -math.inf and abs(ahead) > MAX_JUMP
            if jumps and (held is None or abs(clean.stamp - held.stamp) >= abs(ahead)):
                return self._hold(clean, ahead)
            known = last
            restarted = self._restarted
            if jumps and held is not None:
                if ahead < 0:
                    known = self._new_track()
                    restarted = f"the clock went back by {-ahead:.1f} s: a new track", held.stamp
                known, _ = self.follower.step(known, held)
            late = clean.stamp < known.stamp
            state, estimate = (known, known.estimate) if late else self.follower.step(known, clean)
            if not late:
                self._units.check(clean)
        except Exception as error:
            self.refused += 1
            self._leave_out(getattr(observation, "stamp", None), str(error))
            if isinstance(error, np.linalg.LinAlgError):
                raise InvalidInput(f"observation: expected numbers that can be fused, got {error}") from error
            raise
        if held is not None and not jumps:
            self.late += 1
        self._held = None
        self._restarted = restarted
        self.track_state = state
        if state is not last:
            self.state, self.reason = state.monitor.label, state.monitor.reason
        if late:
            self.late += 1
            self._leave_out(clean.stamp, "older than the last one")
            return estimate
        self._left_out_in_a_row = 0
        message, since = restarted
        if message and (estimate is None or clean.stamp - since <= MAX_JUMP):
            self.state = "lost" if self.state == "lost" else "uncertain"
            self.reason = "; ".join(filter(None, (message, self.reason)))
        return estimate

    def _complete(self, observation: Observation) -> Observation:
        """Returns the observation with the positions of the coupled joints that were not measured."""
        joints = observation.joint_positions
        known = None if joints is None else self.rig.hand.couplings.completed(joints)
        return observation if known is joints else replace(observation, joint_positions=known)

    def close(self) -> None:
        """Ends the thread of `TrackerSettings.concurrent_images`, if there is one; no update may follow."""
        self.track_state.images.close()

    def _hold(self, observation: Observation, ahead: float) -> PoseEstimate | None:
        """Holds an observation back whose stamp is so far `ahead` of the last one [s]; returns the last answer."""
        if self._held is not None:
            self.late += 1
        self._held = observation
        self._leave_out(None, f"its stamp is {ahead:+.1f} s from the last one, and no other confirms it")
        return self.estimate

    def _new_track(self) -> TrackState:
        """Returns the state at which a new track begins, which keeps what was learnt of the robot."""
        last = self.track_state
        first = self.follower.initial(last.belief.start, last.offsets)
        monitor = replace(first.monitor, corrections=last.monitor.corrections)
        return replace(first, monitor=monitor, learnt_from=last.learnt_from)

    def vision_bias(self) -> tuple[Array, Array] | None:
        """Returns the constant part (6,) of vision's error, see `PoseAndBias.vision_bias`, and its covariance (6, 6).

        Vision and contacts together estimate it, the more the palm turns; None before there were both.
        """
        known = self.track_state
        if self.smoother is None or known.correction is None or self.vision.mount is None:
            return None
        estimate = known.correction.estimate
        state = self.smoother.now.given_pose(estimate.T_palm_object, estimate.information)
        return state.vision_bias, state.covariance[6:12, 6:12]

    def vision_latency(self) -> tuple[float, float] | None:
        """Returns how much older vision's poses are than their stamps, and its standard deviation [s].

        It is estimated while the hand moves the object, and taken away: a pose from vision is compared with the palm's
        at that earlier time. None before there was a pose from vision.
        """
        smoother = self.smoother
        if smoother is None or self.vision.mount is None:
            return None
        return smoother.latency, float(np.sqrt(smoother.solved.covariance[18, 18]))

    @property
    def stamp(self) -> float:
        """Stamp of the last observation [s]."""
        return self.track_state.stamp

    @property
    def estimate(self) -> PoseEstimate | None:
        """The object's pose in the palm; None before there was one."""
        return self.track_state.estimate

    @property
    def corrections(self) -> int:
        """How often the pose was corrected."""
        return self.track_state.monitor.corrections

    @property
    def T_world_palm(self) -> Array | None:
        """(4, 4) the last known pose of the palm; None before it was measured."""
        return self.track_state.belief.T_world_palm

    @property
    def fingertips(self) -> FingertipContacts:
        """What the fingertips measure."""
        return self.track_state.touch.fingertips

    @property
    def skin(self) -> SkinContacts:
        """What the tactile arrays measure."""
        return self.track_state.touch.skin

    @property
    def processed(self) -> Observation | None:
        """The last observation, its vision replaced by the pose from its image, if it had one."""
        return self.track_state.processed

    @property
    def vision(self) -> VisionUpdate:
        """The gate of vision's measurements, with the number of those that were rejected."""
        return self.track_state.belief.vision

    @property
    def smoother(self) -> PoseBiasSmoother | None:
        """The pose and vision's bias, estimated from vision alone; None before there was a start or vision."""
        return self.track_state.belief.smoother

    @property
    def joint_offsets(self) -> JointOffsets:
        """The joints' constant errors, learnt from all grips so far; the next object's tracker can start from them."""
        return self.follower.joint_offsets(self.track_state)

    @property
    def sigma(self) -> float:
        """The largest standard deviation of the position of the object's middle [m]; infinite without a pose."""
        return sigma(self.model, self.track_state)

    @property
    def table(self) -> TableEstimate | None:
        """Where the table must be, as the object was grasped on it, and why it is doubted, if it is; None without."""
        return self.follower.table(self.track_state)

    @property
    def slip(self) -> Slip:
        """Whether the object slips, and how near each finger is to slipping."""
        return self.track_state.slip.now

    @property
    def weight(self) -> ObjectWeight | None:
        """The object's weight and centre of mass; None where it has not been weighed since the grasp."""
        return self.track_state.weight.of(self.estimate)

    @property
    def unweighed(self) -> str:
        """Why the object is not weighed now, or why its weight cannot be trusted; empty where neither holds."""
        return self.track_state.weight.weigher.reason

    @property
    def images(self) -> dict[str, int]:
        """How many depth images were evaluated (`looked_at`), in how many of them the object was detected
        (`object_seen`), how often the palm was searched for (`hand_sought`) and detected; empty without images."""
        return self.track_state.images.counts

    def _leave_out(self, stamp: object, reason: str) -> None:
        """Counts an observation that was left out, and says that the object is lost after too many."""
        self._left_out_in_a_row += 1
        age = stamp - self.stamp if type(stamp) is float and self.stamp > -math.inf else 0.0
        if self._left_out_in_a_row >= MAX_LEFT_OUT or age > self.settings.lost_after:
            self.state = "lost"
            self.reason = f"left out {self._left_out_in_a_row} observations in a row, the last: {reason}"
