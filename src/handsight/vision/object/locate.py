"""Where an object is in one depth image, and which of several objects it shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.observation import Detection2D
from handsight.vision.candidates import NOTHING_KNOWN, Candidates, candidates_at, surface_distances
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection, first_pose, log_odds, logit
from handsight.vision.object.pose_refiner import PoseRefiner
from handsight.vision.object.region import Scene, scene_of

Box = Sequence[float] | Array  # u0, v0, u1, v1: the first column and row, and the last, all included [pixels]
Start = GaussianPose | Sequence[GaussianPose] | ArrayLike
"""Poses of the object in the camera: (4, 4), (k, 4, 4), or with their covariances."""


MAX_PLANE = 1.5  # a plane wider than this is no part of the object [diameters]
MIN_PROBABILITY = 0.5
"""Least probability of the best pose at which the object counts as found."""
LOCATE_MEANINGLESS = 0.1
"""Probability that the score of a detector says nothing; `score_log_odds` derives what follows from it."""
LOCATE_UNSCORED = 0.7  # score that a box or mask around one object counts as, if it has none
AROUND_ONE = 2.0  # such a region's largest area [areas of a square as wide as the object]
MAX_STARTS = 100
LOCATE_COMPARED = 4000  # pixels of an image by which objects are compared that would explain the same ones
LOCATE_SUPPORT = (20, 0.033)
"""Pixels by which logarithms of two objects' weights differ by 1, and what is added per pixel that any explains."""
MAX_DETECTIONS = 8  # detections of an object in an image that are searched, those with the highest scores


