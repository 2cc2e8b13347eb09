"""Contacts with known truth, made forwards: point, force and local torque to the wrench they cause."""

from dataclasses import dataclass

import numpy as np

from handsight.contact import Ellipsoid, Fingertip

PAPER_TIP = (0.008, 0.008, 0.012)


@dataclass(frozen=True)
class Touches:
    points: np.ndarray
    normals: np.ndarray
    forces: np.ndarray
    forces_normal: np.ndarray
    twists: np.ndarray
    """Local torques about the normals [N m]."""

    @property
    def torques(self) -> np.ndarray:
        """About the tip's centre [N m]."""
        return np.cross(self.points, self.forces) + self.twists[:, None] * self.normals


def inward(points: np.ndarray, semi_axes) -> np.ndarray:
    gradient = points / np.square(semi_axes)
    return -gradient / np.linalg.norm(gradient, axis=1, keepdims=True)


def surface_points(rng, semi_axes, n: int, cap: float | None = None) -> np.ndarray:
    """Uniform by area over the part of the ellipsoid above the cap."""
    a = np.asarray(semi_axes)
    found = np.empty((0, 3))
    lowest = -1.0 if cap is None else cap / a[2]
    while len(found) < n:
        z, turn = rng.uniform(lowest, 1, 4 * n), rng.uniform(0, 2 * np.pi, 4 * n)
        r = np.sqrt(1 - z**2)
        q = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        area = np.linalg.norm(q / a, axis=1)
        found = np.concatenate([found, a * q[rng.random(4 * n) < area * a.min()]])
    return found[:n]


def touches(rng, tip: Fingertip, n: int, *, friction: float = 1.0, twist: float = 2e-3) -> Touches:
    """Random contacts in the tip's cap, within friction; twists N(0, (twist · normal force)²)."""
    points = surface_points(rng, tip.semi_axes, n, tip.cap)
    normals = inward(points, tip.semi_axes)
    sideways = np.cross(normals, rng.normal(size=(n, 3)))
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    push = 10 ** rng.uniform(-0.5, 1.3, n)
    ratio = 0.999 * friction * np.sqrt(rng.random(n))
    forces = push[:, None] * (normals + ratio[:, None] * sideways)
    return Touches(points, normals, forces, push, twist * push * rng.normal(size=n))


def any_tip(rng, **options) -> Ellipsoid:
    """Axis ratios up to 1:4."""
    return Ellipsoid(0.006 * 4 ** rng.uniform(0, 1, 3), min_force=1e-3, **options)
