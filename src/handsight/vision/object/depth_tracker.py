"""An object's pose followed from depth image to depth image, at the camera's rate.

Each image is searched near where the object is expected: an object in a grip moves with the palm, another goes on about
as it moved before. The answer is what this one image says of the pose. What it does not show stays as expected, with a
covariance as if nothing were known of it: a jug whose handle is hidden fits at any turn, and only its covariance says
so.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.vision.candidates import UNKNOWN, candidates_at
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.kernels import depth_covariance
from handsight.vision.kernels.vision_records import CANDIDATE
from handsight.vision.object.locate import FirstPoseSource, locate
from handsight.vision.object.pose_refiner import PoseRefiner, RefinedPose
from handsight.vision.object.region import check_metres
from handsight.vision.object.rivals import NO_RIVALS, TWIN_DISTANCE, Rivals

State = Literal["tracking", "uncertain", "lost"]


VELOCITY_SHARE = 0.8  # of its velocity, that an object outside a grip keeps until the next image
MAX_GAP = 0.5  # between images, for a velocity to be used [s]
TRACK_DRIFT = 0.15  # sigma of the other motion of an object that is hidden [m/s]
DRIFT_IN_PALM = 0.016  # and of its motion in a grip, or of one that is seen [m/s]
ONE_INSTANT = 1e-3  # least time in which an object moves [s]
MIN_POINTS = 15  # near the surface that an image must have to give a pose
MIN_PIXELS = 20  # explained pixels that an image must have to give a pose
MIN_PASSED = (
    30  # pixels that the camera sees past a pose, for an image to contradict one that it hardly shows
)
FOLLOWED, LOST = 2.2, -1.8
"""Log odds, before an image, that an object is where it is expected: it was there in the last image, or was not."""
LEAST_SHOWN = 0.05  # share of its pixels, below which it is not asked how few show it
TRACK_UNCERTAIN = 0.08  # shift of its surface beyond which a pose is uncertain [diameters]
TRACK_LOST = 0.12  # and beyond which a hidden object is lost [diameters]
MIN_TWIN = 0.05
"""Least weight, as a share of the likeliest pose's, of a pose that may be chosen for its rotation near the last."""
SEARCH_PERIOD = 0.2  # between searches of the entire image [s]
HIDDEN = "hardly anything of it is seen"


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What one depth image says of the pose of an object that is followed."""

    stamp: float  # of the image [s]
    T_camera_object: Array | None  # (4, 4); None: lost
    covariance: Array | None
    """(6, 6) of (δp [m], δθ [rad]) of the object's origin along the camera's axes, by this image alone; None: lost."""
    state: State  # `tracking`; `uncertain`: the pose fits, but others may fit as well; `lost`: no pose fits
    reason: str  # why it is not `tracking`; empty if it is
    candidate: NDArray[np.void]  # CANDIDATE (1,): the pose that was tried, and how well the image supports it


class _Image(NamedTuple):
    """The checked arguments of `DepthTracker.update`."""

    stamp: float
    depth: Depth
    hand: Mask | None
    table: Array | None
    T_camera_palm: Array | None
    gripped: bool

    @property
    def rides(self) -> bool:
        """Whether the object moves with the palm, whose pose is known."""
        return self.gripped and self.T_camera_palm is not None


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Where an object was in the last image, or is expected in the next one."""

    stamp: float  # of that image [s]
    T_camera_object: Array
    T_at_rest: Array
    """(4, 4) T_camera_object if it has not moved since the image before, or only with the palm that grips it."""
    T_camera_palm: Array | None
    prior: float  # log odds that it is where it is expected, before an image
    seen: float = -np.inf  # stamp of the last image that showed enough of it [s]
    velocity: Array | None = None  # (6,) of its centre [m/s, rad/s]; None: not known


