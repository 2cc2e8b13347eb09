"""The pose of the palm in the camera, from the hand in its depth image and not from the camera's calibration.

The hand is turned and shifted in steps around its predicted pose, within its uncertainty. The best poses are
moved to where the hand's points lie on the image (point to plane), and scored by the image as a whole: by pixels that
the hand explains, that the camera sees past, that are hidden, and by whether the surface goes on beside the hand. A
hand that was found in the last image is only aligned.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._deprecated import renamed_members
from handsight._kernels.image import depth_covariance, hand_term
from handsight._kernels.image.vision_records import STAGE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.gaussian_pose import GaussianPose
from handsight.vision.candidates import Candidates, candidates_at, depth_errors, poses_of
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.palm.hand_appearance import PlacedHand
from handsight.vision.palm.palm_search import Belief, Picture, distinct, picture_of, searched


class AlignStage(NamedTuple):
    """An `AlignStage` moves candidates to where points of the hand lie on the image, and scores them by these."""

    first_bound: float  # Tukey's, of the first step [m]
    last_bound: float  # and of the last [m]
    steps: int
    explained: float  # depth within this is explained [m]
    points: int | None = None  # of the hand; None: all
    kept: int = 0  # candidates that go on
    spacing: float = 0.0  # between these [m]


class DetectorOptions(NamedTuple):
    """`DetectorOptions` say when a palm is detected."""

    max_sigmas: float = 4.0  # of the belief, beyond which no answer is taken
    search_factor: float = 2.5  # times that, beyond which no candidate goes on
    min_fit_followed: float = 0.65
    """Of a hand that is followed: the least share explained of what is neither hidden nor out of the image."""
    max_passed: float = 0.15  # and the largest share that the camera sees past
    near_best: float = 0.6  # share of the best score from which candidates are compared with all points
    min_score: float = 2.0  # of an answer
    min_pixels: float = 400.0  # that the hand explains
    min_fit: float = 0.25  # and their share of those that it should fill
    continued_weight: float = 0.3
    """Cost of a surface that continues beside the hand's entire outline, as a share of the pixels that the hand should
    fill."""
    max_continued: float = 0.55  # share of the outline above which the hand was found in a table or a wall
    candidate_spacing: float = 0.025  # poses farther than this from each other are different [m]
    as_good: float = 0.85  # another pose with so much of the best score makes the answer ambiguous
    # A wide bound lets an object in the hand pull the hand away.
    stages: tuple[AlignStage, ...] = (
        AlignStage(0.02, 0.010, 7, 0.015, points=300, kept=12, spacing=0.010),
        AlignStage(0.012, 0.008, 6, 0.010, points=500, kept=5, spacing=0.008),
    )
    last_stage: AlignStage = AlignStage(0.015, 0.006, 8, 0.010)
    followed_stage: AlignStage = AlignStage(0.02, 0.006, 10, 0.010)
    followed_sigmas: tuple[float, float] = (0.010, float(np.deg2rad(3.0)))
    """Sigmas of the predicted pose of a hand that is followed [m, rad]."""


DETECTOR = DetectorOptions()

Reason = Literal["outside", "hardly_seen", "no_fit", "ambiguous"]


@dataclass(frozen=True, slots=True, eq=False)
class PalmNotFound:
    """A `PalmNotFound` says why an image gives no pose of the palm; it is falsy."""

    reason: Reason
    """outside: out of the image, at any pose within the uncertainty; hardly_seen: too few pixels are the hand's, most
    of it is hidden or far; no_fit: the image does not show such a hand there; ambiguous: another pose fits as well."""

    def __bool__(self) -> bool:
        return False


@renamed_members(look="candidate")
@dataclass(frozen=True, slots=True, eq=False)
class PalmDetection:
    """A `PalmDetection` is the pose of the palm in one depth image."""

    T_camera_palm: Array  # (4, 4)
    covariance: Array  # (6, 6) of (δp [m], δθ [rad]) along the camera's axes
    fit: float
    """Of the pixels that the hand should fill, the share that it explains; hidden ones are not explained."""
    candidate: NDArray[np.void]  # (1,) CANDIDATE: what the image says of it, in pixels


def detect_palm(
    camera: Camera,
    depth: Depth,
    hand: PlacedHand,
    T_camera_palm: Array,
    *,
    sigma_position: float,
    sigma_rotation: float,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> PalmDetection | PalmNotFound:
    """Returns the palm's pose in a depth image (h, w) [m], 0 or NaN where there is none, or why the image gives none.

    T_camera_palm: as predicted, with sigmas `sigma_position` [m] of the hand's middle and `sigma_rotation` [rad] per
    axis; the time of the search grows with these. `noise`: of the depth, for the covariance. Raises InvalidInput.
    """
    T = se3.check(T_camera_palm, "T_camera_palm")
    camera.check_size(depth, "depth")
    sigma = checks.positive(sigma_position, "sigma_position")
    belief = Belief(hand, T, (sigma, checks.positive(sigma_rotation, "sigma_rotation")))
    picture = picture_of(camera, depth, hand, T, sigma)
    if picture is None:
        return PalmNotFound("outside")
    visible = hand.visible_from(camera, T)
    candidates, rows = searched(picture, belief, visible), np.flatnonzero(visible)
    if not len(candidates):
        return PalmNotFound("outside")
    for stage in DETECTOR.stages:
        _align(picture, rows, stage, candidates)
        candidates = _believed(belief, candidates, DETECTOR.search_factor * DETECTOR.max_sigmas)
        candidates = distinct(hand, candidates, stage.spacing, stage.kept)
    candidates = candidates[candidates["score"] > DETECTOR.near_best * candidates["score"].max(initial=0.0)]
    finished = [_finished(picture, candidates[[k]], DETECTOR.last_stage) for k in range(len(candidates))]
    candidates = np.concatenate([candidates[:0], *finished])
    return _answer(picture, _believed(belief, candidates, DETECTOR.max_sigmas), noise)


def follow_palm(
    camera: Camera,
    depth: Depth,
    hand: PlacedHand,
    T_camera_palm: Array,
    *,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> PalmDetection | PalmNotFound:
    """Returns the palm's pose as `detect_palm` does, near that in the last image; it takes a few ms, as nothing is
    searched.

    T_camera_palm: off by about 10 mm and 3° per axis. The answer is `no_fit` where too little of the hand is there.
    """
    T, sigmas = se3.check(T_camera_palm, "T_camera_palm"), DETECTOR.followed_sigmas
    camera.check_size(depth, "depth")
    picture = picture_of(camera, depth, hand, T, sigmas[0])
    if picture is None:
        return PalmNotFound("outside")
    candidate = _finished(picture, candidates_at(T[None]), DETECTOR.followed_stage)
    candidate = _believed(Belief(hand, T, sigmas), candidate, DETECTOR.max_sigmas)
    if len(candidate):
        free = candidate["explained"] + candidate["passed"] + candidate["unexplained"]
        fits = candidate["explained"] > DETECTOR.min_fit_followed * free
        if not (fits & (candidate["passed"] < DETECTOR.max_passed * free)).all():
            return PalmNotFound("no_fit")
    return _answer(picture, candidate, noise)


def _align(picture: Picture, rows: Indices, stage: AlignStage, candidates: Candidates) -> None:
    """Moves candidates to where the first of the visible points `rows` lie on the image, and scores them by these."""
    few, hand = rows[: stage.points], picture.hand
    skin, camera = np.ascontiguousarray(hand.skin[:, few]), picture.camera.record
    stages = np.array([(0, stage.first_bound, stage.last_bound, stage.steps, 1)], dtype=STAGE)
    hand_term.refine_hand(camera, picture.arrays, skin, hand.middle, hand.radius, stages, candidates)
    area = hand.appearance.point_area * len(rows) / max(len(few), 1)
    hand_term.score_hand(camera, picture.arrays, skin, area, stage.explained, candidates)


def _finished(picture: Picture, candidate: Candidates, stage: AlignStage) -> Candidates:
    """Returns CANDIDATE (1,) aligned by all visible points; a surface that goes on beside the hand lowers its score."""
    rows = np.flatnonzero(picture.hand.visible_from(picture.camera, poses_of(candidate)[0]))
    candidate, score = candidate.copy(), hand_term.HAND_SCORE
    _align(picture, rows, stage, candidate)
    expected = candidate["expected"]
    continued = picture.hand.outline_continued(picture.camera, picture.depth, poses_of(candidate)[0])
    size = np.maximum(expected, score.min_expected) ** score.size_exponent
    candidate["score"] -= DETECTOR.continued_weight * continued * expected / size
    return candidate


def _believed(belief: Belief, candidates: Candidates, sigmas: float) -> Candidates:
    """Returns the candidates, the best first, that are at most so many sigmas off the belief."""
    Ts = poses_of(candidates)
    middles = se3.apply(Ts, belief.hand.middle[None])[:, 0]
    off, turned = (np.linalg.norm(d, axis=1) for d in belief.differences(middles, Ts[:, :3, :3]))
    candidates = candidates[(off < sigmas * belief.sigmas[0]) & (turned < sigmas * belief.sigmas[1])]
    return candidates[np.argsort(-candidates["score"], kind="stable")]


def _answer(picture: Picture, candidates: Candidates, noise: DepthNoise) -> PalmDetection | PalmNotFound:
    """Returns the best candidate, where it is good enough and no other is nearly as good."""
    if not len(candidates) or not candidates["score"][0] > DETECTOR.min_score:
        return PalmNotFound("no_fit")
    best, fits = candidates[:1].copy(), candidates["explained"] / np.maximum(candidates["expected"], 1.0)
    if best["explained"][0] < DETECTOR.min_pixels or fits[0] < DETECTOR.min_fit:
        return PalmNotFound("hardly_seen")
    others = distinct(picture.hand, candidates, DETECTOR.candidate_spacing, 2)[1:]
    if len(others) and others["score"][0] > DETECTOR.as_good * best["score"][0]:
        return PalmNotFound("ambiguous")
    T = poses_of(best)[0]
    if picture.hand.outline_continued(picture.camera, picture.depth, T) > DETECTOR.max_continued:
        return PalmNotFound("no_fit")
    rows = np.flatnonzero(picture.hand.visible_from(picture.camera, T))
    covariance = _covariance(picture, best, rows, DETECTOR.last_stage.last_bound, noise)
    return PalmDetection(T, covariance, float(fits[0]), best)


def _covariance(
    picture: Picture, candidate: Candidates, rows: Indices, bound: float, noise: DepthNoise
) -> Array:
    """Returns (6, 6) of CANDIDATE (1,) by (δp, δθ) of the palm along the camera's axes.

    rows (k,): the visible points; bound: Tukey's [m]. The errors of points are those of `noise`. Those of whole pixels
    are added, and those of constant errors of the joints, to first order: a weighted fit follows a joint that is off.
    """
    T, hand, camera, compared = poses_of(candidate)[0], picture.hand, picture.camera, 150
    skin, fitted = np.ascontiguousarray(hand.skin[:, rows]), np.empty((len(rows), 8))
    hand_term.rows_of(camera.record, picture.arrays, skin, candidate["pose"].copy(), bound, fitted)
    used = fitted[:, 0] > 0
    weights, normals = fitted[used, 0], np.ascontiguousarray(fitted[used, 2:5])
    points, center = se3.apply(T, skin[0, used]), se3.apply(T, hand.middle[None])[0]
    z = np.maximum(center[2:], 1e-3)
    # Along a direction that no point observes: half the hand's size, and 1.8 rad.
    errors = depth_errors(camera, noise, z, (hand.radius, 1.8 * hand.radius))
    informed, covariance = np.empty((2, 6, 6)), np.empty((6, 6))
    depth_covariance.inform_points(weights, points, normals, center, hand.radius, errors, compared, informed)
    depth_covariance.covariance_of(informed, errors, covariance)
    if hand.sigma_joint > 0:
        lines = np.hstack([normals, np.cross(points - center, normals) / hand.radius])
        by_joints = np.einsum("mi,ij,mjk->mk", normals, T[:3, :3], hand.by_joints(rows[used]))
        information = informed[0] + (weights.sum() + 1e-9) * 1e-9 * np.eye(6)
        follows = np.linalg.solve(information, np.einsum("m,mi,mk->ik", weights, lines, by_joints))
        covariance = covariance + hand.sigma_joint**2 * follows @ follows.T
    scale = np.repeat([1.0, hand.radius], 3)
    covariance = GaussianPose(T, covariance / np.outer(scale, scale)).at_point(-hand.middle).covariance
    return np.asarray((covariance + covariance.T) / 2)
