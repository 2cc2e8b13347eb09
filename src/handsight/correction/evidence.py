"""Residuals of a pose, whitened by their standard deviations, with Jacobians by (δp, δθ).

A term takes poses `T_palm_object` (K, 4, 4) and answers unitless residuals (K, r) and their derivatives
(K, r, 6) by the perturbation of `handsight.se3.moved`. It knows its measurement and nothing of the solver.
Derivations: docs/method.md.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from handsight import se3
from handsight.checks import Array, Mask
from handsight.objects import Field, ObjectModel

EDGE = 0.75
"""Radius of curvature [coarse cells] below which the surface counts as an edge."""
LEAST_ROUGH = (1e-4, 2e-3)
"""No model is better than this: of its place [diameters] and of its normal [rad]."""


class Evidence(Protocol):
    """One source of evidence about the pose."""

    def linearize(self, Ts_palm_object: Array) -> tuple[Array, Array]:
        """Unitless residuals (K, r) and their derivatives (K, r, 6) by (δp, δθ)."""
        ...


@dataclass(frozen=True, slots=True)
class Surface:
    """The object's surface as seen from palm points, for K poses and n points each, along the palm's axes."""

    distance: Array
    """(K, n) signed [m]."""
    gradient: Array
    """(K, n, 3) of the distance by the point."""
    normal: Array
    """(K, n, 3) unit outward."""
    curvature: Array
    """(K, n, 3, 3) derivative of the normal by the point [1/m]."""
    lever: Array
    """(K, n, 3) from the object's origin to the point [m]."""
    points_object: Array
    """(K, n, 3) the points in the object's frame [m]."""


def surface_at(field: Field, points_palm: Array, Ts_palm_object: Array) -> Surface:
    """The surface near each palm point (n, 3), for each pose (K, 4, 4)."""
    R = Ts_palm_object[:, :3, :3]
    Rt = R.transpose(0, 2, 1)
    lever = points_palm - Ts_palm_object[:, None, :3, 3]
    points_object = lever @ R
    values = field.evaluate(points_object.reshape(-1, 3))
    gradient = values.gradient.reshape(lever.shape) @ Rt
    hessian = R[:, None] @ values.hessian.reshape(*lever.shape, 3) @ Rt[:, None]
    slope = np.maximum(np.sqrt((gradient * gradient).sum(axis=-1)), 1e-9)[..., None]
    normal = gradient / slope
    # d(g/|g|) = (I - n nᵀ) dg / |g|
    along = (normal[..., None, :] @ hessian) * normal[..., None]
    curvature = (hessian - along) / slope[..., None]
    distance = values.distance.reshape(lever.shape[:2])
    return Surface(distance, gradient, normal, curvature, lever, points_object)


def contact_distance(surface: Surface) -> tuple[Array, Array]:
    """Distances (K, n, 1) [m] of the contacts to the surface, and derivatives (K, n, 1, 6)."""
    torque = cross(surface.lever, surface.gradient)
    jacobian = -np.concatenate([surface.gradient, torque], axis=-1)
    return surface.distance[..., None], jacobian[..., None, :]


def contact_normal(surface: Surface, normals_palm: Array) -> tuple[Array, Array]:
    """Surface normal minus contact normal (K, n, 3), and derivatives (K, n, 3, 6) with the curvature's part."""
    by_rotation = surface.curvature @ se3.skew(surface.lever) - se3.skew(surface.normal)
    jacobian = np.concatenate([-surface.curvature, by_rotation], axis=-1)
    return surface.normal - normals_palm, jacobian


