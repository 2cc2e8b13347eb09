"""From minima to an honest answer: information, covariance, open directions, distinct modes, weights.

Information is judged in metres: coordinates (δp, radius δθ), so that a turn counts by what it moves.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from handsight import se3
from handsight._kernels.settings import KNOWN, LEAST_FACTOR, OPEN, SECANT_PASSES, STRIDE
from handsight.checks import Array, Indices
from handsight.correction.estimate import Hypothesis
from handsight.objects import ObjectModel
from handsight.objects.symmetry import nearest

APART = (0.015, np.deg2rad(20.0))
"""Two modes are distinct when further apart than this [m] or turned by more than this [rad]."""
MOST_MODES = 8
ALARM = 1e-3
"""Probability that evidence which fits is called inconsistent."""


def in_metres(information: Array, radius: float) -> Array:
    """Information (..., 6, 6) by (δp, radius δθ) [1/m²]."""
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    return np.asarray(information * scale[:, None] * scale)


def unobservable(touch_information: Array, radius: float, middle_lever: Array) -> Array:
    """(k, 6) orthonormal directions (δp, radius δθ) that the contacts leave open.

    Judged at the object's middle, `middle_lever` (3,) [m] from its origin along the palm's axes: an origin far
    from the object swings by metres where the object itself hardly turns. Expressed at the origin.
    """
    to_origin = np.eye(6)
    to_origin[:3, 3:] = se3.skew(middle_lever)  # δp = δp_middle - δθ × lever
    values, vectors = np.linalg.eigh(in_metres(to_origin.T @ touch_information @ to_origin, radius))
    open_there = vectors[:, values < 1 / (OPEN * radius) ** 2]
    scale = np.array([1.0] * 3 + [radius] * 3)
    at_origin = scale[:, None] * (to_origin @ (open_there / scale[:, None]))
    return np.ascontiguousarray(np.linalg.qr(at_origin)[0].T)


def secant(information: Array, T_mode: Array, cost_at: Callable[[Array], Array], radius: float) -> Array:
    """The information (6, 6) whose ellipsoid the posterior's own cost has, a deviation and a half from a mode.

    At an edge, on a bumpy scan or along a bounded slide the slope of the residuals at the mode tells little
    about a standard deviation away. Along each eigenvector of the information the cost is read on both sides
    at STRIDE deviations, where a Gaussian's has risen by STRIDE²; the eigenvalue is scaled by what it did, again
    where that was more than halving it.
    """
    values, vectors = np.linalg.eigh(in_metres(information, radius))
    known = values > KNOWN * values[-1]
    values, vectors = values[known], vectors[:, known]
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    here = cost_at(T_mode[None])[0]
    going = np.arange(len(values))
    for _ in range(SECANT_PASSES):
        length = STRIDE * np.minimum(1 / np.sqrt(values[going]), radius / 2)
        steps = (vectors[:, going] * length).T * scale
        costs = cost_at(slid(T_mode, np.concatenate([steps, -steps])))
        rise = (costs - here).reshape(2, -1) / (length**2 * values[going])
        factor = rise.clip(LEAST_FACTOR, 1.0).mean(axis=0)
        values[going] *= factor
        going = going[factor <= 0.5]
        if not len(going):
            break
    return np.asarray((vectors * values) @ vectors.T / scale[:, None] / scale)


def slid(T: Array, slides: Array) -> Array:
    """`T` (4, 4) after slides (n, 6) `(s, δθ)`: `exp(δθ) R` and `p + exp(δθ) s`, straight along the object."""
    turn = se3.rotation_exp(slides[:, 3:])
    return se3.compose(turn @ T[:3, :3], T[:3, 3] + (turn @ slides[:, :3, None])[..., 0])


def along_palm_axes(information: Array, radius: float) -> Array:
    """The information (6, 6) by (δp, δθ), to second order, of a posterior that is Gaussian along the object.

    The contacts are linear in a slide `s` along the object's own, turned, axes: `δp = exp(δθ) s ≈ s + δθ × s`.
    Along the palm's axes a long slide with an uncertain turn is therefore an arc, wider than the first order
    says by the covariance of `δθ × s` (Isserlis: tr(Q_k Σ Q_l Σ)/2 for the forms Q of the cross product).
    Deviations count up to the radius: what touches cannot slide further. Unknown directions stay unknown.
    """
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    values, vectors = np.linalg.eigh(in_metres(information, radius))
    known = values > KNOWN * values[-1]
    basis = vectors[:, known]
    variance = 1 / values[known]
    bounded = (basis * np.minimum(variance, radius**2)) @ basis.T * scale[:, None] * scale
    pushed = CROSS @ bounded
    arc = np.zeros((6, 6))
    arc[:3, :3] = np.einsum("kij,lji->kl", pushed, pushed) / 2
    wider = np.diag(variance) + basis.T @ arc @ basis
    return np.asarray(basis @ np.linalg.inv(wider) @ basis.T / scale[:, None] / scale)


def _cross_forms() -> Array:
    """(3, 6, 6) symmetric forms with `(θ × s)_k = ½ ξᵀ Q_k ξ` for ξ = (s, θ)."""
    forms = np.zeros((3, 6, 6))
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        forms[k, 3 + i, j], forms[k, 3 + j, i] = 1.0, -1.0
    return forms + forms.swapaxes(1, 2)


CROSS = _cross_forms()


def complete(information: Array, radius: float, *, blind: bool) -> bool:
    """Whether every direction is known: at all, or, blind, to the object's size."""
    values = np.linalg.eigvalsh(in_metres(information, radius))
    least = 1 / (OPEN * radius) ** 2 if blind else 0.0
    return bool(values[0] > max(KNOWN * values[-1], least))


