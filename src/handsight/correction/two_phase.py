"""The maximum a posteriori over SE(3): evidence in, distinct modes out.

starts → phase 1 (nearest samples) → phase 2 on the coarse field → phase 2 on the fine field → modes
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handsight._kernels.settings import CANDIDATE_APART, COARSE_STEP, COARSE_STEPS, FINE_STEPS
from handsight.checks import Array, Indices, Mask
from handsight.contact import Contacts
from handsight.correction import modes
from handsight.correction.estimate import PosePrior, Residuals
from handsight.correction.evidence import Evidence, Outside, Touch, cross, surface_at
from handsight.correction.sight import Vision, vision
from handsight.correction.solve import (
    Chart,
    Descent,
    Matches,
    Samples,
    descend,
    match,
    normal_equations,
    stacked,
)
from handsight.errors import InvalidInput
from handsight.objects import Field, ObjectModel

COARSE_BLUR = (0.03, 0.03)
"""How far the smooth field is off on faces: of its distance [cells] and of its normal [rad]."""
MOST_STARTS = 1_000_000
KEPT, KEPT_BLIND = 24, 64
"""Candidates that go on from the coarse field to the fine one."""


@dataclass(frozen=True, slots=True)
class TwoPhase:
    """How handsight's own method runs; the defaults choose themselves from the problem."""

    starts: int | None = None
    """Descents begun from draws of the prior; None: from the prior's width, and more if none fits."""
    reject_outliers: bool = True
    """Look for a contact that is wrong when the contacts do not fit together."""
    compiled: bool = True
    """Run the kernels; False: their twins in plain NumPy, which say what they mean and take a hundred times as long."""

    def __post_init__(self) -> None:
        if self.starts is not None and not (isinstance(self.starts, int) and 1 <= self.starts <= MOST_STARTS):
            raise InvalidInput(
                f"starts: expected a whole number from 1 to {MOST_STARTS}, got {self.starts!r}"
            )


@dataclass(frozen=True)
class Problem:
    """One correction, its inputs checked."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    outside_palm: Array
    """(m, 3), m may be 0."""

    @cached_property
    def center_palm(self) -> Array:
        """(3,) centroid of the contacts."""
        return np.asarray(self.contacts.points_palm.mean(axis=0))

    @cached_property
    def sight(self) -> tuple[Evidence, ...]:
        """Vision as evidence; nothing when blind."""
        if self.vision is None:
            return ()
        root = prior_root(self.vision, self.model.radius)
        return (vision(self.vision.T_palm_object, root, self.model.symmetries),)

    def touch(self, surface: Field, used: Mask) -> Touch:
        """The contacts as evidence; `used` (K or 1, n) says which count for which pose."""
        c, coarse = self.contacts, self.model.coarse
        blur = (COARSE_BLUR[0] * coarse.cell, COARSE_BLUR[1]) if surface is coarse else (0.0, 0.0)
        return Touch(
            surface, c.points_palm, c.normals_palm, c.has_normal, c.covariance, self.model, used, blur=blur
        )

    def held(self) -> list[Evidence]:
        """When blind: that the object's middle is among the contacts, give or take its radius.

        It chooses among poses that fit alike (along a slide, say) and is no knowledge: no information is
        reported for it.
        """
        if self.vision is not None:
            return []
        root = np.zeros((6, 6))
        root[:3, :3] = np.eye(3) / self.model.radius
        return [Vision(self.model.center_object, None, self.center_palm, np.eye(3), root)]

    def hand(self, surface: Field) -> list[Outside]:
        """The hand's points as evidence; nothing where there are none or the object has no inside.

        Their place is as uncertain as the contacts', through the same kinematics, and those of one link are wrong
        together, hence more than that.
        """
        if not len(self.outside_palm) or not self.model.closed:
            return []
        sigma = float(np.median(np.sqrt(np.trace(self.contacts.covariance[:, :3, :3], axis1=1, axis2=2) / 3)))
        sigma = max(sigma, 1e-3 * self.model.diameter)
        return [Outside(surface, self.outside_palm, 1.5 * sigma)]

    def matches(self, used: Mask) -> Matches:
        """The contacts as phase 1 sees them."""
        c, samples = self.contacts, patches(self.model)
        point = np.trace(c.covariance[:, :3, :3], axis1=1, axis2=2) / 3 + samples.variance_point
        normal = np.trace(c.covariance[:, 3:, 3:], axis1=1, axis2=2) / 2 + samples.variance_normal
        weight_normal = np.where(c.has_normal, 1 / np.sqrt(np.maximum(normal, 1e-12)), 0.0)
        weight_point = np.where(used, 1 / np.sqrt(point), 0.0)
        return Matches(
            c.points_palm, c.normals_palm, weight_point, np.where(used, weight_normal, 0.0), samples
        )


def patches(model: ObjectModel) -> Samples:
    """The object's samples, each for the patch around it: on a curved one plane and normal are off by its bend."""
    spacing = model.sample_spacing
    return Samples(
        model.points_object,
        model.normals_object,
        normal_weight=1.3 * model.diameter,
        band=1.6 * spacing,
        sigma_tangential=0.32 * spacing,
        variance_point=(0.02 * spacing) ** 2,
        variance_normal=model.sigma_normal**2,
    )


