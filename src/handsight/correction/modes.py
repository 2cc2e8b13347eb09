"""When modes are distinct, and when contacts fit."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

SAME_MODE = (0.015, float(np.deg2rad(20.0)))
"""Two modes are distinct when further apart than this [m] or turned by more than this [rad]."""


class ModeOptions(NamedTuple):
    """`ModeOptions` say when modes are distinct, and when an answer is doubted."""

    max_modes: int = 8  # modes that are reported
    alarm: float = 1e-3  # probability that evidence which fits is called inconsistent
    recheck_p: float = 0.003
    """Probability that contacts which fit are searched for a wrong one nevertheless: it costs time, nothing else."""
    doubt_p: float = 0.2
    """Of one start from the widest prior for which one may be enough, an answer is doubted if a right one fits worse
    with at most this probability. Two of three problems on an L-shaped mesh, with a prior of 0.22 diameters, raise no
    doubt.
    """
    doubt_coarse: float = 5.0  # how many times worse it may fit on the coarse field
    decisive: float = 16.27
    """A contact is wrong when the cost falls by more than this without it: with a right one it does once in 1000."""


MODES = ModeOptions()


def in_metres(information: Array, radius: float) -> Array:
    """Returns information (..., 6, 6) by (δp, radius δθ) [1/m²]."""
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    return np.asarray(information * scale[:, None] * scale)


def pose_distances(model: ObjectModel, Ts: Array, T: Array) -> tuple[Array, Array]:
    """Returns shift of the object's center [m] and turn [rad] from `T` to each of `Ts`, modulo symmetry."""
    equivalent = nearest(model.symmetries, Ts, T, model.radius)
    center = model.center_object[None]
    shift = se3.apply(equivalent, center)[:, 0] - se3.apply(T, center)
    turn = se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)
    return np.linalg.norm(shift, axis=-1), np.linalg.norm(turn, axis=-1)


def distinct(
    model: ObjectModel, Ts: Array, order: Indices, most: int, limits: tuple[float, float] = SAME_MODE
) -> list[int]:
    """Returns indices of `Ts`, in the given order, that are no repeat of an earlier one; at most `most`.

    Modulo any symmetry; `solve.distinct` does it by a kernel for the symmetries that kernels know.
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
    """Returns whether the minimum of one start fits so well that another mode is hardly better.

    `wide`: the prior's width as a part of the widest for which one start may be enough. The probability of a missed
    mode grows with its square.
    """
    doubt = round(wide * wide, 2)  # few different values, for the limits of each are computed and kept
    if coarse_cost * doubt > MODES.doubt_coarse * chi2_limit(max(freedom, 1), 0.1):
        return False
    return fits(cost, freedom, max(MODES.doubt_p * doubt, MODES.recheck_p))


def unsuspicious(cost: float, freedom: int, gain: float) -> bool:
    """Returns whether contacts raise no suspicion: not all together, nor one of them against the others."""
    return fits(cost, freedom, MODES.recheck_p) and bool(gain < MODES.decisive)


def fits(chi2: float, freedom: int, alarm: float = MODES.alarm) -> bool:
    """Returns whether a sum of squares with that many degrees of freedom is below its 1 - alarm quantile."""
    return bool(chi2 <= chi2_limit(max(freedom, 1), alarm))


@lru_cache(maxsize=1024)
def chi2_limit(freedom: int, alarm: float) -> float:
    """Returns the 1 - alarm quantile of χ² with that many degrees of freedom.

    SciPy has it too, and takes a third of a second to load; the first correction should not wait for that. Found by
    bisection of the survival function, which is a finite sum for a whole number of degrees of freedom (Abramowitz and
    Stegun, 26.4.4 and 26.4.5).
    """

    odd = freedom % 2
    exponents = np.arange(freedom // 2) + 0.5 * odd
    log_gamma = np.array([math.lgamma(m + 1) for m in exponents])

    def survival(chi2: float) -> float:
        half = chi2 / 2
        terms = np.exp(exponents * math.log(half) - half - log_gamma)  # half^m e^-half / Γ(m + 1)
        return float(terms.sum()) + (math.erfc(math.sqrt(half)) if odd else 0.0)

    low, high = 0.0, freedom + 10 * math.sqrt(2 * freedom) + 100.0
    while high - low > 1e-13 * high:
        middle = (low + high) / 2
        if not low < middle < high:
            break
        low, high = (middle, high) if survival(middle) > alarm else (low, middle)
    return (low + high) / 2
