"""Grasps of any hand: fingertips are moved onto the object from opposite sides, from many random starts.

One finger presses against others. Palm and joints minimise the tips' distances from the object and the forces and
torques that remain where each tip presses along the object's normal (Liu et al. 2021, differentiable force closure),
clear of object and table. Nothing is known of the hand but its file and its rig's fingertips.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from handsight import se3
from handsight.checks import Array
from handsight.hand.surface import body_triangles
from handsight.rig import Rig
from handsight.simulation.hand_in_world import servo_name
from handsight.simulation.motion import Grasp
from handsight.simulation.scene import SimulatedScene
from handsight.simulation.shadow_grasps import GRASP, POSTURE, Body, forces, least_rotation, rests


class FitOptions(NamedTuple):
    """`FitOptions` configure the search of a hand's grasps."""

    samples: int = 2000  # random postures of the hand, by which its opening is measured
    starts: int = 30  # fits of each rest of the object
    drawn: int = 60  # random starts, of which the best is fitted
    steps: int = 40  # of a fit
    soft: float = 0.003  # width over which neighbouring faces share their normals [m]
    points: int = 250  # on the links, that must be clear of object and table
    corners: int = 26  # directions in which the farthest point of each link must be clear, too
    max_left: float = 2.0  # force that may remain unbalanced [N]
    max_lacking: float = 0.5  # mean share of the tips' forces that the balance does not allow


FIT = FitOptions()