class DepthTracker:
    """Follows an object in a camera's depth images, and searches it at first and when it was lost."""

    def __init__(
        self,
        model: ObjectModel,
        camera: Camera,
        *,
        noise: DepthNoise = STRUCTURED_LIGHT,
        start: Array | None = None,
        source: FirstPoseSource = locate,
    ) -> None:
        """`noise`: of the camera's depth; `start`: T_camera_object to begin from; raises InvalidTransform."""
        self.source = source
        """Finds the object at first and when it was lost; it may be set anew between images."""
        self.model, self.camera = model, camera
        self._refiner = PoseRefiner(model, camera, noise)
        self._T_object_center = se3.compose(np.eye(3), model.center_object)
        self._start = None if start is None else se3.rounded(start, "start")
        self._track: _Track | None = None
        self.rivals = NO_RIVALS
        """Other poses that all images explain."""
        self._searched = -np.inf
        self._absent = "not found"

    def update(
        self,
        stamp: float,
        depth: Depth,
        *,
        hand: Mask | None = None,
        table: Array | None = None,
        T_camera_palm: Array | None = None,
        gripped: bool = False,
        expected: Array | None = None,
    ) -> Sighting:
        """Returns where the object is in a depth image (h, w) [m], 0 or NaN where there is none.

        hand (h, w): whether a pixel is the hand's. table (4,): `n·P + offset = 0` in the camera, n towards it. gripped:
        the object moves with the palm, where T_camera_palm is known. expected: T_camera_object from another source,
        near which the object is looked for if it is lost, or followed elsewhere. An image a little older than the last
        one is answered, but does not change the state. Raises InvalidInput for images of another size than the camera's
        and for depth that is not in metres, InvalidTransform for matrices that are no poses.
        """
        depth = self.camera.check_depth(depth)
        check_metres(depth)
        if hand is not None:
            self.camera.check_size(hand, "hand")
        if T_camera_palm is not None:
            T_camera_palm = se3.check(T_camera_palm, "T_camera_palm")
        if table is not None:
            table = checks.finite(table, "table", (4,))
        if expected is not None:
            expected = se3.rounded(expected, "expected")
        now = float(checks.finite(stamp, "stamp", ()))
        track, rivals, searched = self._track, self.rivals, self._searched
        sighting = self._observed(_Image(now, depth, hand, table, T_camera_palm, gripped), expected)
        if track is not None and 0 < track.stamp - now <= MAX_GAP:
            self._track, self.rivals, self._searched = track, rivals, searched
        return sighting

    def _observed(self, image: _Image, hint: Array | None) -> Sighting:
        """Returns where the object is in an image, and remembers that."""
        predicted = None if self._track is None else self._predicted(image, self._track)
        rivals = self.rivals
        self._absent = "not found"
        reasons = list[str]()
        candidate = np.zeros(1, dtype=CANDIDATE)
        for track in self._places(image, predicted, hint):
            for refined, prior in self._looks(image, track):
                reason = self._misfit(image, track, refined, prior)
                if not reason:
                    return self._followed(image, track, refined)
                if not reasons:
                    candidate = refined.candidate
                reasons.append(reason)
        self._track = predicted and replace(predicted, prior=LOST, seen=-np.inf)
        self.rivals = rivals
        reason = reasons[0] if reasons else self._absent
        return Sighting(image.stamp, None, None, "lost", reason, candidate)

    def _places(self, image: _Image, predicted: _Track | None, hint: Array | None) -> Iterator[_Track]:
        """Yields where the object may be in an image, the likeliest first, at last where it is found in all of it."""
        if predicted is None and hint is None:
            hint = self._start
        lost = predicted is None or predicted.prior == LOST
        if hint is not None and (predicted is None or lost or self._is_far(predicted, hint)):
            self.rivals = NO_RIVALS
            yield _anew(image, hint, FOLLOWED)
        if predicted is not None and not (lost and hint is not None):
            yield predicted
            yield from self._of_rivals(image, predicted)
        found = self._found(image)
        if found is not None:
            yield found
            yield from self._of_rivals(image, found)

    def _of_rivals(self, image: _Image, track: _Track) -> Iterator[_Track]:
        """Yields where the object may be if the pose that is followed is not the right one of those that looked alike,
        the likeliest first; the rivals are then those of that pose."""
        rivals = self.rivals
        for number in np.argsort(-rivals.log_odds):
            self.rivals = rivals.against(int(number))
            yield _anew(image, track.T_camera_object @ rivals.T_object_rivals[number], FOLLOWED)

    def _is_far(self, track: _Track, T_camera_object: Array) -> bool:
        """Returns whether an object is expected so far from a pose (4, 4) that it may be another one there."""
        off = (track.T_camera_object - T_camera_object)[:3] @ np.append(self.model.center_object, 1.0)
        return bool(np.linalg.norm(off) > TWIN_DISTANCE * self.model.diameter)

    def _predicted(self, image: _Image, last: _Track) -> _Track:
        """Returns where the object is expected in an image."""
        dt = max(image.stamp - last.stamp, 0.0)
        velocity = None if last.velocity is None or dt > MAX_GAP else VELOCITY_SHARE * last.velocity
        if image.gripped and image.T_camera_palm is not None and last.T_camera_palm is not None:
            T_new_old = image.T_camera_palm @ se3.inverse(last.T_camera_palm)
            T = at_rest = T_new_old @ last.T_camera_object
        else:
            T = at_rest = last.T_camera_object
            if velocity is not None:
                T_camera_center = se3.moved(at_rest @ self._T_object_center, velocity * dt)
                T = T_camera_center @ se3.inverse(self._T_object_center)
        return replace(
            last,
            stamp=image.stamp,
            T_camera_object=T,
            T_at_rest=at_rest,
            T_camera_palm=image.T_camera_palm,
            velocity=velocity,
        )

    def _looks(self, image: _Image, track: _Track) -> Iterator[tuple[RefinedPose, float]]:
        """Yields what an image says of an object that moves as expected, and if it moves otherwise, each with the log
        odds before the image."""
        moves = track.velocity is not None or image.rides
        drift = DRIFT_IN_PALM if moves else TRACK_DRIFT
        yield self._refined(image, track, drift, track.T_at_rest), track.prior
        seen = track.seen > -np.inf
        yield self._refined(image, track, TRACK_DRIFT, None), min(track.prior, 0.0) if seen else track.prior

    def _refined(self, image: _Image, track: _Track, drift: float, T_at_rest: Array | None) -> RefinedPose:
        """Returns the pose that an image gives from the expected one on, from which it drifts so fast [m/s]."""
        since = max(image.stamp - track.seen, ONE_INSTANT)
        unknown = np.array(UNKNOWN) * self.model.diameter
        sigma_shift, sigma_turn = np.minimum(drift * since, unknown) / (1.0, self.model.radius)
        known = np.diag(np.repeat([sigma_shift**-2, sigma_turn**-2], 3))
        T = track.T_camera_object
        return self._refiner.at(T, known, image.depth, image.hand, image.table, T_at_rest=T_at_rest)

    def _misfit(self, image: _Image, track: _Track, refined: RefinedPose, prior: float) -> str:
        """Returns why the object is not where it was expected; empty if it may be."""
        enough = _is_enough(refined)
        candidate = refined.candidate[0]
        if track.seen > -np.inf:
            # The fewer pixels show an object that was there, the less they contradict it.
            prior = prior * max(refined.shown, LEAST_SHOWN) ** -0.5
        elif prior > 0:  # what would be hidden, and not by the hand, may be a part of what hides it
            prior = prior * (1 - candidate["hidden"] / max(candidate["expected"], 1.0))
        odds = refined.odds + prior
        if odds < 0 and (enough or candidate["passed"] > MIN_PASSED):
            probability = 1 / (1 + np.exp(-odds))
            return f"it is where it was expected with a probability of {probability:.2f} only"
        drift = DRIFT_IN_PALM if image.rides else TRACK_DRIFT
        gone = drift * (image.stamp - track.seen) > TRACK_LOST * self.model.diameter
        return HIDDEN if gone and not enough else ""

    def _found(self, image: _Image) -> _Track | None:
        """Returns the object somewhere in the image, if it is time to search and it is there."""
        if abs(image.stamp - self._searched) < SEARCH_PERIOD:
            return None
        self._searched = image.stamp
        noise = self._refiner.noise
        found = self.source(
            self.model, image.depth, self.camera, hand=image.hand, table=image.table, noise=noise
        )
        if found.reason:
            self._absent = f"not found: {found.reason}"
        Ts = found.Ts_camera_object
        if not len(Ts):
            return None
        if self._track is None:
            self.rivals = Rivals.of(self.model, found, 0)
            return _anew(image, Ts[0], FOLLOWED)
        # Of poses that fit alike, the one turned least from where it was.
        alike = np.flatnonzero(found.weights >= MIN_TWIN * found.weights.max())
        last = self._track.T_camera_object[:3, :3]
        turns = np.linalg.norm(se3.rotation_log(Ts[alike, :3, :3] @ last.T), axis=1)
        return _anew(image, Ts[alike[turns.argmin()]], LOST)

    def _told_apart(self, image: _Image, track: _Track, refined: RefinedPose) -> RefinedPose:
        """Weighs the rivals by an image; returns what it says of the pose that is followed from now on."""
        T = refined.pose_camera_object.T_a_b
        looks = [
            self._refined(image, replace(track, T_camera_object=T @ each), DRIFT_IN_PALM, None)
            for each in self.rivals.T_object_rivals
        ]
        gains = np.array([look.odds - refined.odds for look in looks])
        Ts = np.array([look.pose_camera_object.T_a_b for look in looks])
        rivals = self.rivals.weighed(T, Ts, gains)
        winner = rivals.winner
        if winner is None:
            self.rivals = rivals.likely()
            return refined
        self.rivals = rivals.against(winner)
        return looks[winner]

    def _followed(self, image: _Image, track: _Track, refined: RefinedPose) -> Sighting:
        """Returns what an image says of a pose that it does not contradict, from which the object is followed on."""
        enough = _is_enough(refined)
        if enough and len(self.rivals):
            refined = self._told_apart(image, track, refined)
        measured = refined.pose_camera_object
        reason = self.rivals.reason(self.model)
        if enough:
            velocity = None if track.seen == -np.inf else self._velocity(image.stamp, measured.T_a_b)
            track = replace(
                track, T_camera_object=measured.T_a_b, prior=FOLLOWED, seen=image.stamp, velocity=velocity
            )
            unsure = surface_shift(self.model, measured)
            if unsure > TRACK_UNCERTAIN * self.model.diameter:
                reason = f"its surface may be off by {1000 * unsure:.0f} mm where it is not seen"
        else:
            reason = HIDDEN
        self._track = track
        T = track.T_camera_object
        refined.candidate["pose"] = candidates_at(T[None])["pose"]
        state: State = "uncertain" if reason else "tracking"
        return Sighting(image.stamp, T, measured.covariance, state, reason, refined.candidate)

    def _velocity(self, stamp: float, T_camera_object: Array) -> Array | None:
        """Returns the velocity (6,) of the object's centre since the last image; None: not known."""
        last = self._track
        if last is None or not 0 < stamp - last.stamp <= MAX_GAP:
            return None
        center = self._T_object_center
        moved = se3.difference(T_camera_object @ center, last.T_camera_object @ center)
        return np.asarray(moved / (stamp - last.stamp))


def _anew(image: _Image, T_camera_object: Array, prior: float) -> _Track:
    """Returns that the object is about there, without having been seen."""
    return _Track(image.stamp, T_camera_object, T_camera_object, image.T_camera_palm, prior)


def _is_enough(refined: RefinedPose) -> bool:
    """Returns whether an image shows enough of the object to say something of its pose."""
    explained = refined.candidate["explained"][0]
    return bool(refined.points >= MIN_POINTS and explained >= MIN_PIXELS)


def surface_shift(model: ObjectModel, pose: GaussianPose) -> float:
    """Returns the most that one sigma along any of the three least known directions moves the object's surface [m]. A
    turn that the object looks the same after does not move it."""
    return depth_covariance.largest_shift(*model.record[:2], pose.T_a_b, pose.covariance)