@dataclass(frozen=True, slots=True)
class Touch:
    """Each contact lies on the surface, and its normal is the surface's."""

    field: Field
    points_palm: Array
    """(n, 3) [m]."""
    normals_palm: Array
    """(n, 3) unit; zeros where `has_normal` is False."""
    has_normal: Mask
    """(n,) bool."""
    covariance: Array
    """(n, 6, 6) of point and normal, the model's own roughness excluded."""
    model: ObjectModel
    """Whose roughness and edges count."""
    used: Mask
    """(K or 1, n) bool: the contacts that count, per pose."""
    seen: tuple[Array, Surface] | None = None
    """The poses at which it was frozen, and the surface there: where a descent looks first."""
    blur: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of a field coarser than the model: of its distance [m] and of its normal [rad]."""
    whitening: Array | None = None
    """(K or 1, n, 4, 4): frozen, so that the costs of one descent compare; None: at each pose its own."""

    def linearize(self, Ts_palm_object: Array) -> tuple[Array, Array]:
        """Residuals (K, 4 n): distance and normal of each contact, whitened together."""
        if self.seen is not None and self.seen[0] is Ts_palm_object:
            surface = self.seen[1]
        else:
            surface = surface_at(self.field, self.points_palm, Ts_palm_object)
        whitening = self.whiten(self.scatter(surface)) if self.whitening is None else self.whitening
        return self.whitened(surface, whitening)

    def density(self, Ts_palm_object: Array) -> tuple[Array, Array, Array]:
        """Residuals and derivatives as `linearize`, and log det (K,) of what whitened them.

        The derivatives are those that say how well the pose is known: beyond edges the faces go on.
        """
        surface = surface_at(self.field, self.points_palm, Ts_palm_object)
        S = self.scatter(surface)
        whitening = self.whiten(S)
        residuals, jacobian = self.whitened(surface, whitening)
        edge = self.edges(surface)
        if edge.any():
            _, jacobian = self.whitened(self.without(surface, edge), whitening)
        return residuals, jacobian, self.log_spread(S)

    def cost(self, Ts_palm_object: Array) -> Array:
        """Squared residuals plus log det (K,) of what whitened them: minus two log of the density."""
        surface = surface_at(self.field, self.points_palm, Ts_palm_object)
        S = self.scatter(surface)
        error = np.concatenate([surface.distance[..., None], surface.normal - self.normals_palm], axis=-1)
        residuals = (self.whiten(S) @ error[..., None])[..., 0]
        return np.asarray((residuals * residuals).sum(axis=(-1, -2)) + self.log_spread(S))

    def log_spread(self, scatter: Array) -> Array:
        """log det (K,) of the residuals' covariance, over the contacts in use."""
        each = np.where(self.has_normal, np.linalg.slogdet(scatter)[1], np.log(scatter[..., 0, 0]))
        return np.asarray((each * self.used).sum(axis=-1))

    def edges(self, surface: Surface) -> Mask:
        """(K, n): where the surface bends as sharply as an edge, and the contact's normal tells the face."""
        sharp = 1 / (EDGE * self.model.coarse.cell)
        bend = (surface.curvature * surface.curvature).sum(axis=(-1, -2))
        return np.asarray((bend > sharp**2) & self.has_normal)

    def without(self, surface: Surface, edge: Mask) -> Surface:
        """The surface with a plane along the contact's normal in place of edges.

        A contact that the prior has pushed to an edge is stopped on one side only; the sharp bend there is a
        wall, not a measurement of the way back.
        """
        at = edge[..., None]
        return replace(
            surface,
            gradient=np.where(at, self.normals_palm, surface.gradient),
            normal=np.where(at, self.normals_palm, surface.normal),
            curvature=np.where(at[..., None], 0.0, surface.curvature),
        )

    def whitened(self, surface: Surface, whitening: Array) -> tuple[Array, Array]:
        """Residuals (K, 4 n) and derivatives (K, 4 n, 6) at a surface already looked up."""
        distance, by_distance = contact_distance(surface)
        normal, by_normal = contact_normal(surface, self.normals_palm)
        residuals = whitening @ np.concatenate([distance, normal], axis=-1)[..., None]
        jacobian = whitening @ np.concatenate([by_distance, by_normal], axis=-2)
        K = len(jacobian)
        return residuals.reshape(K, -1), jacobian.reshape(K, -1, 6)

    def frozen(self, Ts_palm_object: Array) -> "Touch":
        """The same evidence, whitened from now on as it is at these poses."""
        surface = surface_at(self.field, self.points_palm, Ts_palm_object)
        return replace(self, whitening=self.whiten(self.scatter(surface)), seen=(Ts_palm_object, surface))

    def whiten(self, scatter: Array) -> Array:
        """(K, n, 4, 4): the inverse Cholesky factor of `scatter`; zero rows for what does not count."""
        factor = np.linalg.inv(np.linalg.cholesky(scatter))
        rows = np.ones((*self.used.shape, 4), dtype=bool) & self.used[..., None]
        rows[..., 1:] &= self.has_normal[:, None]
        return np.where(rows[..., None], factor, 0.0)

    def scatter(self, surface: Surface) -> Array:
        """Covariance (K, n, 4, 4) of distance and normal residuals.

        First order in the errors of point and normal: a point that slides by its noise over a curved surface
        meets another normal, so the surface's curvature carries point noise into the normal (this is what
        tells a normal near an edge from a normal on a face). Along the normal itself, where a unit vector has
        no first-order noise, the mean tangential variance keeps large angles from going unpunished.
        """
        K, n = surface.distance.shape
        by_point_normal = np.zeros((K, n, 4, 6))
        by_point_normal[..., 0, :3] = surface.gradient
        by_point_normal[..., 1:, :3] = surface.curvature
        by_point_normal[..., 1:, 3:] = -np.eye(3)
        S = by_point_normal @ self.covariance @ by_point_normal.swapaxes(-1, -2)
        by_place = variances(self.model, surface.points_object.reshape(-1, 3)).reshape(K, n, 2)
        S[..., 0, 0] += by_place[..., 0] + self.blur[0] ** 2
        S[..., 1:, 1:] += (by_place[..., 1, None, None] + self.blur[1] ** 2) * np.eye(3)
        tangential = (S[..., 1, 1] + S[..., 2, 2] + S[..., 3, 3]) / 2
        along = self.normals_palm[:, :, None] * self.normals_palm[:, None, :]
        S[..., 1:, 1:] += tangential[..., None, None] * along
        S[..., 1:, 1:] += np.where(self.has_normal, 0.0, 1.0)[:, None, None] * np.eye(3)
        return S


