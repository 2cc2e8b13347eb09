"""Two phases from a start to a mode: nearest samples in 6-D first, then Levenberg-Marquardt on the field.

Every function moves K poses at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight._kernels.settings import MATCH_STEPS, MATCH_TOLERANCE, MAX_TURN, SHORT_STEP, SMALL_STEP
from handsight.checks import Array, Indices, Mask
from handsight.correction.evidence import Evidence, cross

EYE_3, EYE_6 = np.eye(3), np.eye(6)


@dataclass(frozen=True, slots=True)
class Descent:
    """Where K descents ended."""

    Ts_palm_object: Array
    """(K, 4, 4)."""
    cost: Array
    """(K,) sum of squared residuals."""
    iterations: Indices
    """(K,) steps tried."""
    converged: Mask
    """(K,) bool: the last accepted step was small."""

    def taking(self, rows: Indices) -> "Descent":
        """Some of the descents."""
        return Descent(
            self.Ts_palm_object[rows], self.cost[rows], self.iterations[rows], self.converged[rows]
        )

    def joined(self, more: "Descent") -> "Descent":
        """These descents and then the others."""
        return Descent(
            np.concatenate([self.Ts_palm_object, more.Ts_palm_object]),
            np.concatenate([self.cost, more.cost]),
            np.concatenate([self.iterations, more.iterations]),
            np.concatenate([self.converged, more.converged]),
        )


def stacked(terms: Sequence[Evidence], Ts_palm_object: Array) -> tuple[Array, Array]:
    """Residuals (K, r) and derivatives (K, r, 6) by (δp, δθ) of all terms together; r may be 0."""
    parts = [term.linearize(Ts_palm_object) for term in terms]
    if len(parts) == 1:
        return parts[0]
    K = len(Ts_palm_object)
    residuals = np.concatenate([np.empty((K, 0)), *(part[0] for part in parts)], axis=1)
    return residuals, np.concatenate([np.empty((K, 0, 6)), *(part[1] for part in parts)], axis=1)


def normal_equations(residuals: Array, jacobian: Array) -> tuple[Array, Array, Array]:
    """Hessian (K, 6, 6), gradient (K, 6) and cost (K,) of the residuals' sum of squares."""
    transposed = jacobian.swapaxes(-1, -2)
    gradient = (transposed @ residuals[..., None])[..., 0]
    return transposed @ jacobian, gradient, (residuals * residuals).sum(axis=-1)


@dataclass(frozen=True, slots=True)
class Chart:
    """Steps in metres: a shift τ, and a turn ω times `radius`, about `center_palm`.

    About the centroid of the contacts shift and turn hardly disturb each other, and one damping serves both.
    """

    center_palm: Array
    """(3,) [m]."""
    radius: float
    """Of the object [m]."""

    def normal_equations(
        self, terms: Sequence[Evidence], Ts_palm_object: Array
    ) -> tuple[Array, Array, Array]:
        """Hessian (K, 6, 6) and gradient (K, 6) by (τ, radius ω), and cost (K,)."""
        residuals, jacobian = stacked(terms, Ts_palm_object)
        # δp = τ + ω × (p - c), δθ = ω
        D = np.empty((len(Ts_palm_object), 6, 6))
        D[:] = np.diag([1.0] * 3 + [1 / self.radius] * 3)
        D[:, :3, 3:] = se3.skew((self.center_palm - Ts_palm_object[:, :3, 3]) / self.radius)
        return normal_equations(residuals, jacobian @ D)

    def stepped(self, Ts_palm_object: Array, steps: Array) -> Array:
        """The poses (K, 4, 4) after steps (K, 6); the turn by Cayley's map, which needs no sine."""
        half = steps[:, 3:] / (2 * self.radius)
        S = se3.skew(half)
        turn = EYE_3 + (2 / (1 + (half * half).sum(axis=1)))[:, None, None] * (S + S @ S)
        T = Ts_palm_object.copy()
        T[:, :3, 3] -= self.center_palm
        T[:, :3] = turn @ T[:, :3]
        T[:, :3, 3] += self.center_palm + steps[:, :3]
        return T

    def damped_step(self, H: Array, g: Array, damping: Array) -> Array:
        """Levenberg-Marquardt steps (K, 6), their turn at most MAX_TURN; what nothing observes stays."""
        trace = np.einsum("kii->k", H)
        damped = H + ((damping + 1e-12) * trace)[:, None, None] * EYE_6
        steps = -np.linalg.solve(damped, g[..., None])[..., 0]
        turn = np.sqrt((steps[:, 3:] ** 2).sum(axis=1)) / self.radius
        return np.asarray(steps * (MAX_TURN / np.maximum(turn, MAX_TURN))[:, None])


@dataclass(frozen=True, slots=True)
class Samples:
    """The object's surface samples, as phase 1 matches them."""

    points_object: Array
    """(s, 3) [m]."""
    normals_object: Array
    """(s, 3)."""
    normal_weight: float
    """What a unit of normal is worth in the 6-D distance [m]."""
    band: float
    """Tangential distance to the matched sample that costs nothing [m]."""
    sigma_tangential: float
    """Standard deviation of the tangential distance beyond the band [m]."""
    variance_point: float
    """How far the patch that a sample stands for is from the sample's plane [m²]."""
    variance_normal: float
    """Of its normal, per axis [rad²]."""


