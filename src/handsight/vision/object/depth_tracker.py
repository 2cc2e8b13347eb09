"""An object's pose followed from depth image to depth image, at the camera's rate.

Each image is looked at near where the object is expected: it rides with the palm that grips it, else goes on about as
it went. Depth settles the pose, and what depth does not see stays as expected, with a covariance that grows: a jug
whose handle the hand hides fits at any turn, and only its covariance tells.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._deprecated import renamed_members
from handsight._kernels.image import depth_covariance
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.locate import locate
from handsight.vision.object.pose_covariance import UNKNOWN
from handsight.vision.object.pose_refiner import PoseRefiner, RefinedPose

State = Literal["tracking", "uncertain", "lost"]


class DepthTrackerOptions(NamedTuple):
    """`DepthTrackerOptions` say how an object is followed from image to image."""

    velocity_share: float = 0.8
    """Of its velocity, that an object in nobody's grip is expected to have until the next image."""
    max_gap: float = 0.5  # between images, for a velocity to be used [s]
    min_points: int = 15  # below so many near it an image says nothing of a pose
    min_pixels: float = 20.0  # below so many explained by it an image says nothing of a pose
    min_against: float = 30.0  # pixels that contradict a pose, at least, for an image to do so
    uncertain: float = 0.08  # how far off its surface may be for a pose to be known [diameters]
    lost: float = 0.12  # and for it to be kept while nothing is detected [diameters]
    min_twin: float = 0.05
    """Weight of a pose that was found, of the likeliest's, for it to be taken where the object was turned like that."""
    search_period: float = 0.2  # between searches of the entire image [s]
    min_found: float = 0.6  # share of the pixels that it would fill, for an object to be found


DEPTH_TRACKER = DepthTrackerOptions()

WANDERS, WANDERS_IN_PALM = (0.15, 1.0), (0.02, 0.15)
"""How far off that is, and how an object moves in the palm [m/s, rad/s]."""
HIDDEN = "hardly anything of it is seen"


@renamed_members(look="candidate")
@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A `Sighting` is what a depth image says of an object that is followed."""

    stamp: float
    """Of the image [s]."""
    T_camera_object: Array | None
    """(4, 4); None: lost."""
    covariance: Array | None
    """(6, 6) of (δp [m], δθ [rad]) of the object's origin along the camera's axes; None: lost."""
    state: State
    """`tracking`; `uncertain`: it fits, and might as well elsewhere; `lost`: it does not fit."""
    reason: str
    """Why it is not `tracking`; empty if it is."""
    candidate: NDArray[np.void]
    """CANDIDATE (1,): the pose that was tried, and what the image says of it."""


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    stamp: float
    depth: Depth
    hand: Mask | None
    table: Array | None
    T_camera_palm: Array | None
    gripped: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Belief:
    """A `_Belief` says where the object is thought to be in a frame."""

    stamp: float
    T_camera_object: Array
    covariance: Array
    velocity: Array
    """(6,) of the object's centre [m/s, rad/s]."""
    T_camera_palm: Array | None
    lost: bool