def prior_root(vision: PosePrior, radius: float) -> Array:
    """`W` (6, 6) with `WᵀW` the inverse of vision's covariance; no deviation below 1e-5 of the radius."""
    scale = np.array([1.0] * 3 + [radius] * 3)
    values, vectors = np.linalg.eigh(vision.covariance * scale[:, None] * scale)
    return np.asarray((vectors / np.sqrt(np.maximum(values, (1e-5 * radius) ** 2))).T * scale)


def solve(problem: Problem, Ts_start: Array, used: Mask) -> tuple[Descent, Mask]:
    """Candidates on the fine field, cheapest first, and which contacts (K, n) count for each.

    `used` is (1, n) for all starts alike or (K, n) for each its own.
    """
    model, sight = problem.model, problem.sight
    chart = Chart(problem.center_palm, model.radius)
    T, steps = match(problem.matches(used), [*sight, *problem.held()], Ts_start, chart)
    terms = [problem.touch(model.coarse, used).frozen(T), *sight, *problem.hand(model.coarse)]
    coarse = descend(terms, T, chart, max_iterations=COARSE_STEPS, small_step=COARSE_STEP)
    keep = survivors(model, coarse, used, KEPT_BLIND if problem.vision is None else KEPT)
    T = coarse.Ts_palm_object[keep]
    used_kept = used[keep] if len(used) > 1 else used
    terms = [problem.touch(model.fine, used_kept).frozen(T), *sight, *problem.hand(model.fine)]
    fine = descend(terms, T, chart, max_iterations=FINE_STEPS)
    fine = replace(fine, iterations=steps[keep] + coarse.iterations[keep] + fine.iterations)
    used_all = np.broadcast_to(used_kept, (len(keep), used.shape[1]))
    if problem.vision is None:
        # Along a slide any place is a minimum: beside where each descent ended, the most likely one.
        likely = descend([*terms, *problem.held()], fine.Ts_palm_object, chart, max_iterations=FINE_STEPS)
        likely = replace(likely, cost=(stacked(terms, likely.Ts_palm_object)[0] ** 2).sum(axis=1))
        fine, used_all = likely.joined(fine), np.concatenate([used_all, used_all])
    order = np.argsort(fine.cost, kind="stable")
    return fine.taking(order), used_all[order]


