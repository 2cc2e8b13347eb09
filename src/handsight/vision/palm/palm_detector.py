"""The pose of the palm in the camera, from the hand in its depth image and not from the camera's calibration.

The hand is turned and shifted in steps around its predicted pose, within its uncertainty. The best poses are
moved to where the hand's points lie on the image (point to plane), and scored by the image as a whole: by pixels that
the hand explains, that the camera sees past, that are hidden, and by whether the surface goes on beside the hand. A
hand that was found in the last image is only aligned.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.gaussian_pose import GaussianPose
from handsight.vision.candidates import Candidates, candidates_at, depth_errors, poses_of
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.kernels import depth_covariance, hand_term, palm_scan
from handsight.vision.kernels.hand_term import HAND_SCORE
from handsight.vision.kernels.vision_records import STAGE
from handsight.vision.palm.hand_appearance import PlacedHand

SEARCH_CELL = 0.005  # side of the cells in which the image is sampled, at the hand [m]
MAX_CELLS = 160  # to a side
SEARCH_SHIFT = 0.025  # between poses that are tried, across the direction to the camera [m]
SEARCH_LAYER = 0.10  # and along it [m]
SEARCH_ROTATION = float(np.deg2rad(12))  # and between their rotations [rad]
MAX_SIGMAS = 2.6  # of the predicted pose, within which poses are tried
PRIOR_WEIGHT = 0.01
"""What a squared sigma off the predicted pose takes from a pose's score, the share of points that agree."""
SEARCH_BIN = 0.010  # of distances that are told apart [m]
SEARCH_SCANNED = 80  # points of the hand that are compared with the image
SEARCH_BEST = 300  # of all poses that are tried, those of which the distinct ones are taken
SEARCH_REFINED = 48  # distinct poses whose neighbours are tried
BEST_AROUND = 30  # of the neighbours of each
SEARCH_KEPT = 40  # distinct poses that go on
SEARCH_COMPARED = 8  # points of the hand by which poses are told apart


class AlignStage(NamedTuple):
    """Moves candidates to where points of the hand lie on the image, and scores them by these."""

    first_bound: float  # Tukey's, of the first step [m]
    last_bound: float  # and of the last [m]
    steps: int
    explained: float  # depth within this is explained [m]
    points: int | None = None  # of the hand; None: all
    kept: int = 0  # candidates that go on
    spacing: float = 0.0  # between these [m]


DETECTOR_MAX_SIGMAS = 4.0  # of the predicted pose, beyond which no answer is taken
SEARCH_FACTOR = 2.5  # times that, beyond which no candidate goes on
MIN_FIT_FOLLOWED = 0.65
"""Of a hand that is followed: the least share explained of what is neither hidden nor out of the image."""
MAX_PASSED = 0.15  # and the largest share that the camera sees past
NEAR_BEST = 0.6  # share of the best score from which candidates are compared with all points
MIN_SCORE = 2.0  # of an answer
MIN_PIXELS = 400.0  # that the hand explains
MIN_FIT = 0.25  # and their share of those that it should fill
CONTINUED_WEIGHT = 0.3
"""Cost of a surface that continues beside the hand's entire outline, by the pixels that the hand should fill."""
MAX_CONTINUED = 0.55  # share of the outline above which the hand was found in a table or a wall
CANDIDATE_SPACING = 0.025  # poses farther than this from each other are different [m]
AS_GOOD = 0.85  # another pose with so much of the best score makes the answer ambiguous
# A wide bound lets an object in the hand pull the hand away.
DETECTOR_STAGES = (
    AlignStage(0.02, 0.010, 7, 0.015, points=300, kept=12, spacing=0.010),
    AlignStage(0.012, 0.008, 6, 0.010, points=500, kept=5, spacing=0.008),
)
LAST_STAGE = AlignStage(0.015, 0.006, 8, 0.010)
FOLLOWED_STAGE = AlignStage(0.02, 0.006, 10, 0.010)
FOLLOWED_SIGMAS = (0.010, float(np.deg2rad(3.0)))
"""Sigmas of the predicted pose of a hand that is followed [m, rad]."""

