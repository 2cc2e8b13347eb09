"""Where the palm is in the camera, from the hand that is seen: no calibration of the camera has a say in it.

The believed hand is laid onto the depth image: turned and shifted in steps as far as the belief may be off, the
likeliest poses then moved to where the hand's points lie on what is seen (point to plane), and judged by what the image
as a whole says of them: pixels that the hand explains, that the camera sees past, that are hidden.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels import hand_term
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.vision.camera import Depth, PinholeCamera
from handsight.vision.first_pose import poses_of
from handsight.vision.hand_look import PlacedHand
from handsight.vision.hand_search import Picture, distinct, picture_of, searched

LIMIT = 4.0
"""Sigmas of the belief beyond which no answer is taken."""
RUNGS = ((150, (0.03, 0.015, 7, 0.015), 10, 0.010), (400, (0.015, 0.010, 8, 0.010), 3, 0.008))
"""Points; Tukey's bound at first and at last [m], steps, what is explained within [m]; how many poses go on, and how
far they are apart [m]."""
LAST = (0.015, 0.006, 8, 0.010)
"""The same with all points."""
NEARLY = 0.6
"""Share of the best score from which others are laid on with all points too."""

LEAST_SCORE, LEAST_PIXELS, LEAST_FIT = 3.0, 400.0, 0.25
"""Of an answer: LOOK's score, pixels that the hand explains, and their share of those that it should fill."""
MOST_CONTINUED = 0.55
"""Of the hand's outline: where what is seen goes on beside it, the hand was laid into a table or a wall."""
APART, AS_GOOD = 0.025, 0.85
"""Poses farther from each other than this [m] are others, and one whose score is so much of the best is as good."""

PIXELS_PER_POINT = 100.0
"""Pixels whose depth errs together: they are one point."""
SIGMA = 0.0015
"""Of the depth of each [m]."""
BIAS, BIAS_UP_TO = 0.001, 0.8
"""What all that is seen is off by together [m], up to so far [m]; beyond by its square."""
UNKNOWN = 0.5, 1.8
"""Of a direction that no point sees [the hand's size, rad]."""

Reason = Literal["outside", "hardly_seen", "no_fit", "ambiguous"]


@dataclass(frozen=True, slots=True, eq=False)
class HandNotSeen:
    """No pose, and why; falsy."""

    reason: Reason
    """outside: of the picture, wherever the belief may be off to; hardly_seen: too few pixels are the hand's, most of
    it is hidden or far; no_fit: what is there is no such hand; ambiguous: another pose fits as well."""

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True, slots=True, eq=False)
class SeenHand:
    """The palm's pose at one instant, as a picture shows it."""

    T_camera_palm: Array
    """(4, 4)"""
    covariance: Array
    """(6, 6) of (δp [m], δθ [rad]) along the camera's axes."""
    fit: float
    """Of the pixels that the hand should fill, the share that it explains; what hides it takes from it."""
    look: NDArray[np.void]
    """(1,) LOOK: what the image says of it, in pixels."""


def seen_hand(
    camera: PinholeCamera,
    depth: Depth,
    hand: PlacedHand,
    T_camera_palm: Array,
    *,
    sigma_position: float,
    sigma_rotation: float,
) -> SeenHand | HandNotSeen:
    """The palm's pose in the camera, or why a depth image (h, w) [m], 0 or NaN where there is none, does not tell it.

    T_camera_palm: as believed, off by `sigma_position` [m] at the hand's middle and `sigma_rotation` [rad] per axis.
    What is searched, and with it the time, grows with them. Raises InvalidInput.
    """
    T = se3.check(T_camera_palm, "T_camera_palm")
    sigmas = _positive(sigma_position, "sigma_position"), _positive(sigma_rotation, "sigma_rotation")
    camera.check_size(depth, "depth")
    picture = picture_of(camera, depth, hand, T, sigmas[0])
    if picture is None:
        return HandNotSeen("outside")
    there = hand.seen_from(camera, T)
    looks = searched(picture, hand, T, sigmas, there)
    if not len(looks):
        return HandNotSeen("outside")
    rows = np.flatnonzero(there)
    for count, rung, kept, apart in RUNGS:
        looks = _laid(picture, hand, rows, (count, *rung), looks)
        looks = distinct(hand, _believed(hand, T, sigmas, looks), apart, kept)
    looks = looks[looks["score"] > NEARLY * looks["score"].max(initial=0.0)]
    looks = np.concatenate(
        [looks[:0], *(_finished(picture, hand, looks[k : k + 1]) for k in range(len(looks)))]
    )
    looks = _believed(hand, T, sigmas, looks)
    return _answer(picture, hand, looks)


def _positive(value: float, name: str) -> float:
    number = float(checks.finite(value, name, ()))
    if not number > 0:
        raise InvalidInput(f"{name}: expected a number above 0, got {number:g}")
    return number