def locate(
    model: ObjectModel,
    depth: Depth,
    camera: Camera,
    *,
    box: Box | None = None,
    mask: Mask | None = None,
    start: Start | None = None,
    score: float | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns the poses that the object may have in a depth image (h, w) [m], 0 or NaN where there is no depth; none,
    with the reason, if the object is not in it.

    box, mask, start and score are what another detector says of the object. box (u0, v0, u1, v1): the first and the
    last column and row that it may be in, rounded outwards; what lies outside the image is cut off. mask (h, w): pixels
    that it may be in, not 0. None: all pixels. start: T_camera_object (4, 4) of another estimator, or several (k, 4,
    4), or GaussianPoses, whose covariances hold directions of which the image says nothing. Each is refined, and judged
    like those that are found without it. score: the detector's confidence in (0, 1], by which the probability changes
    (`score_log_odds`); .7 for a box or mask without one that is around a single object (`region_log_odds`).

    hand (h, w): pixels of the hand. table (4,): `n·P + offset = 0` in the camera, n towards it; None: the widest plane.
    noise: of the depth. Raises InvalidInput for images of another size than the camera's, for depth that is not in
    metres, and for a box that is outside the image; InvalidTransform for a start that is no pose.
    """
    wanted = search_mask(camera, box, mask)
    prior = region_log_odds(model, camera, depth, wanted) if score is None else score_log_odds(score)
    given = [] if start is None else _checked_starts(start)
    extent = MAX_PLANE * model.diameter
    scene = scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)
    found = ObjectDetection.nowhere(scene.reason)
    if len(scene.sizes):
        refined = _refined(model, scene, given, noise) if given else None
        found = first_pose(model, scene, noise=noise, given=refined, prior=prior)
        if found.probability >= MIN_PROBABILITY:
            return found
    reason = found.reason or "no surface there is large enough to tell its shape"
    if len(found.candidates):
        reason = doubt(model.name or "the object", found.probability)
    return ObjectDetection.nowhere(reason + _too_near(model, scene), found.probability)


def doubt(name: str, probability: float) -> str:
    """Returns why an object counts as not found, by the probability of its likeliest pose."""
    return f"the likeliest pose of {name} is right with a probability of {probability:.2f} only"


def _too_near(model: ObjectModel, scene: Scene) -> str:
    """Returns what a reason ends with where the object would be wider than the image: nothing is searched for it."""
    known = scene.depth[scene.depth > 0]
    z = float(np.median(known)) if len(known) else np.inf
    width = model.diameter * scene.camera.matrix[0, 0] / z
    if width < min(scene.camera.size):
        return ""
    return f"; at {z:.3g} m it would be wider than the image: depth in another unit (--depth-scale)?"


class FirstPoseSource(Protocol):
    """A function that finds an object in a depth image, without a guess; `locate` is one.

    Another one usually asks a detector or an estimator, and passes what it answers to `locate` as box, mask, score or
    start, with the keywords that it was called with.
    """

    def __call__(
        self,
        model: ObjectModel,
        depth: Depth,
        camera: Camera,
        /,
        *,
        hand: Mask | None = None,
        table: Array | None = None,
        noise: DepthNoise = STRUCTURED_LIGHT,
    ) -> ObjectDetection:
        """Returns the poses that the object may have, the likeliest first; none, with the reason, if it is not there.

        depth (h, w) [m], 0 or NaN where there is none; hand (h, w): pixels of the hand; table (4,): `n·P + offset = 0`
        in the camera; noise: of the depth.
        """


def locate_detected(
    model: ObjectModel,
    depth: Depth,
    camera: Camera,
    *,
    detections: Sequence[Detection2D],
    elsewhere: FirstPoseSource | None = None,
    mask: Mask | None = None,
    start: Start | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns the likeliest answer of `locate` of those in the boxes and masks in which the object was detected.

    Detections that cannot be of the camera's images are left out. elsewhere: finds the object where none of them is
    right. Other arguments and errors are as `locate`'s; with `functools.partial` it is a `FirstPoseSource`.
    """
    located = partial(locate, model, depth, camera, start=start, hand=hand, table=table, noise=noise)
    found = list[ObjectDetection]()
    for each in sorted(detections, key=lambda each: -(each.score or 1.0))[:MAX_DETECTIONS]:
        try:
            inside = search_mask(camera, each.box, each.mask)
        except InvalidInput:
            continue
        if mask is not None:
            inside = mask if inside is None else inside & np.asarray(mask, dtype=bool)
        found.append(located(mask=inside, score=each.score))
    best = max(found, key=lambda each: each.probability, default=None)
    if elsewhere is not None and (best is None or best.reason is not None):
        return elsewhere(model, depth, camera, hand=hand, table=table, noise=noise)
    return best or ObjectDetection.nowhere(f"{model.name or 'the object'} was not detected in the image")


@dataclass(frozen=True, eq=False)
class Recognition:
    """Which object a depth image shows, and where."""

    scores: dict[str, float]  # probability of each name, the likeliest first
    none: float  # probability that it is none of them; with the scores it sums to 1
    found: dict[str, ObjectDetection]  # where each would be, in the same order
    reason: str | None = None  # why it is none

    @property
    def name(self) -> str | None:
        """The likeliest; None: none of them."""
        best = next(iter(self.scores), None)
        return best if best is not None and self.scores[best] > self.none else None


def recognise(
    models: Mapping[str, ObjectModel],
    depth: Depth,
    camera: Camera,
    *,
    found: Mapping[str, ObjectDetection] | None = None,
    box: Box | None = None,
    mask: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> Recognition:
    """Returns which of the models (by name) a depth image shows in a box or a mask; arguments are as `locate`'s.

    Each is searched in the same segments of the image. found: what `locate` answers of each in the boxes of a detector
    or from the poses of an estimator, in place of a search. Raises InvalidInput as `locate` does, and for no models.
    """
    scene = scene_of_any(models, depth, camera, box=box, mask=mask, hand=hand, table=table)
    found = found or {name: first_pose(model, scene, noise=noise) for name, model in models.items()}
    # Poses are compared by their log odds, added to their object's, and by the same pixels of the scene, because odds
    # are of shares of each object's own. None of them is there as probably as the likeliest is not.
    detected = [name for name, one in found.items() if len(one.candidates)]
    inside = scene.labels >= 0
    step = max(1, round(np.sqrt(inside.sum() / LOCATE_COMPARED)))
    few = inside[::step, ::step]
    points = scene.camera.points(scene.depth)[::step, ::step][few].astype(np.float64)
    pixels = list[Array]()
    explained = np.zeros(len(points))
    for name in detected:
        modes = found[name].candidates
        bound = modes["bound"][:, None]
        distances = surface_distances(models[name], points, bound.max(), modes)
        each = np.maximum(1 - (distances / bound) ** 2, 0)
        pixels.append(step**2 * each.sum(axis=1))
        explained = np.maximum(explained, each.max(axis=0))
    size = LOCATE_SUPPORT[0] + LOCATE_SUPPORT[1] * step**2 * explained.sum()
    support = logit([found[name].probability for name in detected])
    for k, name in enumerate(detected):
        support[k] += (log_odds(found[name].candidates) + pixels[k] / size).max()
    weights = np.exp(support - support.max(initial=-np.inf))
    some = found[detected[int(weights.argmax())]].probability if detected else 0.0
    shares = some * weights / max(weights.sum(), 1.0)
    scores = dict.fromkeys(found, 0.0) | dict(zip(detected, shares.tolist(), strict=True))
    scores = dict(sorted(scores.items(), key=lambda item: -item[1]))
    likeliest = next(iter(scores))
    reason = None
    if 1 - some >= scores[likeliest]:
        best = f"{likeliest} is the likeliest, with a probability of {scores[likeliest]:.2f}"
        reason = f"nothing there looks like one of them; {best}" if len(scene.sizes) else scene.reason
    return Recognition(scores, 1 - some, {name: found[name] for name in scores}, reason)


def scene_of_any(
    models: Mapping[str, ObjectModel],
    depth: Depth,
    camera: Camera,
    *,
    box: Box | None,
    mask: Mask | None,
    hand: Mask | None,
    table: Array | None,
) -> Scene:
    """Returns the segments of an image in which several objects are looked for; raises InvalidInput, also for no
    models."""
    if not models:
        raise InvalidInput("models: expected at least one, got none")
    extent = MAX_PLANE * max(model.diameter for model in models.values())
    wanted = search_mask(camera, box, mask)
    return scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)


def search_mask(camera: Camera, box: Box | None, mask: Mask | None) -> Mask | None:
    """Returns the pixels (h, w) of an image that are in a box and in a mask; None: all. Raises InvalidInput."""
    if mask is not None:
        try:
            pixels = np.asarray(mask)
        except ValueError:
            raise InvalidInput("mask: expected an image (h, w), got rows of several lengths") from None
        camera.check_size(pixels, "mask")
        if pixels.dtype.kind not in "biuf":
            raise InvalidInput(f"mask: expected booleans or numbers, got {pixels.dtype}")
        mask = np.nan_to_num(pixels) != 0
    if box is None:
        return mask
    corners = checks.finite(box, "box", (4,))
    first, last = corners.reshape(2, 2)
    if (last < first).any():
        expected = "expected u0,v0,u1,v1 with u0 <= u1 and v0 <= v1"
        raise InvalidInput(f"box: {expected}, got {checks.brief(corners)} (u0, v0, width, height?)")
    width, height = camera.size
    if (first > np.subtract(camera.size, 1)).any() or (last < 0).any():
        expected = f"expected u0,v0,u1,v1 that meets the image, 0,0 to {width - 1},{height - 1}"
        raise InvalidInput(f"box: {expected}, got {checks.brief(corners)}")
    left, top = np.floor(first).clip(0).astype(int)
    right, bottom = np.ceil(last).clip(None, 1e9).astype(int)
    inside = np.zeros((height, width), dtype=bool)
    inside[top : bottom + 1, left : right + 1] = True
    return inside if mask is None else inside & mask


def score_log_odds(score: float) -> float:
    """Returns the log odds that an object is there, by the score in (0, 1] of a detector that reported it.

    The score is taken as the probability that the detection is right, but may be meaningless with a probability m
    (`LOCATE_MEANINGLESS`): the networks that give it are overconfident, and some give similarities. The
    probability is then m/2 + (1 - m)·score, whose log odds are 0 for a score of ½ and within ± log(2/m - 1), about 3.
    They are added to those of the depth image (Bayes' rule), which are for even odds. Raises InvalidInput.
    """
    value = checks.positive(score, "score")
    if value > 1:
        raise InvalidInput(f"score: expected a number above 0 and at most 1, got {value:g}")
    return float(logit(LOCATE_MEANINGLESS / 2 + (1 - LOCATE_MEANINGLESS) * value))


def region_log_odds(model: ObjectModel, camera: Camera, depth: Depth, wanted: Mask | None) -> float:
    """Returns the log odds that an object is there because somebody looks for it in some pixels (h, w); None: in all.

    They are those of a detector's score of `LOCATE_UNSCORED` if the pixels are about as many as the object's,
    because then somebody saw it there, and 0 for a wider region.
    """
    if wanted is None or wanted.shape != depth.shape:
        return 0.0
    inside = depth[wanted > 0]
    known = inside[inside > 0]
    if not len(known):
        return 0.0
    side = model.diameter * camera.matrix[0, 0] / float(np.median(known))
    return score_log_odds(LOCATE_UNSCORED) if inside.size <= AROUND_ONE * side**2 else 0.0


def _checked_starts(start: Start) -> list[GaussianPose]:
    """Returns the poses that were given, with a covariance of infinity where none was; raises InvalidInput."""
    given = [start] if isinstance(start, GaussianPose) else start
    poses = list[GaussianPose]()
    if isinstance(given, Sequence) and any(isinstance(each, GaussianPose) for each in given):
        for k, each in enumerate(given):
            place = f"start[{k}]"
            if not isinstance(each, GaussianPose):
                came = type(each).__name__
                raise InvalidInput(f"{place}: expected a GaussianPose as the others are, got {came}")
            poses.append(GaussianPose.checked(each.T_a_b, each.covariance, place))
    else:
        alone = checks.ndim(given) != 3
        Ts = checks.finite(cast(ArrayLike, given), "start", (4, 4) if alone else (None, 4, 4))
        unknown = np.full((6, 6), np.inf)
        for k, T in enumerate(Ts.reshape(-1, 4, 4)):
            poses.append(GaussianPose(se3.rounded(T, "start" if alone else f"start[{k}]"), unknown))
    if not 0 < len(poses) <= MAX_STARTS:
        raise InvalidInput(f"start: expected 1 to {MAX_STARTS} poses, got {len(poses)}")
    return poses


def _refined(model: ObjectModel, scene: Scene, given: list[GaussianPose], noise: DepthNoise) -> Candidates:
    """Returns CANDIDATE (2k,): the given poses, then these moved to the points near them that are no table's or hand's.
    Both, because a neighbour's points may draw a pose away from where it was right."""
    refiner = PoseRefiner(model, scene.camera, noise)
    Ts = list[Array]()
    for pose in given:
        known = NOTHING_KNOWN
        if np.isfinite(pose.covariance).all():
            known = np.asarray(np.linalg.pinv(pose.at_point(model.center_object).covariance, hermitian=True))
        Ts.append(refiner.at(pose.T_a_b, known, scene.depth, scene.labels < 0, None).pose_camera_object.T_a_b)
    return candidates_at(np.array([pose.T_a_b for pose in given] + Ts))