COMPARED = 150  # points whose errors are compared with each other's for the covariance

Reason = Literal["outside", "hardly_seen", "no_fit", "ambiguous"]


@dataclass(frozen=True, slots=True, eq=False)
class PalmNotFound:
    """Why an image gives no pose of the palm; it is falsy."""

    reason: Reason
    """outside: out of the image, at any pose within the uncertainty; hardly_seen: too few pixels are the hand's, most
    of it is hidden or far; no_fit: the image does not show such a hand there; ambiguous: another pose fits as well."""

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True, slots=True, eq=False)
class PalmDetection:
    """The pose of the palm in one depth image."""

    T_camera_palm: Array  # (4, 4)
    covariance: Array  # (6, 6) of (δp [m], δθ [rad]) along the camera's axes
    fit: float
    """Of the pixels that the hand should fill, the share that it explains; hidden ones are not explained."""


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
    checks.positive(sigma_position, "sigma_position")
    checks.positive(sigma_rotation, "sigma_rotation")
    picture = picture_of(camera, depth, hand, T_camera_palm, (sigma_position, sigma_rotation))
    if picture is None:
        return PalmNotFound("outside")
    rows = np.flatnonzero(hand.visible_from(camera, picture.T))
    candidates = searched(picture, rows)
    if not len(candidates):
        return PalmNotFound("outside")
    for stage in DETECTOR_STAGES:
        _align(picture, rows, stage, candidates)
        candidates = _believed(picture, candidates, SEARCH_FACTOR * DETECTOR_MAX_SIGMAS)
        candidates = distinct(hand, candidates, stage.spacing, stage.kept)
    candidates = candidates[candidates["score"] > NEAR_BEST * candidates["score"].max(initial=0.0)]
    finished = [_finished(picture, candidates[[k]], LAST_STAGE) for k in range(len(candidates))]
    candidates = np.concatenate([candidates[:0], *finished])
    return _answer(picture, _believed(picture, candidates, DETECTOR_MAX_SIGMAS), noise)