class HandFit:
    """A `HandFit` is a rig's hand around an object; `grasps` yields closing motions."""

    def __init__(self, rig: Rig, scene: SimulatedScene, body: Body, seed: int) -> None:
        """Measures how far the hand opens, by random postures."""
        self._hand, self._fingers, self._rng = rig.hand, list(rig.fingers), np.random.default_rng((seed, 20))
        self._parts = [rig.fingers[name] for name in self._fingers]
        self._rests = rests(body)[: GRASP.max_rests]
        self._body = body
        spread, corners = rig.hand.surface(FIT.points, without={part.frame for part in self._parts}), []
        for name in spread.bodies:  # a box touches by its corners first, between which few points are
            vertices = body_triangles(scene.model, scene.model.body(f"hand/{name}").id).reshape(-1, 3)
            corners.append(vertices[np.unique((vertices @ se3.directions(FIT.corners).T).argmax(axis=0))])
        points = np.vstack([spread.points_body, *corners])
        owners = [*spread.body_of, *(k for k, each in enumerate(corners) for _ in each)]
        self._surface = replace(spread, points_body=points, body_of=np.array(owners, dtype=np.int64))
        self._names = tuple(dict.fromkeys((*rig.hand.moving, *self._surface.joints)))
        limits = dict(zip(rig.hand.joint_names, np.clip(rig.hand.limits, -1.5, 1.5), strict=True))
        self._low, self._high = np.array([limits[name] for name in self._names]).T
        servos = (scene.model.actuator(servo_name(name)) for name in self._names)
        self._stiffness = {name: float(s.gainprm[0]) for name, s in zip(self._names, servos, strict=True)}
        self._place = {name: k for k, name in enumerate(rig.hand.tips)}
        postures = self._rng.uniform(self._low, self._high, (FIT.samples, len(self._low)))
        centers = np.array([self._tips(q)[:, :3, 3] for q in postures])
        gaps = np.linalg.norm(centers[:, :, None] - centers[:, None], axis=3)
        self.opening = float(gaps.max()) - 2 * min(float(part.tip.semi_axes.min()) for part in self._parts)
        """Largest distance between two fingertips [m]."""
        numbers = range(len(self._fingers))
        self._sets = [
            (one, *others)
            for one in numbers
            for n in (1, 2, 3)
            for others in combinations([k for k in numbers if k != one], n)
            if n > 1 or len(self._fingers) < 3
        ]

    def grasps(self) -> Iterator[tuple[Grasp | None, str, str]]:
        """Yields grasps with the names of their fingers, the pressing one first, and the reason where there is none.

        Those of a rest are fitted first, and yielded in the order of their cost.
        """
        for R in self._rests:
            self._stand = self._body.turned(R)
            fits = sorted((self._fitted() for _ in range(FIT.starts)), key=lambda fit: fit[0])
            for _, used, R0, x in fits:
                one, *others = (self._fingers[k] for k in used)
                yield *self._grasp(used, R0, x, R), f"{one} against {', '.join(others)}"

    def _fitted(self) -> tuple[float, tuple[int, ...], Array, Array]:
        """Returns cost, fingers, first rotation (3, 3) and posture of the best of some random starts, fitted."""
        drawn = list[tuple[float, Array, Array]]()
        used = self._sets[self._rng.integers(len(self._sets))]
        for _ in range(FIT.drawn):
            q = self._rng.uniform(0.8 * self._low + 0.2 * self._high, 0.2 * self._low + 0.8 * self._high)
            at = self._tips(q)[:, :3, 3]
            grip = (at[used[0]] + at[list(used[1:])].mean(axis=0)) / 2
            positions = dict(zip(self._names, q.tolist(), strict=True))
            links = self._surface.points_palm(positions)
            # The hand's links are beside the object or above it.
            away = links.mean(axis=0) - grip if len(links) else -grip
            turn, rise, roll = self._rng.uniform((0, 0, -np.pi), (2 * np.pi, np.pi / 2, np.pi))
            goal = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
            R0 = se3.rotation_exp(roll * goal) @ least_rotation(away, goal)
            middle = self._stand.mass + self._rng.uniform(-0.2, 0.2, 3) * np.ptp(self._stand.vertices, axis=0)
            x = np.concatenate([middle - R0 @ grip, np.zeros(3), q])
            cost = float(np.square(self._residuals(x, used, R0, q)).sum())
            drawn.append((cost, R0, x))
        _, R0, x = min(drawn, key=lambda start: start[0])
        q = x[6:]
        low, high = np.r_[np.full(6, -np.inf), self._low], np.r_[np.full(6, np.inf), self._high]
        found = least_squares(
            self._residuals, np.clip(x, low + 1e-4, high - 1e-4), bounds=(low, high), args=(used, R0, q),
            x_scale=np.repeat([0.1, 0.5], [6, len(q)]), max_nfev=FIT.steps, ftol=1e-3, xtol=1e-4,
        )  # fmt: skip
        return float(found.cost), used, R0, found.x

    def _grasp(self, used: tuple[int, ...], R0: Array, x: Array, R: Array) -> tuple[Grasp | None, str]:
        """Returns the closing motion that ends in a posture, or None and the reason."""
        points, _, _ = self._contacts(x, used, R0)
        heights = points @ self._stand.normals.T - self._stand.offsets
        distances, normals = heights.max(axis=1), self._stand.normals[heights.argmax(axis=1)]
        if np.abs(distances).max() > POSTURE.max_miss:
            return None, "out of reach"
        if self._clearance(x, used, R0).min(initial=np.inf) < POSTURE.min_clearance:
            return None, "no room for the hand"
        wish = np.full(len(used), GRASP.thumb_force / (len(used) - 1))
        wish[0] = GRASP.thumb_force
        pressing, left = forces(points, normals, wish)
        lacking = 1 - np.minimum(np.linalg.norm(pressing, axis=1) / wish, 1.0)
        if left > FIT.max_left or lacking.mean() > FIT.max_lacking:
            return None, "no balance"
        q, T_world_palm = x[6:], se3.compose(se3.rotation_exp(x[3:6]) @ R0, x[:3])
        positions = dict(zip(self._names, q.tolist(), strict=True))
        T_palm_world, pose = se3.inverse(T_world_palm), self._hand.kinematics(positions)
        rows = [self._place[self._fingers[k]] for k in used]
        J = pose.jacobians(se3.apply(T_palm_world, points), rows)[:, :3]
        torques = np.einsum("kij,ki->j", J, pressing @ T_world_palm[:3, :3])
        of_joint = dict(zip(pose.moving_joints, torques.tolist(), strict=True))
        closed = {name: p + of_joint.get(name, 0.0) / self._stiffness[name] for name, p in positions.items()}
        opened = least_squares(
            lambda joints: self._residuals(np.r_[x[:6], joints], used, R0, q, POSTURE.tip_clearance),
            np.clip(q, self._low + 1e-4, self._high - 1e-4),
            bounds=(self._low, self._high), max_nfev=FIT.steps, ftol=1e-3, xtol=1e-4,
        ).x  # fmt: skip
        height = float(self._stand.middle[2])
        T_world_middle = se3.compose(R, np.array([0.0, 0.0, height]))
        opening = dict(zip(self._names, opened.tolist(), strict=True))
        return Grasp(T_palm_world @ T_world_middle, opening, closed, height, T_world_palm[:3, :3]), ""

    def _tips(self, q: Array) -> Array:
        """Returns T_palm_surface (n, 4, 4) of the fingers' tips."""
        Ts = self._hand.Ts_palm_tip(dict(zip(self._names, q.tolist(), strict=True)))
        parts = zip(self._fingers, self._parts, strict=True)
        return np.array([Ts[self._place[name]] @ part.T_frame_surface for name, part in parts])

    def _distances(self, points: Array) -> tuple[Array, Array]:
        """Returns distances (n,) of points from the standing object's planes [m], and normals (n, 3), blended."""
        heights = points @ self._stand.normals.T - self._stand.offsets
        most = heights.max(axis=1)
        # Triangles of one side count by their area, so that how a side is cut does not matter.
        weights = self._stand.areas * np.exp((heights - most[:, None]) / FIT.soft)
        normals = weights @ self._stand.normals
        return most, normals / np.linalg.norm(normals, axis=1)[:, None]

    def _contacts(self, x: Array, used: tuple[int, ...], R0: Array) -> tuple[Array, Array, Array]:
        """Returns the tips' points (k, 3) that face the object, its normals (k, 3), depths below the caps (k,) [m]."""
        T = se3.compose(se3.rotation_exp(x[3:6]) @ R0, x[:3]) @ self._tips(x[6:])[list(used)]
        _, normals = self._distances(T[:, :3, 3])
        towards = -np.einsum("kij,ki->kj", T[:, :3, :3], normals)
        semi = np.array([self._parts[k].tip.semi_axes for k in used])
        at = semi**2 * towards / np.linalg.norm(semi * towards, axis=1)[:, None]
        caps = np.array([self._parts[k].tip.cap or 0.0 for k in used])
        return T[:, :3, 3] + np.einsum("kij,kj->ki", T[:, :3, :3], at), normals, caps + 0.003 - at[:, 2]

    def _clearance(self, x: Array, used: tuple[int, ...], R0: Array) -> Array:
        """Returns how far links and unused tips are from the object, all from the table, tips from each other [m]."""
        T = se3.compose(se3.rotation_exp(x[3:6]) @ R0, x[:3])
        links = se3.apply(T, self._surface.points_palm(dict(zip(self._names, x[6:].tolist(), strict=True))))
        tips = se3.apply(T, self._tips(x[6:])[:, :3, 3])
        radii = np.array([part.tip.semi_axes.max() for part in self._parts])
        others = [k for k in range(len(tips)) if k not in used]
        near = self._distances(np.vstack([links, tips[others]]))[0]
        near[len(links) :] -= radii[others]
        one, other = np.triu_indices(len(tips), 1)
        between = np.linalg.norm(tips[one] - tips[other], axis=1) - radii[one] - radii[other]
        return np.concatenate([near, links[:, 2], tips[:, 2] - radii, between])

    def _residuals(self, x: Array, used: tuple[int, ...], R0: Array, q: Array, away: float = 0.0) -> Array:
        """Returns the errors of a posture, weighted; its tips should be at distance `away` from the object [m]."""
        points, normals, below = self._contacts(x, used, R0)
        distances, _ = self._distances(points)
        share = np.full(len(used), 1.0 / (len(used) - 1))
        share[0] = 1.0
        pressing = share[:, None] * normals
        torque = np.cross(points - self._stand.mass, pressing).sum(axis=0) / GRASP.lever
        lacking = np.minimum(self._clearance(x, used, R0) - POSTURE.link_clearance, 0.0) / 0.003
        parts = [0.1 * (x[6:] - q), (distances - away) / 0.001, np.maximum(below, 0) / 0.003, lacking]
        return np.concatenate(parts if away else [*parts, 4 * pressing.sum(axis=0), 4 * torque])
