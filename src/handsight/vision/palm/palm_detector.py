"""Where the palm is in the camera, from the hand that is seen: no calibration of the camera has a say in it.

The believed hand is laid onto the depth image: turned and shifted in steps as far as the belief may be off, the
likeliest poses then moved to where the hand's points lie on what is seen (point to plane), and judged by what the image
as a whole says of them: pixels that the hand explains, that the camera sees past, that are hidden, and whether what is
seen goes on beside the hand. Where the last picture has had it, it is only moved.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._deprecated import renamed_members
from handsight._kernels.image import hand_term
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import poses_of
from handsight.vision.palm.hand_appearance import PlacedHand
from handsight.vision.palm.palm_covariance import palm_covariance
from handsight.vision.palm.palm_search import Belief, Picture, distinct, picture_of, searched


class DetectorOptions(NamedTuple):
    """`DetectorOptions` say when a palm is detected."""

    max_sigmas: float = 4.0  # of the belief, beyond which no answer is taken
    search_factor: float = 2.5  # times that, beyond which none goes on to become one
    min_fit_followed: float = 0.65
    """Of a hand that is followed: the least share explained of what is neither hidden nor out of the picture."""
    max_passed: float = 0.15  # and the largest share that the camera sees past
    near_best: float = 0.6  # share of the best score from which others are compared with all points too
    min_score: float = 2.0  # of an answer
    min_pixels: float = 400.0  # pixels that the hand explains
    min_fit: float = 0.25  # and their share of those that it should fill
    continued_weight: float = 0.3
    """What all of the hand's outline counts, against the pixels that it should fill, where the image continues beside
    it.
    """
    max_continued: float = 0.55
    """Share of it above which no answer is taken: the hand was found in a table or a wall."""
    candidate_spacing: float = 0.025  # poses farther from each other than this are others [m]
    as_good: float = 0.85  # one whose score is so much of the best is as good


DETECTOR = DetectorOptions()

STAGES = ((300, (0.02, 0.010, 7, 0.015), 12, 0.010), (500, (0.012, 0.008, 6, 0.010), 5, 0.008))
"""Points; Tukey's bound at first and at last [m], steps, what is explained within [m]; how many poses go on, and how
far they are apart [m]. A wide bound lets what is held pull the hand away."""
LAST = (0.015, 0.006, 8, 0.010)
"""The same with all points."""
FOLLOWED, NEXT = (0.010, float(np.deg2rad(3.0))), (0.02, 0.006, 10, 0.010)
"""How far off a hand that is followed may be [m, rad], and as LAST for it."""


Reason = Literal["outside", "hardly_seen", "no_fit", "ambiguous"]


@dataclass(frozen=True, slots=True, eq=False)
class PalmNotFound:
    """A `PalmNotFound` is no pose, and why; falsy."""

    reason: Reason
    """outside: of the picture, wherever the belief may be off to; hardly_seen: too few pixels are the hand's, most of
    it is hidden or far; no_fit: what is there is no such hand; ambiguous: another pose fits as well."""

    def __bool__(self) -> bool:
        return False


@renamed_members(look="candidate")
@dataclass(frozen=True, slots=True, eq=False)
class PalmDetection:
    """A `PalmDetection` is the palm's pose at one instant, as a picture shows it."""

    T_camera_palm: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) of (δp [m], δθ [rad]) along the camera's axes."""
    fit: float
    """Of the pixels that the hand should fill, the share that it explains; what hides it takes from it."""
    candidate: NDArray[np.void]
    """(1,) CANDIDATE: what the image says of it, in pixels."""


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
    """Returns the palm's pose in the camera, or why a depth image (h, w) [m], 0 or NaN where there is none, does not
    tell it.

    T_camera_palm: as believed, off by `sigma_position` [m] at the hand's middle and `sigma_rotation` [rad] per axis.
    What is searched, and with it the time, grows with them. `noise` has a say in the covariance. Raises InvalidInput.
    """
    T = _checked(camera, depth, T_camera_palm)
    sigmas = _positive(sigma_position, "sigma_position"), _positive(sigma_rotation, "sigma_rotation")
    belief = Belief(hand, T, sigmas)
    picture = picture_of(camera, depth, hand, T, sigmas[0])
    if picture is None:
        return PalmNotFound("outside")
    there = hand.visible_from(camera, T)
    candidates = searched(picture, belief, there)
    if not len(candidates):
        return PalmNotFound("outside")
    rows = np.flatnonzero(there)
    for count, stage, kept, spacing in STAGES:
        candidates = _laid(picture, hand, rows, (count, *stage), candidates)
        candidates = distinct(
            hand, _believed(belief, candidates, DETECTOR.search_factor * DETECTOR.max_sigmas), spacing, kept
        )
    candidates = candidates[candidates["score"] > DETECTOR.near_best * candidates["score"].max(initial=0.0)]
    candidates = np.concatenate(
        [candidates[:0], *(_finished(picture, hand, candidates[k : k + 1]) for k in range(len(candidates)))]
    )
    return _answer(picture, hand, _believed(belief, candidates), noise)


