"""Tests on modes: whether two are distinct, whether the evidence fits at one, and whether a better one may exist."""

import math
from functools import lru_cache

import numpy as np

from handsight import se3
from handsight._compiled.records import GRID, SHEET
from handsight.checks import Array, Indices
from handsight.correction.kernels.search_options import ACCEPTANCE
from handsight.objects import ObjectModel

SAME_MODE = (0.015, float(np.deg2rad(20)))
"""Two modes are distinct when they differ by more than this shift [m] or by more than this turn [rad]."""


MAX_MODES = 8  # modes that are reported
MAX_MINIMA = 16  # minima that are parts of modes


def in_metres(information: Array, radius: float) -> Array:
    """Returns information (..., 6, 6) about (δp, δθ) as information about (δp, radius · δθ) [1/m²]."""
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    return np.asarray(information * scale[:, None] * scale)


def pose_distances(model: ObjectModel, Ts: Array, T: Array) -> tuple[Array, Array]:
    """Returns the shift of the object's center [m] and the turn [rad] from a pose `T` (4, 4) to each of `Ts` (n, 4, 4),
    modulo symmetry: both (n,)."""
    equivalent = model.nearest(Ts, T)
    center = model.center_object[None]
    shift = se3.apply(equivalent, center)[:, 0] - se3.apply(T, center)
    turn = se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)
    return np.linalg.norm(shift, axis=-1), np.linalg.norm(turn, axis=-1)


def apart(model: ObjectModel, Ts: Array, T: Array, evidence: str) -> str:
    """Returns how far poses `Ts` (n, 4, 4) that some evidence explains as well are from the likeliest one `T` (4, 4),
    for a person; empty where there are none."""
    if not len(Ts):
        return ""
    shift, turn = pose_distances(model, Ts, T)
    count = {1: "two", 2: "three", 3: "four"}.get(len(Ts), "several")
    return f"{count} poses explain the {evidence}: {1e3 * shift.max():.0f} mm, {np.rad2deg(turn.max()):.0f}° apart"


def distinct(
    model: ObjectModel, Ts: Array, order: Indices, most: int, limits: tuple[float, float] = SAME_MODE
) -> list[int]:
    """Returns the indices of at most `most` poses `Ts` (n, 4, 4), in the given order, each distinct from those before.

    `limits`: the shift [m] and the turn [rad] up to which two poses are the same, modulo any symmetry. `solve.distinct`
    uses a kernel instead for the symmetries that kernels know.
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


def several_minima(model: ObjectModel, rows: int, contacts: int) -> bool:
    """Returns whether so few rows of evidence, from so many contacts, may have several minima: on a surface that is
    bent in more than one way, unlike that of a box, a cylinder or a sphere."""
    most = ACCEPTANCE.few_contacts
    few = rows <= ACCEPTANCE.few_rows or (contacts <= most and rows <= 3 * most)
    return few and has_detail(model)


def has_detail(model: ObjectModel) -> bool:
    """Returns whether a surface may be bent in more than one way, as it is a grid."""
    return model.record.model[0]["fine"]["kind"] in (GRID, SHEET)


def fits(chi2: float, freedom: int, alarm: float = ACCEPTANCE.alarm) -> bool:
    """Returns whether a sum of squares passes the χ² test of level `alarm`, with `freedom` degrees of freedom."""
    return bool(chi2 <= chi2_limit(max(freedom, 1), alarm))


def chi2_survival(chi2: float, freedom: int) -> float:
    """Returns the probability that χ² with `freedom` degrees of freedom is larger.

    SciPy's would add a third of a second of import to the first correction. For whole degrees of freedom it is a finite
    sum (Abramowitz and Stegun, 26.4.4 and 26.4.5).
    """
    if not chi2 > 0:
        return 1.0
    half = chi2 / 2
    odd = freedom % 2
    exponents = np.arange(freedom // 2) + 0.5 * odd
    # log Γ(m + 1), each from the one before.
    log_gamma = math.lgamma(0.5 * odd + 1) + np.cumsum(np.log(np.where(exponents < 1, 1.0, exponents)))
    terms = np.exp(exponents * math.log(half) - half - log_gamma)  # half^m e^-half / Γ(m + 1)
    return float(terms.sum()) + (math.erfc(math.sqrt(half)) if odd else 0.0)


@lru_cache(maxsize=1024)
def chi2_limit(freedom: int, alarm: float) -> float:
    """Returns the 1 - alarm quantile of χ² with `freedom` degrees of freedom.

    By Newton's steps on the logarithm of the probability, which is concave; a step out of the bracket halves it.
    """
    low = 0.0
    high = freedom + 10 * math.sqrt(2 * freedom) + 100
    x = float(freedom)
    log_gamma = math.lgamma(freedom / 2)
    for _ in range(100):
        survival = chi2_survival(x, freedom)
        low, high = (x, high) if survival > alarm else (low, x)
        density = 0.5 * math.exp((freedom / 2 - 1) * math.log(x / 2) - x / 2 - log_gamma)
        step = math.log(max(survival, 1e-300) / alarm) * survival / max(density, 1e-300)
        following = x + step if low < x + step < high else (low + high) / 2
        if abs(following - x) <= 1e-13 * x:
            break
        x = following
    return x
