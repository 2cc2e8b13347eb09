"""When modes are distinct, and when contacts fit."""

from functools import lru_cache

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

SAME_MODE = (0.015, float(np.deg2rad(20.0)))
"""Two modes are distinct when further apart than this [m] or turned by more than this [rad]."""
MOST_MODES = 8
ALARM = 1e-3
"""Probability that evidence which fits is called inconsistent."""
RECHECK_P = 0.003
"""Probability that contacts which fit are searched for a wrong one all the same: time lost, nothing else."""
DOUBT_P, DOUBT_COARSE = 0.2, 5.0
"""What one start from the widest prior that it may do for found is doubted, and other starts are tried, when what is
right fits worse with this probability at most, or when it was this many times worse yet on the coarse field. Two of
three problems on an L-shaped mesh, with a prior of 0.22 diameters, raise no doubt."""
DECISIVE = 16.27
"""A contact is wrong when the cost falls by more than this without it: a right one's does once in 1000."""


def in_metres(information: Array, radius: float) -> Array:
    """Information (..., 6, 6) by (δp, radius δθ) [1/m²]."""
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    return np.asarray(information * scale[:, None] * scale)


def pose_distances(model: ObjectModel, Ts: Array, T: Array) -> tuple[Array, Array]:
    """Shift of the object's center [m] and turn [rad] from `T` to each of `Ts`, modulo symmetry."""
    equivalent = nearest(model.symmetries, Ts, T, model.radius)
    center = model.center_object[None]
    shift = se3.apply(equivalent, center)[:, 0] - se3.apply(T, center)
    turn = se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)
    return np.linalg.norm(shift, axis=-1), np.linalg.norm(turn, axis=-1)


def distinct(
    model: ObjectModel, Ts: Array, order: Indices, most: int, limits: tuple[float, float] = SAME_MODE
) -> list[int]:
    """Indices of `Ts`, in the given order, that are no repeat of an earlier one; at most `most`.

    Modulo any symmetry; kernels do it for those that they know.
    """
    chosen: list[int] = []
    rest = order
    while len(rest) and len(chosen) < most:
        chosen.append(int(rest[0]))
        shift, turn = pose_distances(model, Ts[rest], Ts[rest[0]])
        new = (shift > limits[0]) | (turn > limits[1])
        new[0] = False
        rest = rest[new]
    return chosen


def beyond_doubt(cost: float, coarse_cost: float, freedom: int, wide: float) -> bool:
    """Whether what one start led to fits so well that another mode is hardly better.

    `wide`: how wide the prior is, of the widest that one start may do for. What could be missed grows with its square.
    """
    doubt = round(wide * wide, 2)  # few different ones, for each has its limits worked out
    if coarse_cost * doubt > DOUBT_COARSE * _limit(max(freedom, 1), 0.1):
        return False
    return fits(cost, freedom, max(DOUBT_P * doubt, RECHECK_P))


def unsuspicious(cost: float, freedom: int, gain: float) -> bool:
    """Whether contacts raise no suspicion: not all together, nor one of them against the others."""
    return fits(cost, freedom, RECHECK_P) and bool(gain < DECISIVE)


def fits(chi2: float, freedom: int, alarm: float = ALARM) -> bool:
    """Whether a sum of squares with that many degrees of freedom is below its 1 - alarm quantile."""
    return bool(chi2 <= _limit(max(freedom, 1), alarm))


@lru_cache(maxsize=1024)
def _limit(freedom: int, alarm: float) -> float:
    """The 1 - alarm quantile of χ²."""
    from scipy.special import chdtri

    return float(chdtri(freedom, alarm))