@dataclass(frozen=True, slots=True)
class Matches:
    """Contacts against their nearest samples, held for one Gauss-Newton step."""

    points_palm: Array
    normals_palm: Array
    weight_point: Array
    """(K or 1, n) one over the standard deviation of the distance [1/m]; 0: not in use."""
    weight_normal: Array
    """(K or 1, n) one over the standard deviation of the normal, per axis [1/rad]."""
    samples: Samples

    def linearize(self, Ts_palm_object: Array) -> tuple[Array, Array]:
        """Residuals (K, 5 n): distance to the sample's plane, normal, and place beyond the sample's band."""
        R = Ts_palm_object[:, :3, :3]
        lever = self.points_palm - Ts_palm_object[:, None, :3, 3]
        best = self.nearest(lever @ R, self.normals_palm @ R)
        normal = self.samples.normals_object[best] @ R.swapaxes(-1, -2)
        offset = lever - self.samples.points_object[best] @ R.swapaxes(-1, -2)
        K, n = best.shape
        residuals, by_pose = np.empty((K, n, 5)), np.zeros((K, n, 5, 6))
        distance = (offset * normal).sum(axis=-1)
        residuals[..., 0] = distance
        by_pose[..., 0, :3] = -normal
        residuals[..., 1:4] = normal - self.normals_palm
        by_pose[..., 1:4, 3:] = -se3.skew(normal)
        aside = offset - distance[..., None] * normal
        reach = np.sqrt((aside * aside).sum(axis=-1))
        residuals[..., 4] = np.maximum(reach - self.samples.band, 0.0)
        beyond = (reach > self.samples.band) / np.maximum(reach, 1e-300)
        by_pose[..., 4, :3] = -aside * beyond[..., None]
        # The derivative by a turn is the lever crossed with the derivative by a shift.
        by_shift = by_pose[..., (0, 4), :3]
        by_pose[..., (0, 4), 3:] = cross(lever[..., None, :], by_shift)
        weights = np.zeros((*self.weight_point.shape, 5))
        weights[..., 0] = self.weight_point
        weights[..., 1:4] = self.weight_normal[..., None]
        weights[..., 4] = (self.weight_point > 0) / self.samples.sigma_tangential
        return (residuals * weights).reshape(K, -1), (by_pose * weights[..., None]).reshape(K, -1, 6)

    def nearest(self, points_object: Array, normals_object: Array) -> Indices:
        """(K, n) index of the sample nearest to each contact in (p, w n)."""
        s = self.samples
        w2 = s.normal_weight**2
        # |a - b|² without |a|², which is the same for every sample.
        table = np.vstack([-2 * s.points_object.T, -2 * w2 * s.normals_object.T])
        size = (s.points_object**2).sum(axis=1)
        contacts = np.concatenate([points_object, normals_object], axis=-1)
        return np.asarray((contacts @ table + size).argmin(axis=-1))


def match(
    matches: Matches, others: Sequence[Evidence], Ts_palm_object: Array, chart: Chart
) -> tuple[Array, Indices]:
    """Phase 1: poses (K, 4, 4) after Gauss-Newton steps on nearest samples, and the steps (K,) each took."""
    T, K = Ts_palm_object, len(Ts_palm_object)
    undamped, taken = np.full(K, 1e-9), np.zeros(K, dtype=np.int64)
    going = np.ones(K, dtype=bool)
    for _ in range(MATCH_STEPS):
        H, g, _ = chart.normal_equations([matches, *others], T)
        steps = chart.damped_step(H, g, undamped)
        T = np.where(going[:, None, None], chart.stepped(T, steps), T)
        taken += going
        going = going & ~(np.abs(steps).max(axis=1) < MATCH_TOLERANCE * chart.radius)
        if not going.any():
            break
    return T, taken


def descend(
    terms: Sequence[Evidence],
    Ts_palm_object: Array,
    chart: Chart,
    *,
    max_iterations: int,
    small_step: float = SMALL_STEP,
) -> Descent:
    """Phase 2: Levenberg-Marquardt from each pose to a minimum of the terms' sum of squares.

    A step is taken only when it lowers the cost; only a step that was taken can end a descent as converged.
    """
    T, K = Ts_palm_object, len(Ts_palm_object)
    H, g, cost = chart.normal_equations(terms, T)
    damping, converged = np.full(K, 1e-6), np.zeros(K, dtype=bool)
    iterations = np.zeros(K, dtype=np.int64)
    for _ in range(max_iterations):
        steps = chart.damped_step(H, g, damping)
        candidate = chart.stepped(T, steps)
        H_new, g_new, cost_new = chart.normal_equations(terms, candidate)
        iterations += ~converged
        length = np.sqrt((steps * (H @ steps[..., None])[..., 0]).sum(axis=1))
        # At rounding level the cost cannot tell better from worse; such a step counts as taken.
        taken = (cost_new <= cost + 1e-12 * (1 + cost)) & ~converged
        # At an edge the cost has a kink: there steps get short long before the slope does.
        short = np.abs(steps).max(axis=1) < SHORT_STEP * chart.radius
        converged = converged | (taken & ((length < small_step) | short))
        if taken.all():
            T, H, g, cost = candidate, H_new, g_new, cost_new
        else:
            T, H = np.where(taken[:, None, None], candidate, T), np.where(taken[:, None, None], H_new, H)
            g, cost = np.where(taken[:, None], g_new, g), np.where(taken, cost_new, cost)
        damping = np.clip(np.where(taken, damping * 0.1, damping * 30), 1e-9, 1e3)
        if converged.all():
            break
    return Descent(T, cost, iterations, converged)