def follow_palm(
    camera: Camera,
    depth: Depth,
    hand: PlacedHand,
    T_camera_palm: Array,
    *,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> PalmDetection | PalmNotFound:
    """Works as `detect_palm`, near where the last picture has had the palm; nothing is searched, so that it takes a
    few ms.

    T_camera_palm: off by about 10 mm and 3° per axis. Where too little of what should be seen is so: `no_fit`.
    """
    T = _checked(camera, depth, T_camera_palm)
    picture = picture_of(camera, depth, hand, T, FOLLOWED[0])
    if picture is None:
        return PalmNotFound("outside")
    candidate = np.zeros(1, dtype=CANDIDATE)
    candidate["pose"]["rotation"], candidate["pose"]["position"] = T[:3, :3], T[:3, 3]
    candidate = _believed(Belief(hand, T, FOLLOWED), _finished(picture, hand, candidate, NEXT))
    if len(candidate):
        free = candidate["explained"] + candidate["passed"] + candidate["unexplained"]
        if not (
            candidate["explained"] > DETECTOR.min_fit_followed * free
            and candidate["passed"] < DETECTOR.max_passed * free
        ).all():
            return PalmNotFound("no_fit")
    return _answer(picture, hand, candidate, noise)


def _checked(camera: Camera, depth: Depth, T_camera_palm: Array) -> Array:
    T = se3.check(T_camera_palm, "T_camera_palm")
    camera.check_size(depth, "depth")
    return T


def _positive(value: float, name: str) -> float:
    number = float(checks.finite(value, name, ()))
    if not number > 0:
        raise InvalidInput(f"{name}: expected a number above 0, got {number:g}")
    return number


def _laid(
    picture: Picture, hand: PlacedHand, rows: Indices, stage: tuple[float, ...], candidates: NDArray[np.void]
) -> NDArray[np.void]:
    """Returns the looks moved to where points, some of `rows`, lie on the image, and judged by them; stage: see
    RUNGS."""
    count, first, last, steps, bound = stage
    few = rows[: int(count)]
    skin, camera = np.ascontiguousarray(hand.skin[:, few]), picture.camera.record
    limits = np.array([first, last, steps, hand.radius])
    hand_term.refine_hand(camera, picture.arrays, skin, hand.middle, limits, candidates)
    limits = np.array([hand.appearance.point_area * len(rows) / max(len(few), 1), bound])
    hand_term.score_hand(camera, picture.arrays, skin, limits, candidates)
    return candidates


def _finished(
    picture: Picture, hand: PlacedHand, candidate: NDArray[np.void], stage: tuple[float, ...] = LAST
) -> NDArray[np.void]:
    """Returns a look (1,) laid on by all points that are seen; what goes on beside it is taken from its score."""
    rows = np.flatnonzero(hand.visible_from(picture.camera, poses_of(candidate)[0]))
    candidate = _laid(picture, hand, rows, (len(rows), *stage), candidate.copy())
    expected, goes_on = (
        candidate["expected"],
        hand.outline_continued(picture.camera, picture.depth, poses_of(candidate)[0]),
    )
    candidate["score"] -= (
        DETECTOR.continued_weight
        * goes_on
        * expected
        / np.maximum(expected, hand_term.HAND_SCORE.min_expected) ** hand_term.HAND_SCORE.size_exponent
    )
    return candidate


def _believed(
    belief: Belief, candidates: NDArray[np.void], limit: float = DETECTOR.max_sigmas
) -> NDArray[np.void]:
    """Returns those that the belief can be off by, so many sigmas; the best first."""
    hand, T, sigmas = belief.hand, belief.T, belief.sigmas
    Ts = poses_of(candidates)
    off = np.linalg.norm(se3.apply(Ts, hand.middle[None])[:, 0] - se3.apply(T, hand.middle[None])[0], axis=1)
    turned = np.linalg.norm(se3.rotation_log(Ts[:, :3, :3] @ T[:3, :3].T), axis=1)
    candidates = candidates[(off < limit * sigmas[0]) & (turned < limit * sigmas[1])]
    return candidates[np.argsort(-candidates["score"], kind="stable")]


def _answer(
    picture: Picture, hand: PlacedHand, candidates: NDArray[np.void], noise: DepthNoise
) -> PalmDetection | PalmNotFound:
    """Returns the best, where it is good enough and no other is nearly as good."""
    if not len(candidates) or not candidates["score"][0] > DETECTOR.min_score:
        return PalmNotFound("no_fit")
    best, fits = candidates[:1].copy(), candidates["explained"] / np.maximum(candidates["expected"], 1.0)
    if best["explained"][0] < DETECTOR.min_pixels or fits[0] < DETECTOR.min_fit:
        return PalmNotFound("hardly_seen")
    others = distinct(hand, candidates, DETECTOR.candidate_spacing, 2)[1:]
    if len(others) and others["score"][0] > DETECTOR.as_good * best["score"][0]:
        return PalmNotFound("ambiguous")
    T = poses_of(best)[0]
    if hand.outline_continued(picture.camera, picture.depth, T) > DETECTOR.max_continued:
        return PalmNotFound("no_fit")
    rows = np.flatnonzero(hand.visible_from(picture.camera, T))
    covariance = palm_covariance(picture, hand, best, (rows, LAST[1]), noise)
    return PalmDetection(T, covariance, float(fits[0]), best)