@dataclass(frozen=True, slots=True)
class Outside:
    """No point of the hand lies inside the object."""

    field: Field
    points_palm: Array
    """(m, 3) on the hand's surface [m]."""
    sigma: float
    """Standard deviation of a depth [m]."""

    def linearize(self, Ts_palm_object: Array) -> tuple[Array, Array]:
        """Residuals (K, m): min(0, distance) / sigma."""
        surface = surface_at(self.field, self.points_palm, Ts_palm_object)
        distance, jacobian = contact_distance(surface)
        depth = distance[..., 0]
        inside = depth < 0
        return (
            np.where(inside, depth, 0.0) / self.sigma,
            np.where(inside[..., None], jacobian[..., 0, :], 0.0) / self.sigma,
        )


def cross(a: Array, b: Array) -> Array:
    """a × b along the last axis; `np.cross` costs five times as much on small stacks."""
    return np.asarray((se3.skew(a) @ b[..., None])[..., 0])


def variances(model: ObjectModel, points_object: Array) -> Array:
    """(n, 2) the model's own, of distance [m²] and of normal per axis [rad²]; never below LEAST_ROUGH."""
    least = np.array([(LEAST_ROUGH[0] * model.diameter) ** 2, LEAST_ROUGH[1] ** 2])
    if model.field_error is None:
        return np.broadcast_to(least, (len(points_object), 2))
    return np.asarray(model.field_error.variances(points_object) + least)
