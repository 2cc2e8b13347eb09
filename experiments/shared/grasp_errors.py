"""Errors of a pose in the hand, as the paper measures them (eq. 8) and by the simulator's truth, with intervals."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.evaluation import base_center
from testbed import scenes
from testbed.report import Array, Row

GRID = 0.001
"""Resolution to which corners are read off the paper on the table [m]."""
SIDE = 0.06
"""Side of a square on the table [m]; the paper gives no number."""
QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
RESAMPLES, CONFIDENCE = 2000, 0.95
Interval = tuple[float, float, float]
"""A value, and the ends of its 95 % interval."""


def centre_from_corners(p1: Any, p2: Any) -> Array:
    """Returns the object's centre (..., 2) from two corners: `p1` across the square from it, `p2` next to it.

    Eq. 8. Seen from above, x right and y up, the square is walked counterclockwise centre, `p2`, `p1`.
    """
    v = np.asarray(p1) - np.asarray(p2)
    return np.asarray(np.asarray(p2) + v @ QUARTER_TURN.T)


def corners(centre: Array, angle: float, side: float = SIDE) -> Array:
    """Returns the corners p₁ and p₂ of eq. 8 for each of the four squares around a centre, (4, 2, 2)."""
    turns = angle + np.arange(4) * np.pi / 2
    along = side * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    p2 = centre + along
    return np.stack([p2 + along @ QUARTER_TURN.T, p2], axis=1)


def read_centre(xy: Array, angle: float) -> Array:
    """Returns the base's centre (2,) on the table [m] by eq. 8, from two corners read to a millimetre."""
    p1, p2 = corners(np.asarray(xy), angle)[0]
    return centre_from_corners(*(GRID * np.round(p / GRID) for p in (p1, p2)))


def pose_errors(
    model: hs.ObjectModel, T_palm_object: Array, sample: Any, open_directions: Array | Sequence[Array] = ()
) -> Row:
    """Returns the errors of a pose modulo symmetry, in millimetres and degrees.

    `open_directions` (k, 6): in which the contacts leave the pose open, as `PoseEstimate.unobservable`.

      read    x, y of the base's centre against the truth by eq. 8: the paper's measure
      base    the same against the exact truth
      middle  of the object's middle, in space
      turn    of the rotation [°]
      seen    shift and turn (a radian is as long as the object's radius) that the contacts can see
      open    the rest
    """
    T_world_palm = sample.observation.T_world_palm
    true = scenes.nearest_truth(model, sample.T_palm_object, T_palm_object)
    base = base_center(model, sample.T_world_object)
    found, exact = (se3.apply(T_world_palm @ T, base[None])[0, :2] for T in (T_palm_object, true))
    middles = [se3.apply(T, model.center_object[None])[0] for T in (T_palm_object, true)]
    forward = sample.T_world_object[:2, 0]
    read = read_centre(exact, np.arctan2(forward[1], forward[0]))
    delta = se3.difference(T_palm_object, true) * np.repeat([1.0, model.radius], 3)
    directions = np.asarray(open_directions, dtype=np.float64).reshape(-1, 6)
    rest = directions @ delta
    return {
        "read": 1e3 * float(np.linalg.norm(found - read)),
        "base": 1e3 * float(np.linalg.norm(found - exact)),
        "middle": 1e3 * float(np.linalg.norm(middles[0] - middles[1])),
        "turn": float(np.rad2deg(np.linalg.norm(delta[3:]) / model.radius)),
        "seen": 1e3 * float(np.linalg.norm(delta - directions.T @ rest)),
        "open": 1e3 * float(np.linalg.norm(rest)),
    }


def open_sigma(model: hs.ObjectModel, estimate: hs.PoseEstimate) -> float:
    """Returns the standard deviation [mm] of an estimate along its unobservable directions but symmetries."""
    scale = np.repeat([1.0, 1 / model.radius], 3)
    values, vectors = np.linalg.eigh(estimate.information * scale[:, None] * scale)
    known = values > 1e-9 * max(values[-1], 1e-300)
    rows = estimate.unobservable @ vectors[:, known]
    return 1e3 * float(np.sqrt((rows**2 / values[known]).sum()))


def mean_interval(values: Any, seed: int = 0) -> Interval:
    """Returns the mean, and the ends of its 95 % interval by bootstrap."""
    array = np.asarray(values, dtype=np.float64)
    means = array[_resampled(len(array), seed)].mean(axis=1)
    return float(array.mean()), *_ends(means)


def removed_interval(before: Array, after: Array, seed: int = 0) -> Interval:
    """Returns the removed share of the mean error [%], and the ends of its 95 % interval by bootstrap over pairs."""
    before, after = (np.asarray(v, dtype=np.float64) for v in (before, after))
    rows = _resampled(len(before), seed)
    shares = 100 * (1 - after[rows].mean(axis=1) / before[rows].mean(axis=1))
    return float(100 * (1 - after.mean() / before.mean())), *_ends(shares)


def _resampled(n: int, seed: int) -> Array:
    return np.random.default_rng(seed).integers(n, size=(RESAMPLES, n))


def _ends(values: Array) -> tuple[float, float]:
    low, high = np.quantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def between(interval: Interval, digits: int = 1) -> str:
    """Returns the text `value [low, high]`."""
    value, low, high = interval
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