def _laid(
    picture: Picture, hand: PlacedHand, rows: Indices, rung: tuple[float, ...], looks: NDArray[np.void]
) -> NDArray[np.void]:
    """The looks moved to where points, some of `rows`, lie on the image, and judged by them; rung: see RUNGS."""
    count, first, last, steps, bound = rung
    few = rows[: int(count)]
    skin, camera = np.ascontiguousarray(hand.skin[:, few]), picture.camera.record
    limits = np.array([first, last, steps, hand.radius])
    hand_term.settle_all(camera, picture.arrays, skin, hand.middle, limits, looks)
    limits = np.array([hand.look.point_area * len(rows) / max(len(few), 1), bound])
    hand_term.judge_all(camera, picture.arrays, skin, limits, looks)
    return looks


def _finished(picture: Picture, hand: PlacedHand, look: NDArray[np.void]) -> NDArray[np.void]:
    rows = np.flatnonzero(hand.seen_from(picture.camera, poses_of(look)[0]))
    return _laid(picture, hand, rows, (len(rows), *LAST), look.copy())


def _believed(
    hand: PlacedHand, T: Array, sigmas: tuple[float, float], looks: NDArray[np.void]
) -> NDArray[np.void]:
    """Those that the belief can be off by, the best first."""
    Ts = poses_of(looks)
    off = np.linalg.norm(se3.apply(Ts, hand.middle[None])[:, 0] - se3.apply(T, hand.middle[None])[0], axis=1)
    turned = np.array([np.linalg.norm(se3.rotation_log(R @ T[:3, :3].T)) for R in Ts[:, :3, :3]])
    looks = looks[(off < LIMIT * sigmas[0]) & (turned < LIMIT * sigmas[1])] if len(looks) else looks
    return looks[np.argsort(-looks["score"], kind="stable")]


def _answer(picture: Picture, hand: PlacedHand, looks: NDArray[np.void]) -> SeenHand | HandNotSeen:
    """The best, where it is good enough and no other is nearly as good."""
    if not len(looks) or not looks["score"][0] > LEAST_SCORE:
        return HandNotSeen("no_fit")
    best, fits = looks[:1].copy(), looks["explained"] / np.maximum(looks["expected"], 1.0)
    if best["explained"][0] < LEAST_PIXELS or fits[0] < LEAST_FIT:
        return HandNotSeen("hardly_seen")
    others = distinct(hand, looks, APART, 2)[1:]
    if len(others) and others["score"][0] > AS_GOOD * best["score"][0]:
        return HandNotSeen("ambiguous")
    if hand.outline_continued(picture.camera, picture.depth, poses_of(best)[0]) > MOST_CONTINUED:
        return HandNotSeen("no_fit")
    covariance = _covariance(picture, hand, best)
    return SeenHand(poses_of(best)[0], covariance, float(fits[0]), best)


def _covariance(picture: Picture, hand: PlacedHand, look: NDArray[np.void]) -> Array:
    """(6, 6) by (δp, δθ) of the palm along the camera's axes: points, the camera's constant error, and the joints'."""
    T = poses_of(look)[0]
    rows = np.flatnonzero(hand.seen_from(picture.camera, T))
    skin, out = np.ascontiguousarray(hand.skin[:, rows]), np.empty((len(rows), 8))
    hand_term.rows_of(picture.camera.record, picture.arrays, skin, look["pose"].copy(), LAST[1], out)
    weight, normals, arm = out[:, 0], out[:, 2:5], T[:3, :3] @ hand.middle
    lines = out[:, 2:].copy()
    lines[:, 3:] -= np.cross(arm + T[:3, 3], normals)
    information = np.einsum("m,mi,mj->ij", weight, lines, lines)
    D, distance = 2 * hand.radius, (T[:3, 3] + arm)[2]
    unknown = np.diag(np.repeat([1 / (UNKNOWN[0] * D) ** 2, 1 / UNKNOWN[1] ** 2], 3))
    points = max(float(look["explained"][0]) / PIXELS_PER_POINT, 1.0)
    about = np.linalg.inv(information * points / max(weight.sum(), 1e-9) / SIGMA**2 + unknown)
    bias = BIAS * max(1.0, (distance / BIAS_UP_TO) ** 2)
    about += np.diag(np.repeat([bias**2, (2 * bias / D) ** 2], 3))
    if hand.sigma_joint > 0:
        by_joints = np.einsum("mi,ij,mjk->mk", normals, T[:3, :3], hand.by_joints(rows))
        leans = np.linalg.solve(
            information + weight.sum() * 1e-9 * np.eye(6), np.einsum("m,mi,mk->ik", weight, lines, by_joints)
        )
        about += hand.sigma_joint**2 * leans @ leans.T
    to_palm = np.eye(6)
    to_palm[:3, 3:] = se3.skew(arm)
    covariance = to_palm @ about @ to_palm.T
    return np.asarray((covariance + covariance.T) / 2)