def covariance(information: Array, radius: float) -> Array:
    """The inverse (6, 6) of an information in which every direction is known."""
    values, vectors = np.linalg.eigh(in_metres(information, radius))
    scale = np.array([1.0] * 3 + [1 / radius] * 3)
    root = scale[:, None] * vectors / np.sqrt(values)
    return np.asarray(root @ root.T)


def log_volume(information: Array, radius: float, *, blind: bool) -> Array:
    """log √det Σ (K,) over the directions known better than the prior: blind, the object's own size."""
    values = np.linalg.eigvalsh(in_metres(information, radius))
    floor = 1 / radius**2 if blind else 1e-9 / radius**2
    return np.asarray(-0.5 * np.log(np.maximum(values, floor)).sum(axis=-1))


def apart(model: ObjectModel, Ts: Array, T: Array) -> tuple[Array, Array]:
    """Shift of the object's middle [m] and turn [rad] from `T` to each of `Ts`, modulo symmetry."""
    equivalent = nearest(model.symmetries, Ts, T, model.radius)
    middle = se3.apply(equivalent, model.center_object[None])[:, 0] - se3.apply(T, model.center_object[None])
    turn = se3.rotation_log(equivalent[:, :3, :3] @ T[:3, :3].T)
    return np.linalg.norm(middle, axis=-1), np.linalg.norm(turn, axis=-1)


def distinct(
    model: ObjectModel, Ts: Array, order: Indices, most: int, limits: tuple[float, float] = APART
) -> list[int]:
    """Indices of `Ts`, in the given order, that are no repeat of an earlier one; at most `most`."""
    if len(order) == 1:
        return [int(order[0])]
    chosen: list[int] = []
    rest = order
    while len(rest) and len(chosen) < most:
        chosen.append(int(rest[0]))
        shift, turn = apart(model, Ts[rest], Ts[rest[0]])
        new = (shift > limits[0]) | (turn > limits[1])
        new[0] = False
        rest = rest[new]
    return chosen


def hypotheses(
    model: ObjectModel,
    Ts: Array,
    informations: Array,
    costs: Array,
    cost_at: Callable[[Array], Array],
    *,
    blind: bool,
) -> tuple[Hypothesis, ...]:
    """Distinct modes with weights exp(-cost/2) √det Σ, best first; `cost_at` gives the cost of poses."""
    log_weight = -costs / 2 + log_volume(informations, model.radius, blind=blind)
    chosen = distinct(model, Ts, np.argsort(-log_weight, kind="stable"), MOST_MODES)
    weight = np.exp(log_weight[chosen] - log_weight[chosen[0]])
    weight /= weight.sum()
    found = []
    for k, share in zip(chosen, weight, strict=True):
        straight = secant(informations[k], Ts[k], cost_at, model.radius)
        information = along_palm_axes(straight, model.radius)
        known = complete(straight, model.radius, blind=blind)
        sigma = covariance(information, model.radius) if known else None
        found.append(Hypothesis(Ts[k], information, sigma, float(share), float(costs[k])))
    return tuple(found)


def fits(chi2: float, freedom: int, alarm: float = ALARM) -> bool:
    """Whether a sum of squares with that many degrees of freedom is below its 1 - alarm quantile."""
    return chi2 <= _limit(max(freedom, 1), alarm)


@lru_cache(maxsize=1024)
def _limit(freedom: int, alarm: float) -> float:
    """The 1 - alarm quantile of χ²."""
    from scipy.special import chdtri

    return float(chdtri(freedom, alarm))