def follow_palm(
    camera: Camera,
    depth: Depth,
    hand: PlacedHand,
    T_camera_palm: Array,
    *,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> PalmDetection | PalmNotFound:
    """Returns the palm's pose as `detect_palm` does, near that in the last image, without a search: in a few ms.

    T_camera_palm: off by about 10 mm and 3° per axis. The answer is `no_fit` where too little of the hand is there.
    """
    picture = picture_of(camera, depth, hand, T_camera_palm, FOLLOWED_SIGMAS)
    if picture is None:
        return PalmNotFound("outside")
    candidate = _finished(picture, candidates_at(picture.T[None]), FOLLOWED_STAGE)
    candidate = _believed(picture, candidate, DETECTOR_MAX_SIGMAS)
    free = candidate["explained"] + candidate["passed"] + candidate["unexplained"]
    fits = (candidate["explained"] > MIN_FIT_FOLLOWED * free) & (candidate["passed"] < MAX_PASSED * free)
    if not fits.all():
        return PalmNotFound("no_fit")
    return _answer(picture, candidate, noise)


@dataclass(frozen=True, slots=True)
class Picture:
    """A depth image in which a hand may be, as the kernels take it, sampled in cells around there."""

    hand: PlacedHand
    T: Array  # (4, 4) camera from palm, as predicted
    sigmas: tuple[float, float]  # of the hand's middle and of a turn, per axis [m, rad]
    camera: Camera
    depth: Depth
    cells: NDArray[np.float32]  # (m, m, 4) as `palm_scan.cells_of` fills them in
    corner: Array  # (3,) ray of the first cell, and step from cell to cell

    @property
    def arrays(self) -> tuple[Depth, NDArray[np.float32], NDArray[np.float32], Array]:
        """Depth, rays, cells and corner."""
        return self.depth, self.camera.rays, self.cells, self.corner

    def sigmas_off(self, middles: Array, rotations: Array) -> tuple[Array, Array]:
        """Returns how far middles (..., 3) and rotations (..., 3, 3) of the hand are off the prediction [sigmas]."""
        shift = middles - self.hand.middle_at(self.T)
        turn = se3.rotation_log(rotations @ self.T[:3, :3].T)
        shifts, turns = (np.linalg.norm(off, axis=-1) for off in (shift, turn))
        return shifts / self.sigmas[0], turns / self.sigmas[1]


def picture_of(
    camera: Camera, depth: Depth, hand: PlacedHand, T: Array, sigmas: tuple[float, float]
) -> Picture | None:
    """Returns the image; None where a hand at T (4, 4), off by `sigmas` per axis [m, rad], cannot be in it. Raises
    InvalidInput."""
    T = se3.check(T, "T_camera_palm")
    camera.check_size(depth, "depth")
    middle = hand.middle_at(T)
    reach = MAX_SIGMAS * sigmas[0] + hand.radius
    if not middle[2] > -reach:
        return None
    known = np.where((depth > 0) & (depth < np.inf), depth, 0).astype(np.float32)
    far = max(middle[2], 0.1)
    half = reach / max(middle[2] - reach, 0.5 * far, 0.1)
    count = min(int(2 * half / (SEARCH_CELL / far)) + 1, MAX_CELLS)
    corner = np.array([middle[0] / far - half, middle[1] / far - half, 2 * half / count])
    cells = np.empty((count + 1, count + 1, 4), dtype=np.float32)
    palm_scan.cells_of(camera.record, camera.rays, known, corner, cells)
    return Picture(hand, T, sigmas, camera, known, cells, corner) if (cells[..., 0] > 0).any() else None


def searched(picture: Picture, rows: Indices) -> Candidates:
    """Returns CANDIDATE (k,) from which the hand is aligned: the best poses of all within the sigmas, and around
    them. rows (m,): the points of the hand that the camera sees at the predicted pose."""
    hand = picture.hand
    air = hand.beside(picture.camera, picture.T, SEARCH_SCANNED)
    points = _about_middle(hand, rows[:SEARCH_SCANNED], air[: SEARCH_SCANNED // 2])
    turns = _turns(MAX_SIGMAS * picture.sigmas[1], SEARCH_ROTATION)
    shifts = _shifts(MAX_SIGMAS * picture.sigmas[0])
    candidates = _best(picture, picture.T, points, SEARCH_BIN, turns, shifts, SEARCH_BEST)
    candidates = distinct(hand, candidates, SEARCH_SHIFT, SEARCH_REFINED)
    points = _about_middle(hand, rows[: 2 * SEARCH_SCANNED], air)
    turns = _turns(SEARCH_ROTATION / 2, SEARCH_ROTATION / 2)
    finer = points, SEARCH_BIN / 2, turns, np.zeros((1, 3)), BEST_AROUND
    around = [_best(picture, T, *finer) for T in poses_of(candidates)]
    return distinct(hand, np.concatenate([candidates[:0], *around]), SEARCH_SHIFT / 2, SEARCH_KEPT)


def _about_middle(hand: PlacedHand, rows: Indices, air: Array) -> Array:
    """Returns (2, k, 3): points of the skin and in the air, about the hand's middle [m]; their normals, or zeros."""
    points = np.concatenate([hand.skin[0, rows], air]) - hand.middle
    return np.stack([points, np.concatenate([hand.skin[1, rows], np.zeros_like(air)])])


def _best(
    picture: Picture, T: Array, points: Array, bin_width: float, turns: Array, shifts: Array, most: int
) -> Candidates:
    """Returns the best CANDIDATE (k,), `most` at most, of all `turns` (r, 3, 3) and `shifts` (s, 3) [m] of the hand at
    a pose T (4, 4), by `points` as of `_about_middle`.

    For each of them one distance from the camera is taken, the one at which most points agree with the image, of those
    that are `bin_width` [m] apart.
    """
    rotations = turns @ T[:3, :3]
    middles = picture.hand.middle_at(T) + shifts
    found = np.empty((len(rotations), len(middles), 2))
    palm_scan.scan(picture.cells, picture.corner, bin_width, points, middles, rotations, found)
    places = middles * (1 + found[..., 1] / middles[:, 2])[..., None]
    off, turned = picture.sigmas_off(places, rotations[:, None])
    scores = (found[..., 0] - PRIOR_WEIGHT * (off**2 + turned**2)).reshape(-1)
    best = np.argpartition(-scores, min(most, len(scores) - 1))[:most]
    best = best[np.isfinite(scores[best])]
    R = rotations[best // len(middles)]
    candidates = candidates_at(se3.compose(R, places.reshape(-1, 3)[best] - R @ picture.hand.middle))
    candidates["score"] = scores[best]
    return candidates


@lru_cache(maxsize=16)
def _turns(reach: float, step: float) -> Array:
    """Returns rotations (r, 3, 3) `step` apart, up to `reach` [rad]; none but 0 where that is less than half a step."""
    turns = _grid(reach, np.full(3, step))
    inside = np.linalg.norm(turns, axis=1) <= reach + 0.8 * step
    return se3.rotation_exp(turns[inside])


def _shifts(reach: float) -> Array:
    """Returns shifts (s, 3) up to `reach` [m], close together across the direction to the camera, layers along it."""
    steps = np.array([SEARCH_SHIFT, SEARCH_SHIFT, SEARCH_LAYER])
    shifts = _grid(reach, steps)
    # A cell counts where any of it is within reach: by its nearest corner, not by its middle.
    nearest = np.maximum(np.abs(shifts) - steps / 2, 0.0)
    return np.asarray(shifts[np.linalg.norm(nearest, axis=1) <= reach])


def _grid(reach: float, steps: Array) -> Array:
    """Returns places (n, 3), `steps` (3,) apart, up to `reach` along each axis."""
    counts = np.maximum(np.ceil(reach / steps - 0.5).astype(int), 0)
    places = np.indices(2 * counts + 1).reshape(3, -1).T - counts
    return np.asarray(places * steps)


def distinct(hand: PlacedHand, candidates: Candidates, spacing: float, most: int) -> Candidates:
    """Returns the best candidates, the best first, each at least `spacing` from all better ones. Their distance is the
    root mean square of that of a few points of the hand [m]."""
    candidates = candidates[np.argsort(-candidates["score"], kind="stable")]
    points = hand.skin[0, :SEARCH_COMPARED]
    places = se3.apply(poses_of(candidates), points).reshape(len(candidates), points.size)
    free = np.ones(len(candidates), dtype=bool)
    kept = list[int]()
    while free.any() and len(kept) < most:
        kept.append(int(free.argmax()))
        away = places - places[kept[-1]]
        free &= ~(np.einsum("ki,ki->k", away, away) < SEARCH_COMPARED * spacing**2)
        free[kept[-1]] = False
    return candidates[kept]


def _align(picture: Picture, rows: Indices, stage: AlignStage, candidates: Candidates) -> None:
    """Moves candidates to where the first of the visible points `rows` lie on the image, and scores them by these."""
    few = rows[: stage.points]
    hand = picture.hand
    skin = hand.skin.take(few, axis=1)
    camera = picture.camera.record
    stages = np.array([(0, stage.first_bound, stage.last_bound, stage.steps, 1)], dtype=STAGE)
    hand_term.refine_hand(camera, picture.arrays, skin, hand.middle, hand.radius, stages, candidates)
    area = hand.appearance.point_area * len(rows) / max(len(few), 1)
    hand_term.score_hand(camera, picture.arrays, skin, area, stage.explained, candidates)


def _finished(picture: Picture, candidate: Candidates, stage: AlignStage) -> Candidates:
    """Returns CANDIDATE (1,) aligned by all visible points; a surface that goes on beside the hand lowers its score."""
    rows = np.flatnonzero(picture.hand.visible_from(picture.camera, poses_of(candidate)[0]))
    candidate = candidate.copy()
    _align(picture, rows, stage, candidate)
    expected = candidate["expected"]
    continued = picture.hand.outline_continued(picture.camera, picture.depth, poses_of(candidate)[0])
    size = np.maximum(expected, HAND_SCORE.min_expected) ** HAND_SCORE.size_exponent
    candidate["score"] -= CONTINUED_WEIGHT * continued * expected / size
    return candidate


def _believed(picture: Picture, candidates: Candidates, sigmas: float) -> Candidates:
    """Returns the candidates, the best first, that are at most so many sigmas off the predicted pose."""
    Ts = poses_of(candidates)
    off = np.maximum(*picture.sigmas_off(picture.hand.middle_at(Ts), Ts[:, :3, :3]))
    candidates = candidates[off < sigmas]
    return candidates[np.argsort(-candidates["score"], kind="stable")]


def _answer(picture: Picture, candidates: Candidates, noise: DepthNoise) -> PalmDetection | PalmNotFound:
    """Returns the best candidate, where it is good enough and no other is nearly as good."""
    if not len(candidates) or not candidates["score"][0] > MIN_SCORE:
        return PalmNotFound("no_fit")
    best = candidates[:1].copy()
    fits = candidates["explained"] / np.maximum(candidates["expected"], 1.0)
    if best["explained"][0] < MIN_PIXELS or fits[0] < MIN_FIT:
        return PalmNotFound("hardly_seen")
    others = distinct(picture.hand, candidates, CANDIDATE_SPACING, 2)[1:]
    if len(others) and others["score"][0] > AS_GOOD * best["score"][0]:
        return PalmNotFound("ambiguous")
    T = poses_of(best)[0]
    if picture.hand.outline_continued(picture.camera, picture.depth, T) > MAX_CONTINUED:
        return PalmNotFound("no_fit")
    return PalmDetection(T, _covariance(picture, best, noise), float(fits[0]))


def _covariance(picture: Picture, candidate: Candidates, noise: DepthNoise) -> Array:
    """Returns (6, 6) of CANDIDATE (1,) by (δp, δθ) of the palm along the camera's axes.

    The errors of points are those of `noise`. Those of whole pixels are added, and those of constant errors of the
    joints, to first order: a weighted fit follows a joint that is off.
    """
    T = poses_of(candidate)[0]
    hand = picture.hand
    camera = picture.camera
    rows = np.flatnonzero(hand.visible_from(camera, T))
    skin = hand.skin.take(rows, axis=1)
    fitted = np.empty((len(rows), 8))
    bound = LAST_STAGE.last_bound
    hand_term.rows_of(camera.record, picture.arrays, skin, candidate["pose"].copy(), bound, fitted)
    used = fitted[:, 0] > 0
    weights = fitted[used, 0]
    normals = fitted[used, 2:5].copy()
    points = se3.apply(T, skin[0, used])
    center = hand.middle_at(T)
    z = np.maximum(center[2:], 1e-3)
    # Along a direction that no point observes: half the hand's size, and 1.8 rad.
    errors = depth_errors(camera, noise, z, (hand.radius, 1.8 * hand.radius))
    informed = np.empty((2, 6, 6))
    covariance = np.empty((6, 6))
    depth_covariance.inform_points(weights, points, normals, center, hand.radius, errors, COMPARED, informed)
    depth_covariance.covariance_of(informed, errors, covariance)
    if hand.joint_errors.any():
        lines = np.hstack([normals, np.cross(points - center, normals) / hand.radius])
        by_joints = np.einsum("mi,ij,mjk->mk", normals, T[:3, :3], hand.by_joints(rows[used]))
        information = informed[0] + (weights.sum() + 1e-9) * 1e-9 * np.eye(6)
        follows = np.linalg.solve(information, (weights * lines.T) @ by_joints)
        covariance = covariance + follows @ follows.T
    scale = np.repeat([1.0, hand.radius], 3)
    covariance = GaussianPose(T, covariance / np.outer(scale, scale)).at_point(-hand.middle).covariance
    return np.asarray((covariance + covariance.T) / 2)
