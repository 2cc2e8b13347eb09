"""Errors of a pose in the hand, as the paper measures them and as a simulator knows them, with their spread."""

import numpy as np
from scipy.special import chdtri

from figure_6 import centre_from_corners, corners
from handsight import se3
from handsight.evaluation import base_center
from handsight.objects.symmetry import nearest

GRID = 0.001
"""To what the corners are read off the paper on the table [m]."""
RESAMPLES, CONFIDENCE = 2000, 0.95
LEVELS = (0.50, 0.95)


def read_centre(xy, angle):
    """(2,) the base's centre on the table [m] by eq. 8, from two corners read to a millimetre."""
    p1, p2 = corners(np.asarray(xy), angle)[0]
    return centre_from_corners(*(GRID * np.round(p / GRID) for p in (p1, p2)))


def pose_errors(model, T_palm_object, sample, open_directions=()):
    """Errors of a pose modulo symmetry, in millimetres and degrees.

    `open_directions` (k, 6): in which the contacts leave the pose open, as `PoseEstimate.unobservable`.

      read    x, y of the base's centre against the truth by eq. 8: the paper's measure
      base    the same against the exact truth
      middle  of the object's middle, in space
      turn    of the rotation [°]
      seen    shift and turn (a radian is as long as the object's radius) that the contacts can see
      open    the rest
    """
    T_world_palm = sample.observation.T_world_palm
    true = nearest(model.symmetries, sample.T_palm_object, T_palm_object, model.radius)
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


def open_sigma(model, estimate):
    """Standard deviation [mm] that an estimate states along its open directions, declared symmetries aside."""
    scale = np.repeat([1.0, 1 / model.radius], 3)
    values, vectors = np.linalg.eigh(estimate.information * scale[:, None] * scale)
    known = values > 1e-9 * max(values[-1], 1e-300)
    rows = estimate.unobservable @ vectors[:, known]
    return 1e3 * float(np.sqrt((rows**2 / values[known]).sum()))


def region(model, estimate, T_true):
    """Where the truth is in the answer's own units: χ², its degrees of freedom, and whether regions hold it."""
    truth = nearest(model.symmetries, T_true, estimate.T_palm_object, model.radius)
    delta = se3.difference(truth, estimate.T_palm_object)
    squared = float(delta @ estimate.information @ delta)
    scale = np.repeat([1.0, 1 / model.radius], 3)
    information = estimate.information * scale[:, None] * scale
    freedom = int(np.linalg.matrix_rank(information, hermitian=True))
    inside = {f"in {level:.0%}": bool(squared < chdtri(freedom, 1 - level)) for level in LEVELS}
    return {"squared": squared, "freedom": freedom, **inside}


def mean_interval(values, seed=0):
    """Mean, and the ends of its 95 % interval by bootstrap."""
    array = np.asarray(values, dtype=np.float64)
    means = array[_resampled(len(array), seed)].mean(axis=1)
    return float(array.mean()), *_ends(means)


def removed_interval(before, after, seed=0):
    """Share of the mean error that was removed [%], and the ends of its 95 % interval by bootstrap over pairs."""
    before, after = (np.asarray(v, dtype=np.float64) for v in (before, after))
    rows = _resampled(len(before), seed)
    shares = 100 * (1 - after[rows].mean(axis=1) / before[rows].mean(axis=1))
    return float(100 * (1 - after.mean() / before.mean())), *_ends(shares)


def _resampled(n, seed):
    return np.random.default_rng(seed).integers(n, size=(RESAMPLES, n))


def _ends(values):
    low, high = np.quantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def between(interval, digits=1):
    """`value [low, high]` as text."""
    value, low, high = interval
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