class DepthTracker:
    """Follows an object in a camera's depth images; finds it by itself, at first and when it was lost."""

    def __init__(
        self,
        model: ObjectModel,
        camera: Camera,
        *,
        noise: DepthNoise = STRUCTURED_LIGHT,
        start: Array | None = None,
    ) -> None:
        """`noise`: of the camera's depth; `start`: T_camera_object to begin from; raises InvalidTransform."""
        self.model, self.camera = model, camera
        self._middle, self._refiner = model.center_object, PoseRefiner(model, camera, noise)
        self._start = None if start is None else se3.check(start, "start")
        self._belief: _Belief | None = None
        self._searched = -np.inf

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

        hand: (h, w) its pixels. table: (4,) `n·P + offset = 0` in the camera, n towards it. gripped: the object moves
        with the palm, where T_camera_palm is known. expected: T_camera_object from elsewhere, to begin from. An image
        a little older than the last one is answered, and changes nothing. Raises InvalidInput for images of another
        size than the camera's, InvalidTransform for poses that are none.
        """
        for name, image in (("depth", depth), ("hand", hand)):
            if image is not None:
                self.camera.check_size(image, name)
        T_palm = None if T_camera_palm is None else se3.check(T_camera_palm, "T_camera_palm")
        plane = None if table is None else checks.finite(table, "table", (4,))
        hint = None if expected is None else se3.check(expected, "expected")
        now = float(checks.finite(stamp, "stamp", ()))
        frame = _Frame(now, depth, hand, plane, T_palm, gripped)
        before = self._belief, self._searched
        sighting = self._observed(frame, self._predicted(frame, hint))
        if before[0] is not None and 0 < before[0].stamp - now <= DEPTH_TRACKER.max_gap:
            self._belief, self._searched = before
        return sighting

    def _observed(self, frame: _Frame, predicted: _Belief | None) -> Sighting:
        refined, reason = None, "not found"
        if predicted is not None:
            refined = self._refined(frame, predicted)
            reason = self._misfit(predicted, refined)
            if not reason:
                return self._followed(frame, predicted, refined)
        found = self._found(frame)
        if found is not None:
            return self._followed(frame, *found)
        self._belief = predicted and replace(predicted, lost=True)
        candidate = np.zeros(1, dtype=CANDIDATE) if refined is None else refined.candidate
        return Sighting(frame.stamp, None, None, "lost", reason, candidate)

    def _misfit(self, predicted: _Belief, refined: RefinedPose) -> str:
        """Returns why the object is lost; empty if it is not."""
        candidate, enough = refined.candidate[0], _is_enough(refined)
        against = candidate["passed"] + candidate["hidden"]
        if against > max(candidate["explained"], DEPTH_TRACKER.min_against):
            share = candidate["explained"] / (candidate["explained"] + against)
            return f"it explains {100 * share:.0f} % of what is seen there"
        if enough or not (
            predicted.lost or self._unsure(predicted) > DEPTH_TRACKER.lost * self.model.diameter
        ):
            return ""
        return HIDDEN

    def _predicted(self, frame: _Frame, hint: Array | None) -> _Belief | None:
        """Returns what is believed of this frame before it is looked at; None: nothing."""
        last = self._belief
        if last is None:
            hint = self._start if hint is None else hint
            return (
                None
                if hint is None
                else _Belief(frame.stamp, hint, self._unknown(hint), np.zeros(6), frame.T_camera_palm, False)
            )
        dt = max(frame.stamp - last.stamp, 0.0)
        T, P, wanders = last.T_camera_object, last.covariance, WANDERS
        velocity = (
            DEPTH_TRACKER.velocity_share * last.velocity if dt <= DEPTH_TRACKER.max_gap else np.zeros(6)
        )
        if frame.gripped and frame.T_camera_palm is not None and last.T_camera_palm is not None:
            moved = frame.T_camera_palm @ se3.inverse(last.T_camera_palm)
            T, P, wanders = moved @ T, se3.rotate_covariance(moved[:3, :3], P), WANDERS_IN_PALM
        else:
            T = self._of_center(se3.moved(self._center(T), velocity * dt))
        P = P + self._about_origin(T, np.repeat([(dt * w) ** 2 for w in wanders], 3))
        return _Belief(frame.stamp, T if hint is None else hint, P, velocity, frame.T_camera_palm, last.lost)

    def _found(self, frame: _Frame) -> tuple[_Belief, RefinedPose] | None:
        """Returns the object somewhere in the image, if it is time to search and it is there."""
        if abs(frame.stamp - self._searched) < DEPTH_TRACKER.search_period:
            return None
        self._searched = frame.stamp
        found = locate(
            self.model,
            self.camera,
            frame.depth,
            hand=frame.hand,
            table=frame.table,
            noise=self._refiner.noise,
        )
        fits = found.candidates["explained"] >= DEPTH_TRACKER.min_found * found.candidates["expected"]
        chosen = np.flatnonzero(
            fits & (found.weights >= DEPTH_TRACKER.min_twin * found.weights.max(initial=0.0))
        )
        if not len(chosen):
            return None
        T = self._likeliest(found.Ts_camera_object[chosen])
        belief = _Belief(frame.stamp, T, self._unknown(T), np.zeros(6), frame.T_camera_palm, True)
        refined = self._refined(frame, belief)
        return None if self._misfit(belief, refined) else (belief, refined)

    def _likeliest(self, Ts: Array) -> Array:
        """Returns, of poses that an image supports about alike, the one turned least from where the object was."""
        if self._belief is None:
            return np.asarray(Ts[0])
        turns = se3.rotation_log(Ts[:, :3, :3] @ self._belief.T_camera_object[:3, :3].T)
        return np.asarray(Ts[np.linalg.norm(turns, axis=1).argmin()])

    def _followed(self, frame: _Frame, predicted: _Belief, refined: RefinedPose) -> Sighting:
        enough = _is_enough(refined)
        now = self._belief = self._updated(frame, predicted, refined) if enough else predicted
        T, candidate, unsure = now.T_camera_object, refined.candidate, self._unsure(now)
        candidate["pose"]["rotation"], candidate["pose"]["position"] = T[:3, :3], T[:3, 3]
        reason = "" if enough else HIDDEN
        if enough and unsure > DEPTH_TRACKER.uncertain * self.model.diameter:
            reason = f"its surface may be off by {1000 * unsure:.0f} mm where it is not seen"
        return Sighting(
            frame.stamp, T, now.covariance, "uncertain" if reason else "tracking", reason, candidate
        )

    def _updated(self, frame: _Frame, predicted: _Belief, refined: RefinedPose) -> _Belief:
        """Returns what was expected and what was seen, each as much as it knows (Kalman)."""
        P, last = predicted.covariance, self._belief
        gain = np.linalg.solve(P + refined.covariance, P).T
        off = se3.difference(refined.T_camera_object, predicted.T_camera_object)
        T, P = se3.moved(predicted.T_camera_object, gain @ off), P - gain @ P
        velocity = predicted.velocity
        if last is None or predicted.lost:
            velocity = np.zeros(6)
        elif 0 < frame.stamp - last.stamp <= DEPTH_TRACKER.max_gap:
            was, now = self._center(last.T_camera_object), self._center(T)
            velocity = se3.difference(now, was) / (frame.stamp - last.stamp)
        return _Belief(frame.stamp, T, (P + P.T) / 2, velocity, frame.T_camera_palm, False)

    def _unsure(self, belief: _Belief) -> float:
        """Returns how far the object's surface may be off [m]: the most that a deviation along any of the three least
        known directions leaves it. A turn that it looks the same after leaves it where it is."""
        return depth_covariance.largest_shift(
            *self.model.record[:2], belief.T_camera_object[:3, :3], belief.covariance
        )

    def _refined(self, frame: _Frame, predicted: _Belief) -> RefinedPose:
        """Returns what an image says near where the object is expected."""
        T = predicted.T_camera_object
        J = se3.point_jacobian(T[:3, :3] @ self._middle)
        known = np.asarray(np.linalg.inv(J @ predicted.covariance @ J.T))
        return self._refiner.at(T, known, frame.depth, frame.hand, frame.table)

    def _unknown(self, T: Array) -> Array:
        """Returns the covariance of a pose that is as good as not known."""
        D = self.model.diameter
        return self._about_origin(
            T, np.repeat([(UNKNOWN[0] * D) ** 2, (UNKNOWN[1] * D / self.model.radius) ** 2], 3)
        )

    def _about_origin(self, T: Array, variances: Array) -> Array:
        """Returns the covariance (6, 6) at the object's origin of variances (6,) at its centre."""
        J = se3.point_jacobian(-T[:3, :3] @ self._middle)
        return (J * variances) @ J.T

    def _center(self, T: Array) -> Array:
        return se3.compose(T[:3, :3], T[:3, :3] @ self._middle + T[:3, 3])

    def _of_center(self, T: Array) -> Array:
        return se3.compose(T[:3, :3], T[:3, 3] - T[:3, :3] @ self._middle)


def _is_enough(refined: RefinedPose) -> bool:
    """Returns whether as much is seen as a pose takes."""
    return (
        refined.points >= DEPTH_TRACKER.min_points
        and refined.candidate["explained"][0] >= DEPTH_TRACKER.min_pixels
    )