def survivors(model: ObjectModel, coarse: Descent, used: Mask, most: int) -> Indices:
    """Indices of the descents worth finishing: cheap and no repeats, apart for each set of contacts."""
    order = np.argsort(coarse.cost, kind="stable")
    if len(order) == 1:
        return order
    groups = groups_of(used, order)
    each = max(2, most // len(groups))
    kept = [modes.distinct(model, coarse.Ts_palm_object, g, each, CANDIDATE_APART) for g in groups]
    return np.concatenate([np.asarray(k, dtype=np.int64) for k in kept])


def groups_of(used: Mask, order: Indices) -> list[Indices]:
    """The order split by which contacts count."""
    if len(used) == 1:
        return [order]
    _, group = np.unique(used, axis=0, return_inverse=True)
    return [order[group[order] == k] for k in range(group.max() + 1)]


def gains(problem: Problem, T_palm_object: Array, used: Mask) -> Array:
    """(n,) how much χ² falls, to first order, at a mode when a contact is left out and the pose gives way.

    With a contact's share of Hessian and gradient, H_i and g_i, and its squared residuals: rᵀr + gᵀ (H - H_i)⁻¹ g.
    What a contact at an edge pulls at is beyond the edge: there only its own residuals count.
    """
    fine, T = problem.model.fine, T_palm_object[None]
    information = posterior(problem, T, used)[0][0]
    information = information + 1e-12 * np.trace(information[:3, :3]) * np.eye(6)
    touch = problem.touch(fine, used)
    edge = touch.edges(surface_at(fine, touch.points_palm, T))[0]
    total = np.zeros(len(problem.contacts))
    for i in np.flatnonzero(used[0]):
        alone = np.zeros_like(used)
        alone[0, i] = True
        H, g, square = normal_equations(*problem.touch(fine, alone).density(T)[:2])
        total[i] = square[0]
        if not edge[i]:
            total[i] += g[0] @ np.linalg.solve(information - H[0], g[0])
    return total


def posterior(problem: Problem, Ts: Array, used: Mask) -> tuple[Array, Array, Array, Array]:
    """At poses (K, 4, 4): information (K, 6, 6), that of touch alone, χ² and cost (minus two log density)."""
    fine = problem.model.fine
    residuals, jacobian, log_spread = problem.touch(fine, used).density(Ts)
    by_touch, _, chi2 = normal_equations(residuals, jacobian)
    by_other, _, chi2_other = normal_equations(*stacked(problem.sight, Ts))
    # The hand's points are walls: they cost, but say nothing of the way back.
    chi2_other = chi2_other + (stacked(problem.hand(fine), Ts)[0] ** 2).sum(axis=1)
    unlikely = (stacked(problem.held(), Ts)[0] ** 2).sum(axis=1)
    chi2 = chi2 + chi2_other
    return by_touch + by_other, by_touch, chi2, chi2 + log_spread + unlikely


def cost(problem: Problem, Ts: Array, used: Mask) -> Array:
    """Minus two log of the posterior density (K,) at poses (K, 4, 4), up to a constant."""
    fine = problem.model.fine
    others, _ = stacked([*problem.sight, *problem.hand(fine), *problem.held()], Ts)
    return np.asarray(problem.touch(fine, used).cost(Ts) + (others * others).sum(axis=1))


def freedom(problem: Problem, used: Mask) -> int:
    """Degrees of freedom of the χ² at a mode: rows of evidence less what the pose can take up."""
    rows = int((used * (1 + 2 * problem.contacts.has_normal)).sum())
    return rows if problem.vision is not None else max(rows - 6, 1)


def open_directions(model: ObjectModel, by_touch: Array, T_palm_object: Array) -> Array:
    """(k, 6) directions that touch, whose information this is, leaves open at a pose."""
    return modes.unobservable(by_touch, model.radius, T_palm_object[:3, :3] @ model.center_object)


def residuals(problem: Problem, T_palm_object: Array) -> Residuals:
    """What remains between each contact and the surface at that pose."""
    contacts = problem.contacts
    surface = surface_at(problem.model.fine, contacts.points_palm, T_palm_object[None])
    cosine = (surface.normal[0] * contacts.normals_palm).sum(axis=-1)
    across = cross(surface.normal[0], contacts.normals_palm)
    sine = np.sqrt((across * across).sum(axis=-1))
    angle = np.where(contacts.has_normal, np.arctan2(sine, cosine), np.nan)
    return Residuals(surface.distance[0], angle)
