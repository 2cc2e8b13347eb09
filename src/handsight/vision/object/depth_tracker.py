"""An object's pose followed from depth image to depth image, at the camera's rate.

Each image is searched near where the object is expected: an object in a grip moves with the palm, another goes on about
as it moved before. What the image does not show of a pose stays as expected, with a covariance that grows: a jug whose
handle is hidden fits at any turn, and only its covariance says so.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels.image import depth_covariance
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.vision.candidates import UNKNOWN, candidates_at, center_depths
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.locate import FirstPoseSource, locate
from handsight.vision.object.pose_refiner import PoseRefiner, RefinedPose, against, support_share
from handsight.vision.object.region import check_metres

State = Literal["tracking", "uncertain", "lost"]


VELOCITY_SHARE = 0.8  # of its velocity, that an object outside a grip keeps until the next image
MAX_GAP = 0.5  # between images, for a velocity to be used [s]
TRACK_DRIFT = (0.15, 1.0)  # sigma of its other motion [m/s, rad/s]
DRIFT_IN_PALM = (0.02, 0.15)  # and of its motion in a grip [m/s, rad/s]
TRACK_UNCHANGED = 2.0  # squared error of the expected pose up to which its motion has not changed
MIN_POINTS = 15  # near the surface that an image must have to give a pose
MIN_PIXELS = 20  # explained pixels that an image must have to give a pose
MIN_AGAINST = 30  # pixels against a pose that an image must have to contradict it
MIN_FIT = 0.7
"""Share of explained pixels among them and those against a pose at which an image says neither that it is right nor
that it is wrong."""
FIT_WEIGHT = 6  # of what is above or below it in the log odds that the pose is right
MAX_RMS = 1.3  # of the distances of the explained pixels, above which it contradicts [their sigma]
RMS_WEIGHT = (4, 1.5)
"""Of what is above that, and the most that it takes from the log odds: a model, or a camera's noise, may be other
than they are declared."""
TRACK_MOST = 2  # log odds that images before add to those of one
TRACK_UNCERTAIN = 0.08  # shift of its surface beyond which a pose is uncertain [diameters]
TRACK_LOST = 0.12  # and beyond which a hidden object is lost [diameters]
MIN_TWIN = 0.05
"""Least weight, as a share of the likeliest pose's, of a pose that may be chosen for its rotation near the last."""
SEARCH_PERIOD = 0.2  # between searches of the entire image [s]
MIN_FOUND = 0.6  # share of the expected pixels that a found object must explain
TRACK_LIKELY = 0.5  # probability above which only those count of them that nothing hides
FOUND_AGAIN = 0.85
"""Least probability of the first pose of an object that was lost: it may be gone."""
HIDDEN = "hardly anything of it is seen"


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """The estimate of a tracked object's pose after one depth image."""

    stamp: float  # of the image [s]
    T_camera_object: Array | None  # (4, 4); None: lost
    covariance: Array | None
    """(6, 6) of (δp [m], δθ [rad]) of the object's origin along the camera's axes; None: lost."""
    state: State  # `tracking`; `uncertain`: the pose fits, but others may fit as well; `lost`: no pose fits
    reason: str  # why it is not `tracking`; empty if it is
    candidate: NDArray[np.void]  # CANDIDATE (1,): the pose that was tried, and how well the image supports it


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """The checked arguments of `DepthTracker.update`."""

    stamp: float
    depth: Depth
    hand: Mask | None
    table: Array | None
    T_camera_palm: Array | None
    gripped: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Belief:
    """The state of the tracker at an image's stamp."""

    stamp: float
    pose_camera_object: GaussianPose
    T_camera_palm: Array | None
    independent: Array
    """(6, 6) covariance if the errors of images were independent, by which they are weighed."""
    T_at_rest: Array
    """(4, 4) T_camera_object if it has not moved since the last image, or only with the palm that grips it."""
    observed: float  # stamp of the last image that showed enough of it [s]
    lost: bool
    velocity: Array = field(default_factory=lambda: np.zeros(6))  # (6,) of the object's centre [m/s, rad/s]
    shared: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6) derivative of the pose by errors of unit variance that all images share."""
    changed: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6) part of both covariances that is due to a change of motion since the last image."""
    odds: float = 0.0  # log odds that the pose is right, by all images


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
        self._belief: _Belief | None = None
        self._searched = -np.inf
        self._absent = "not found"

    def restarted(self, stamp: float, T_camera_object: Array) -> "DepthTracker":
        """Returns a tracker that has followed nothing yet, and looks at a pose only in an image of that stamp [s]."""
        other = copy(self)
        other._start = se3.rounded(T_camera_object, "start")
        other._belief = None
        other._searched = stamp
        return other

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
        near which the object is searched. An image a little older than the last one is answered, but does not change
        the state. Raises InvalidInput for images of another size than the camera's and for depth that is not in metres,
        InvalidTransform for matrices that are no poses.
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
        belief, searched = self._belief, self._searched
        sighting = self._observed(_Image(now, depth, hand, table, T_camera_palm, gripped), expected)
        if belief is not None and 0 < belief.stamp - now <= MAX_GAP:
            self._belief, self._searched = belief, searched
        return sighting

    def _observed(self, image: _Image, hint: Array | None) -> Sighting:
        """Returns where the object is near its expected pose, else anywhere in the image, and makes that the belief."""
        predicted = self._predicted(image, hint)
        refined = None
        reason = ""
        if predicted is not None:
            refined = self._refined(image, predicted)
            predicted = self._weighed(predicted, refined)
            reason = self._misfit(predicted, refined)
        if predicted is None or refined is None or reason:
            found = self._found(image)
            if found is None:
                self._belief = predicted and replace(predicted, lost=True)
                candidate = np.zeros(1, dtype=CANDIDATE) if refined is None else refined.candidate
                return Sighting(image.stamp, None, None, "lost", reason or self._absent, candidate)
            predicted, refined = found
        enough = _is_enough(refined)
        self._belief = belief = self._fused(predicted, refined) if enough else predicted
        pose = belief.pose_camera_object
        unsure = surface_shift(self.model, pose)
        refined.candidate["pose"] = candidates_at(pose.T_a_b[None])["pose"]
        reason = "" if enough else HIDDEN
        if enough and unsure > TRACK_UNCERTAIN * self.model.diameter:
            reason = f"its surface may be off by {1000 * unsure:.0f} mm where it is not seen"
        state: State = "uncertain" if reason else "tracking"
        return Sighting(image.stamp, pose.T_a_b, pose.covariance, state, reason, refined.candidate)

    def _predicted(self, image: _Image, hint: Array | None) -> _Belief | None:
        """Returns the belief at the stamp of an image, before it is used; None where nothing is known."""
        last = self._belief
        if last is None:
            hint = self._start if hint is None else hint
            return None if hint is None else self._unknown(image, hint, lost=False)
        dt = max(image.stamp - last.stamp, 0.0)
        pose = last.pose_camera_object
        drift = TRACK_DRIFT
        odds = last.odds
        covariance, independent, shared = pose.covariance, last.independent, last.shared
        velocity = VELOCITY_SHARE * last.velocity * (dt <= MAX_GAP)
        if image.gripped and image.T_camera_palm is not None and last.T_camera_palm is not None:
            T_new_old = image.T_camera_palm @ se3.inverse(last.T_camera_palm)
            T = at_rest = T_new_old @ pose.T_a_b
            drift = DRIFT_IN_PALM
            turn = np.kron(np.eye(2), T_new_old[:3, :3])
            covariance = turn @ covariance @ turn.T
            independent = turn @ independent @ turn.T
            shared = turn @ shared
        else:
            T_camera_center = se3.moved(pose.T_a_b @ self._T_object_center, velocity * dt)
            T = T_camera_center @ se3.inverse(self._T_object_center)
            at_rest = pose.T_a_b
        # An object that is not observed may go on with one velocity: after a time t it is off by t sigma.
        grown = dt * (dt + 2 * max(last.stamp - last.observed, 0.0))
        much = self._covariance_of_origin(T, np.repeat(grown * np.square(drift), 3))
        little = self._covariance_of_origin(T, np.repeat(grown * np.square(DRIFT_IN_PALM), 3))
        changed = np.zeros((6, 6)) if last.lost else much - little
        if hint is not None:
            T = at_rest = hint
            changed = np.zeros((6, 6))
            odds = 0.0
        return replace(
            last,
            stamp=image.stamp,
            pose_camera_object=GaussianPose(T, covariance + much),
            T_camera_palm=image.T_camera_palm,
            independent=independent + much,
            T_at_rest=at_rest,
            velocity=velocity,
            shared=shared,
            changed=changed,
            odds=odds,
        )

    def _refined(self, image: _Image, predicted: _Belief) -> RefinedPose:
        """Returns what an image says near where the object is expected."""
        T = predicted.pose_camera_object.T_a_b
        pose = GaussianPose(T, predicted.independent - predicted.changed)
        known = np.asarray(np.linalg.inv(pose.at_point(self.model.center_object).covariance))
        return self._refiner.at(T, known, image.depth, image.hand, image.table, T_at_rest=predicted.T_at_rest)

    def _weighed(self, predicted: _Belief, refined: RefinedPose) -> _Belief:
        """Returns the belief with the log odds that an image adds to it."""
        candidate = refined.candidate
        noise = self._refiner.noise
        if not (_is_enough(refined) or against(candidate) > MIN_AGAINST):
            return predicted
        z = center_depths(self.model, candidate)
        within_pixel = z / (np.sqrt(12) * self.camera.matrix[0, 0])  # of a surface that is slanted by 45°
        sigma = np.hypot(np.hypot(noise.sigma(z), noise.bias(z)), within_pixel)
        worse = float((candidate["rms"] / sigma)[0]) - MAX_RMS
        slope, most = RMS_WEIGHT
        added = FIT_WEIGHT * (support_share(candidate) - MIN_FIT)
        added -= min(slope * max(worse, 0.0), most)
        return replace(predicted, odds=min(max(predicted.odds, -TRACK_MOST), TRACK_MOST) + added)

    def _misfit(self, predicted: _Belief, refined: RefinedPose) -> str:
        """Returns why the object is lost; empty if it is not."""
        if predicted.odds < 0:
            share = support_share(refined.candidate)
            rms = refined.candidate["rms"][0]
            far = f", {1000 * rms:.1f} mm off" if share > MIN_FIT else ""
            return f"it explains {100 * share:.0f} % of what is seen there{far}"
        limit = TRACK_LOST * self.model.diameter
        pose = predicted.pose_camera_object
        hidden = not _is_enough(refined) and (predicted.lost or surface_shift(self.model, pose) > limit)
        return HIDDEN if hidden else ""

    def _found(self, image: _Image) -> tuple[_Belief, RefinedPose] | None:
        """Returns the object somewhere in the image, if it is time to search and it is there."""
        if abs(image.stamp - self._searched) < SEARCH_PERIOD:
            return None
        self._searched = image.stamp
        noise = self._refiner.noise
        found = self.source(
            self.model, image.depth, self.camera, hand=image.hand, table=image.table, noise=noise
        )
        self._absent = f"not found: {found.reason}" if found.reason else "not found"
        expected = found.candidates["expected"]
        if found.probability > TRACK_LIKELY:
            expected = expected - found.candidates["hidden"]
        fits = found.candidates["explained"] >= MIN_FOUND * expected
        likely = found.weights >= MIN_TWIN * found.weights.max(initial=0.0)
        Ts = found.Ts_camera_object[fits & likely]
        if not len(Ts) or (self._belief is not None and found.probability < FOUND_AGAIN):
            return None
        if self._belief is not None:  # of poses that fit alike, the one turned least from where it was
            last = self._belief.pose_camera_object.T_a_b[:3, :3]
            turns = np.linalg.norm(se3.rotation_log(Ts[:, :3, :3] @ last.T), axis=1)
            Ts = Ts[[turns.argmin()]]
        belief = self._unknown(image, Ts[0], lost=True)
        refined = self._refined(image, belief)
        belief = self._weighed(belief, refined)
        return None if self._misfit(belief, refined) else (belief, refined)

    def _fused(self, predicted: _Belief, refined: RefinedPose) -> _Belief:
        """Returns the belief after an image that shows enough of the object."""
        last, velocity = self._belief, predicted.velocity
        pose, measured = predicted.pose_camera_object, refined.pose_camera_object
        off = se3.difference(measured.T_a_b, pose.T_a_b)
        P = predicted.independent
        R = measured.covariance
        own = pose.covariance - predicted.shared @ predicted.shared.T
        if off @ np.linalg.solve(P - predicted.changed + R, off) < TRACK_UNCHANGED:
            P, own = P - predicted.changed, own - predicted.changed
        gain = self._gain(pose.T_a_b, P, R)
        keep = np.eye(6) - gain
        shared = keep @ predicted.shared + gain @ np.linalg.cholesky(R)
        covariance = keep @ own @ keep.T + shared @ shared.T
        independent = keep @ P @ keep.T + gain @ R @ gain.T
        pose = GaussianPose(se3.moved(pose.T_a_b, gain @ off), (covariance + covariance.T) / 2)
        if last is None or predicted.lost:
            velocity = np.zeros(6)
        elif 0 < predicted.stamp - last.stamp <= MAX_GAP:
            before = last.pose_camera_object.T_a_b @ self._T_object_center
            now = pose.T_a_b @ self._T_object_center
            velocity = se3.difference(now, before) / (predicted.stamp - last.stamp)
        return replace(
            predicted,
            pose_camera_object=pose,
            independent=independent,
            shared=shared,
            velocity=velocity,
            lost=False,
            observed=predicted.stamp,
        )

    def _gain(self, T_camera_object: Array, P: Array, R: Array) -> Array:
        """Returns the gain (6, 6) of a measurement of the object's origin with covariance R, before which it is P.

        Each eigenvector of R (of shifts, and of radius times turns, of the centre) is weighed by itself. A direction
        that no point observes is a little different in each image, and Kalman's gain takes two of them for an
        observation: the object would turn with the noise.
        """
        D, radius = self.model.diameter, self.model.radius
        S = se3.point_jacobian(T_camera_object[:3, :3] @ self.model.center_object)
        S = S * np.repeat([1.0, radius], 3)[:, None]
        variances, V = np.linalg.eigh(S @ R @ S.T)
        # R has what is known without any point, which the image does not say once more.
        unknown = np.repeat(np.square(UNKNOWN) * D**2, 3) ** -1.0 @ V**2
        variances = 1 / np.maximum(1 / variances - unknown, 1e-3 * unknown)
        before = np.einsum("ji,jk,ki->i", V, S @ P @ S.T, V)
        return np.asarray(np.linalg.solve(S, V * (before / (before + variances))) @ V.T @ S)

    def _unknown(self, image: _Image, T_camera_object: Array, *, lost: bool) -> _Belief:
        """Returns the belief that the object is about there, and as good as unknown."""
        D = self.model.diameter
        variance = np.repeat([(UNKNOWN[0] * D) ** 2, (UNKNOWN[1] * D / self.model.radius) ** 2], 3)
        C = self._covariance_of_origin(T_camera_object, variance)
        pose = GaussianPose(T_camera_object, C)
        return _Belief(image.stamp, pose, image.T_camera_palm, C, T_camera_object, image.stamp, lost)

    def _covariance_of_origin(self, T_camera_object: Array, variance: Array) -> Array:
        """Returns the covariance (6, 6) of the object's origin that a variance (6,) of its centre makes."""
        J = se3.point_jacobian(-T_camera_object[:3, :3] @ self.model.center_object)
        return (J * variance) @ J.T


def _is_enough(refined: RefinedPose) -> bool:
    """Returns whether an image shows enough of the object to say something of its pose."""
    explained = refined.candidate["explained"][0]
    return bool(refined.points >= MIN_POINTS and explained >= MIN_PIXELS)


def surface_shift(model: ObjectModel, pose: GaussianPose) -> float:
    """Returns the most that one sigma along any of the three least known directions moves the object's surface [m]. A
    turn that the object looks the same after does not move it."""
    return depth_covariance.largest_shift(*model.record[:2], pose.T_a_b, pose.covariance)
