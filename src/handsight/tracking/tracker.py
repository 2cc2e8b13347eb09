"""The door of tracking: observations are checked, their clock is watched, and the pose is followed."""

import math
from typing import Any

from handsight import checks
from handsight._kernels.runtime.warm import warm_tracker
from handsight.checks import Array
from handsight.correction import PoseEstimate, PosePrior
from handsight.errors import InvalidInput
from handsight.forces import Slip
from handsight.objects import ObjectModel
from handsight.observation import Observation, check_observation
from handsight.rig import Rig
from handsight.tracking.joint_offsets import JointOffsets
from handsight.tracking.settings import TrackerSettings
from handsight.tracking.track import Track
from handsight.tracking.trust import State
from handsight.tracking.weight_update import ObjectWeight

__all__ = ["State", "Tracker", "TrackerSettings"]

MAX_JUMP = 1.0
"""A stamp farther from the last one, ahead or back, is a jump of the clock, which the next one must confirm [s]."""
MOST_UNCONFIRMED = 3
"""So many jumps ahead in a row can be taken back."""
MOST_LEFT_OUT = 100
"""So many observations in a row, late or wrong, may be left out before the object counts as lost."""

Snapshot = tuple[tuple[object, dict[str, Any]], ...]
"""What a tracker knew: its attributes, and those of its parts that change."""


class Tracker(Track):
    """One object in one hand. Give it every observation; it answers with the pose at each.

    The object is fixed in the palm between corrections (the paper's assumption), its uncertainty growing; while it is
    not grasped, it is fixed in the world. It is corrected when a finger touches or lets go, when a contact has moved,
    when the object slips, when vision arrives, or at a set rate.

    Stamps are to go on; what is older than the last one is late, and left out. Clocks jump all the same. A stamp more
    than a second ahead of the last is wrong, or the sensors have paused: it is believed, and taken back if the next one
    is nearer to those before. A stamp more than a second back is wrong, or the clock was set back, or a recording
    begins again: it is left out, but if the next one is nearer to it than to those before, a new track begins, from
    `start` or from vision, as `reason` says for a second.
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
        super().__init__(rig, model, start, settings or TrackerSettings(), offsets)
        self.late = self.undone = self.refused = 0
        """How many observations were left out: late ones, those taken back when the next told that their stamps were
        wrong, and those that were wrong in themselves."""
        self._left_out_in_a_row = 0
        self._why, self._began = "", -math.inf
        """Why the track is not the first, and when it began [s]."""
        self._earlier: tuple[Snapshot, ...] = ()
        """Before each of the last jumps ahead, as long as nothing has confirmed them."""
        self._back = math.inf
        """The last stamp, if it was back by more than `MAX_JUMP` [s]."""

    def update(self, observation: Observation) -> PoseEstimate | None:
        """The pose in the palm now; None as long as there has been neither a start nor a pose from vision.

        `state` and `reason` say how far to trust it; lost it is, too, once `MOST_LEFT_OUT` observations in a row, or
        all of `lost_after`, were left out. An observation older than the last one is counted in `late` and changes
        nothing else; of jumps of the clock see the class. Raises InvalidInput for what is wrong with the observation
        itself, which is counted in `refused` and changes nothing else.
        """
        before = self._snapshot()
        try:
            clean = check_observation(observation)
            if not self._is_next(clean.stamp):
                self.late += 1
                self._left_out(clean.stamp, "older than the last one")
                return self.estimate
            estimate, self._left_out_in_a_row = self._follow(clean), 0
        except BaseException as error:
            self._restore(before)
            if isinstance(error, Exception):
                self.refused += 1
                self._left_out(getattr(observation, "stamp", None), str(error))
            raise
        if self._why and (estimate is None or clean.stamp - self._began <= MAX_JUMP):
            self.state = "lost" if self.state == "lost" else "uncertain"
            self.reason = "; ".join(filter(None, (self._why, self.reason)))
        return estimate

    def vision_bias(self) -> tuple[Array, Array] | None:
        """Vision's constant bias (6,) and its covariance (6, 6), by vision and contacts together.

        See `PoseAndBias.vision_bias`. None before there were both.
        """
        if self.smoother is None or self._correction is None or self.vision.mount is None:
            return None
        estimate = self._correction.estimate
        state = self.smoother.now.given_pose(estimate.T_palm_object, estimate.information)
        return state.vision_bias, state.covariance[6:, 6:]

    @property
    def slip(self) -> Slip:
        """Whether the object slips, and how near to that each finger is."""
        return self._slipping.now

    @property
    def weight(self) -> ObjectWeight | None:
        """What the object weighs, and where its centre of mass is; None where it was not weighed since the grasp."""
        return self._weight.of(self.estimate)

    @property
    def unweighed(self) -> str:
        """Why the object is not weighed now, or what it weighs not believed; empty where it is."""
        return self._weight.weigher.reason

    @property
    def images(self) -> dict[str, int]:
        """What has become of depth images: how many were `looked_at`, and so on; empty where there were none."""
        return self._images.counts

    @property
    def links(self) -> tuple[str, ...]:
        """Links of the hand whose shapes keep the object out."""
        return self._hand.links

    @property
    def link_margins(self) -> dict[str, float]:
        """By link that would be inside the object though contacts fit: how much smaller it is than its shape [m]."""
        return self._margins.known

    @property
    def unconfirmed(self) -> int:
        """How many of the last observations were jumps ahead that the next may yet take back."""
        return len(self._earlier)

    def _is_next(self, stamp: float) -> bool:
        """Whether an observation of that stamp goes on from the last one, wherever the clock has jumped."""
        while (
            self._earlier
            and stamp < self.stamp - MAX_JUMP
            and abs(stamp - self._earlier[-1][0][1]["stamp"]) < self.stamp - stamp
        ):
            counts = self.late, self.undone + 1, self.refused
            self._restore(self._earlier[-1])
            self.late, self.undone, self.refused = counts
        ahead, back = stamp - self.stamp, self._back
        self._back = stamp if ahead < -MAX_JUMP else math.inf
        if -ahead > max(MAX_JUMP, abs(stamp - back)):
            self._begin()
            self._why, self._began = f"the clock went back by {-ahead:.1f} s: a new track", stamp
            self._back, self._earlier = math.inf, ()
        elif ahead > MAX_JUMP and self.stamp > -math.inf:
            self._earlier = (*self._earlier[1 - MOST_UNCONFIRMED :], self._snapshot())
        elif ahead >= -MAX_JUMP:
            self._earlier = ()
        return stamp >= self.stamp

    def _left_out(self, stamp: object, why: str) -> None:
        """Takes note of an observation that was left out."""
        self._left_out_in_a_row += 1
        age = stamp - self.stamp if type(stamp) is float and self.stamp > -math.inf else 0.0
        if self._left_out_in_a_row >= MOST_LEFT_OUT or age > self.settings.lost_after:
            self.state = "lost"
            self.reason = f"left out {self._left_out_in_a_row} observations in a row, the last: {why}"

    def _snapshot(self) -> Snapshot:
        """All that is known now: what an update changes it binds anew, and never changes in place."""
        eye = self._images.eye
        seeing = () if eye is None else (eye, eye.tracker)
        slips = self._slipping, self._slipping.detector, self._slipping.detector.friction
        weighs = self._weight, self._weight.weigher, self._skin
        parts = self, self.vision, self._grasp, self._memory, self._images, *slips, *weighs, *seeing
        return tuple((part, vars(part).copy()) for part in parts)

    def _restore(self, snapshot: Snapshot) -> None:
        for part, values in snapshot:
            vars(part).update(values)
