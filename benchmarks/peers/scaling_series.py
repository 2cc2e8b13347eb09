"""Scaling Series (Petrovskaya and Khatib; the paper's [5]): blind localisation by annealed, refined particles.

From a region that surely holds the pose: cover it evenly with particles, M for each ball of radius δ; weigh them by the
measurements made soft by the temperature τ = (δ/δ*)²; drop the unlikely; go on in the balls around the others with δ
shrunk so that a ball's volume halves, until δ = δ*. The measurement model is the published one: distance to the surface
and angle of the normal at the nearest point, each by its sigma. Distances come from the object model's own field, so
that both methods look at the surface at the same price; all else is vectorised NumPy. A ball is one of (δp, radius δθ).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

import handsight as hs
from benchmarks.workload import Problem
from handsight import se3

ZOOM = 2 ** (-1 / 6)


@dataclass
class ScalingSeries:
    """Blind: contacts and normals, no prior."""

    first: float = 0.45
    """δ at the start, in radii of the object."""
    last: float = 0.03
    """δ*, in radii of the object."""
    per_ball: int = 6
    """M."""
    keep: float = 1e-3
    """Particles less likely than this part of the best are dropped."""
    most: int = 20_000
    """Particles at one scale; more are thinned out at random."""
    seed: int = 0
    name = "Scaling Series"
    uses_normals = True
    uses_prior = False

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model is all."""

    def solve(self, problem: Problem, count: int = 8) -> np.ndarray:
        """Up to `count` poses (k, 4, 4) that differ by 15 mm or 20 degrees, most likely first."""
        rng = np.random.default_rng(self.seed)
        radius = problem.model.radius
        delta, last = self.first * radius, self.last * radius
        Ts = self._everywhere(problem, delta, rng)
        while True:
            cost = self._cost(problem, Ts) / (delta / last) ** 2
            likely = cost < cost.min() - 2 * np.log(self.keep)
            Ts, cost = Ts[likely], cost[likely]
            if delta <= last:
                return distinct(Ts, cost, radius, count)
            delta = max(delta * ZOOM, last)
            Ts = self._cover(Ts, delta, radius, rng)

    def _everywhere(self, problem: Problem, delta: float, rng: np.random.Generator) -> np.ndarray:
        """Particles over all rotations and all places of the object's middle within its radius of the contacts."""
        radius = problem.model.radius
        volume = (4 / 3 * np.pi * radius**3) * (8 * np.pi**2 * radius**3)
        ball = np.pi**3 / 6 * delta**6
        n = min(int(self.per_ball * volume / ball), 5 * self.most)
        direction = rng.normal(size=(n, 3))
        direction *= (rng.uniform(size=n) ** (1 / 3) / np.linalg.norm(direction, axis=1))[:, None]
        middle = problem.contacts.points_palm.mean(axis=0) + radius * direction
        Rs = se3.rotation_from_quaternion(rng.normal(size=(n, 4)))
        return se3.compose(Rs, middle - Rs @ problem.model.center_object)

    def _cover(self, Ts: np.ndarray, delta: float, radius: float, rng: np.random.Generator) -> np.ndarray:
        """M draws in the ball around each particle, those in several balls thinned to an even density."""
        if len(Ts) * self.per_ball > self.most:
            Ts = Ts[rng.permutation(len(Ts))[: self.most // self.per_ball]]
        base = np.repeat(Ts, self.per_ball, axis=0)
        step = rng.normal(size=(len(base), 6))
        step *= (delta * rng.uniform(size=len(base)) ** (1 / 6) / np.linalg.norm(step, axis=1))[:, None]
        drawn = se3.moved(base, step / np.repeat([1.0, radius], 3))
        tree = cKDTree(_embedded(Ts, radius))
        balls = tree.query_ball_point(_embedded(drawn, radius), delta, return_length=True)
        return drawn[rng.uniform(size=len(drawn)) * np.maximum(balls, 1) < 1]

    def _cost(self, problem: Problem, Ts: np.ndarray) -> np.ndarray:
        """The sum of squared, whitened errors (k,)."""
        contacts, model = problem.contacts, problem.model
        Rs = Ts[:, :3, :3]
        points = (contacts.points_palm - Ts[:, None, :3, 3]) @ Rs
        values = model.fine.evaluate(points.reshape(-1, 3))
        normals = values.gradient.reshape(points.shape)
        normals = normals / np.linalg.norm(normals, axis=2, keepdims=True)
        cosine = np.clip((normals * (contacts.normals_palm @ Rs)).sum(axis=2), -1, 1)
        variances = np.diagonal(contacts.covariance, axis1=1, axis2=2)
        distance = values.distance.reshape(points.shape[:2]) ** 2 / variances[:, 0]
        return (distance + np.arccos(cosine) ** 2 / (variances[:, 3:].sum(axis=1) / 2)).sum(axis=1)


def _embedded(Ts: np.ndarray, radius: float) -> np.ndarray:
    """(k, 12) places where near poses are about as far apart as (δp, radius δθ) is long."""
    return np.hstack([Ts[:, :3, 3], radius / np.sqrt(2) * Ts[:, :3, :3].reshape(-1, 9)])


def distinct(Ts: np.ndarray, cost: np.ndarray, radius: float, count: int) -> np.ndarray:
    """The cheapest poses that are apart from all cheaper ones."""
    left = np.argsort(cost)
    kept: list[int] = []
    while len(left) and len(kept) < count:
        kept.append(int(left[0]))
        delta = se3.difference(Ts[left], Ts[left[0]])
        near = np.linalg.norm(delta[:, :3], axis=1) < 0.015
        left = left[~(near & (np.linalg.norm(delta[:, 3:], axis=1) < np.deg2rad(20)))]
    return Ts[kept]
