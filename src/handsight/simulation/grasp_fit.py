"""Grasps of any hand: fingertips are moved onto the object from opposite sides, from many random starts.

One finger presses against others. Palm and joints minimise the tips' distances from the object and the forces and
torques that remain where each tip presses along the object's normal (Liu et al. 2021, differentiable force closure),
clear of object and table, as MuJoCo measures it. The targets of the servos then give the forces.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import least_squares

from handsight import se3
from handsight.checks import Array, Indices
from handsight.simulation.grasped_body import (
    face_offsets,
    least_rotation,
    rests,
    standing,
)
from handsight.simulation.hand_in_world import Follower, servo_name
from handsight.simulation.motion import Grasp
from handsight.simulation.scene import SimulatedScene, mujoco_module, rows

if TYPE_CHECKING:
    from trimesh import Trimesh

KNOWN = (4, 4, 8)
"""Of each rest of the object: groups of fits, of which the best is tried first; fits of a group; and random starts, of
which the best is fitted. For a hand whose relaxed posture is known."""
UNKNOWN = (1, 30, 30)
"""The same for other hands."""
STEPS = 30
"""Of a fit."""
SOFT = 0.003
"""Width over which neighbouring faces share their normals [m]."""
PRESS = 6.0
"""Of the finger that presses against others [N]."""
LEVER = 0.04
"""Arm at which a torque counts as much as a force [m]."""
THIN = 0.036
"""Width of a thin object [m], which rolls away sooner and is pressed half as hard."""
TIP_CLEARANCE = 0.022
"""Of the open tips from the object [m]."""
LINK_CLEARANCE = 0.006
"""Of links and unused tips from object and table that is aimed at [m]."""
MIN_CLEARANCE = 0.0005
"""Smallest clearance that is accepted [m]."""
MAX_MISS = 0.002
"""Distance of a tip from the object that is accepted [m]."""
MAX_UNBALANCED = 4
"""Of what remains where tips press along the normals, as weighted in a fit, that is accepted: friction bears it."""
LARGEST_TURN = 1.5
"""Of a joint from its zero, where its file allows more [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Fingers, and a posture of the hand from which it is moved onto the object.

    A posture (6 + n,) is the palm's position in the world [m], its rotation from `R_world_palm` [rad], and the joints.
    """

    used: Indices  # numbers of the fingers, the pressing one first
    R_world_palm: Array  # (3, 3)
    posture: Array


@dataclass(frozen=True, slots=True, eq=False)
class TipsAtObject:
    """Where the used tips face the object in a posture, in the world, and how that depends on the posture."""

    points: Array  # (k, 3) on the tips [m]
    normals: Array  # (k, 3) outward, of the object there
    pads: Array  # (k, 3) the directions of the tips' pads
    by_point: Array  # (k, 3, 6 + n) derivatives of points that are fixed on the tips
    by_turn: Array  # (k, 3, 6 + n) derivatives of the tips' rotations
    by_normal: Array  # (k, 3, 6 + n)


class HandFit:
    """A hand around an object; `grasps` yields closing motions."""

    def __init__(self, scene: SimulatedScene, body: "Trimesh", seed: int) -> None:
        """Takes what moves, presses and must stay clear from the scene."""
        model = self._model = scene.model
        self._mujoco = mujoco_module()
        self._data: Any = self._mujoco.MjData(model)
        self._hand = hand = scene.hand
        self._body = body
        self._middle = scene.bounds_object.mean(axis=0)
        self._rng = np.random.default_rng((seed, 20))
        joints = [model.joint(name).id for name in hand.grasping]
        limited = model.jnt_limited[joints, None].astype(bool)
        limits = np.where(limited, model.jnt_range[joints], [-np.inf, np.inf])
        self._low, self._high = np.clip(limits, -LARGEST_TURN, LARGEST_TURN).T
        self._joint_places = model.jnt_qposadr[joints]
        self._dofs = model.jnt_dofadr[joints]
        self._leads = [(name, of, of.law.deriv()) for name, of in hand.followers.items()]
        self._stiffness = np.array([model.actuator(servo_name(name)).gainprm[0] for name in hand.grasping])
        parts = hand.tips.values()
        self._semi_axes = np.array([part.semi_axes for part in parts])
        self._pads = np.array([part.pad for part in parts])
        self._pad_cosines = np.array([part.pad_cosine for part in parts])
        tips = {finger: model.geom(f"{finger}_tip").id for finger in hand.tips}
        self._tips = np.array(list(tips.values()))
        self._object = model.geom("object").id
        self._table = model.geom("table").id
        touching = np.flatnonzero(model.geom_contype & 1)
        self._neighbours = [(tips[one], tips[other]) for one, other in hand.neighbours]
        self._links = np.setdiff1d(touching, [*self._tips, self._object])

    def opening(self) -> float:
        """Returns the largest distance between two fingertips, by random postures [m]."""
        most = 0.0
        for joints in self._rng.uniform(self._low, self._high, (2000, len(self._low))):
            at = self._tips_at(joints)
            most = max(most, np.linalg.norm(at[:, None] - at, axis=2).max())
        return float(most - 2 * self._semi_axes.min())

    def _tips_at(self, joints: Array) -> Array:
        """Returns the middles (k, 3) of the tips at joints, the palm at the origin."""
        self._place(np.concatenate([np.zeros(6), joints]), np.eye(3))
        return np.asarray(self._data.geom_xpos[self._tips])

    def grasps(self) -> Iterator[tuple[Grasp | None, str, str]]:
        """Yields grasps, the reason where there is none, and the names of the fingers, the pressing one first."""
        fingers = list(self._hand.tips)
        groups, fits, drawn = KNOWN if self._hand.relaxed else UNKNOWN
        for R in rests(self._body):
            self._stand(R)
            for _ in range(groups):
                group = sorted((self._fitted(drawn) for _ in range(fits)), key=lambda fit: fit[0])
                for _, start, posture in group:
                    pressing, *others = (fingers[k] for k in start.used)
                    yield *self._grasp(start, posture, R), f"{pressing} against {', '.join(others)}"

    def _stand(self, R: Array) -> None:
        """Puts the object on the table, turned by R (3, 3)."""
        body = standing(self._body, R)
        self._normals = body.face_normals
        self._offsets = face_offsets(body)
        self._areas = body.area_faces
        self._mass = body.center_mass
        self._size = np.ptp(body.vertices, axis=0)
        self._height = float(body.bounds[:, 2].mean())
        T_world_object = se3.compose(R, np.array([0, 0, self._height]) - R @ self._middle)
        self._data.joint("object").qpos[:] = rows(T_world_object)

    def _fitted(self, drawn: int) -> tuple[float, Start, Array]:
        """Returns the cost of the best of some random starts once it is fitted, less for more fingers; the start, and
        the posture."""
        grips = self._hand.grips
        used = np.array(grips[int(self._rng.integers(len(grips)))])
        starts = [self._start(used) for _ in range(drawn)]
        start = min(starts, key=lambda start: np.square(self._linear(start.posture, start)[0]).sum())
        cost, posture = self._solved(start.posture, start)
        return cost - 3 * len(used), start, posture

    def _start(self, used: Indices) -> Start:
        """Returns a random posture in which the object is between the tips, and links beside or above it."""
        middle = (self._low + self._high) / 2
        half = 0.3 * (self._high - self._low)
        if self._hand.relaxed:
            middle = np.array([self._hand.relaxed.get(name, 0.0) for name in self._hand.grasping])
            half = np.full(len(middle), 0.4)  # [rad]
        joints = np.clip(self._rng.uniform(middle - half, middle + half), self._low, self._high)
        tips = self._tips_at(joints)
        grip = (tips[used[0]] + tips[used[1:]].mean(axis=0)) / 2
        links = np.vstack([np.zeros(3), self._data.geom_xpos[self._links]])
        turn, rise, roll = self._rng.uniform((0, 0, -np.pi), (2 * np.pi, np.pi / 2, np.pi))
        x, y = np.cos(rise) * np.array([np.cos(turn), np.sin(turn)])
        away = np.array([x, y, np.sin(rise)])
        R = se3.rotation_exp(roll * away) @ least_rotation(links.mean(axis=0) - grip, away)
        middle_object = self._mass + self._rng.uniform(-0.2, 0.2, 3) * self._size
        posture = np.concatenate([middle_object - R @ grip, np.zeros(3), joints])
        return Start(used, R, posture)

    def _solved(self, posture: Array, start: Start, away: float = 0.0) -> tuple[float, Array]:
        """Returns cost and posture after the fit. Where tips are to be `away` from the object [m], the palm stays."""
        first = 6 if away else 0  # of the numbers that are free
        of_palm = np.full(6, np.inf)
        low = np.concatenate([-of_palm, self._low])[first:]
        high = np.concatenate([of_palm, self._high])[first:]

        def linear(free: Array) -> tuple[Array, Array]:
            return self._linear(np.concatenate([posture[:first], free]), start, away)

        found = least_squares(
            lambda free: linear(free)[0],
            np.clip(posture[first:], low + 1e-4, high - 1e-4),
            lambda free: linear(free)[1][:, first:],
            bounds=(low, high),
            x_scale=np.repeat([0.1, 0.5], [6, len(self._low)])[first:],
            max_nfev=STEPS,
            ftol=1e-3,
            xtol=1e-4,
        )
        return float(found.cost), np.concatenate([posture[:first], found.x])

    def _grasp(self, start: Start, posture: Array, R_world_object: Array) -> tuple[Grasp | None, str]:
        """Returns the closing motion that ends in a posture, or None and the reason."""
        self._place(posture, start.R_world_palm)
        at = self._tips_at_object(posture, start.used)
        if np.abs(self._distances(at.points)).max() > MAX_MISS:
            return None, "out of reach"
        if any(distance < MIN_CLEARANCE for _, _, distance, _ in self._clearances(start.used)):
            return None, "no room for the hand"
        width = np.linalg.norm(at.points[1:].mean(axis=0) - at.points[0])
        press = PRESS / 2 if width < THIN else PRESS
        unbalanced, _ = self._unbalanced(at)
        if np.linalg.norm(unbalanced) > MAX_UNBALANCED:
            return None, "no balance"
        pressing = -press * shares(len(at.points))[:, None] * at.normals
        # The servos' targets are off the joints by the torques of the forces.
        torques = np.einsum("kj,kjn->n", pressing, at.by_point)
        closed = posture[6:] + torques[6:] / self._stiffness
        R_world_palm = se3.rotation_exp(posture[3:6]) @ start.R_world_palm
        T_world_palm = se3.compose(R_world_palm, posture[:3])
        T_world_middle = se3.compose(R_world_object, np.array([0, 0, self._height]))
        _, opened = self._solved(posture, start, TIP_CLEARANCE)
        grasp = Grasp(
            T_palm_middle=se3.inverse(T_world_palm) @ T_world_middle,
            opening=dict(zip(self._hand.grasping, opened[6:].tolist(), strict=True)),
            closed=dict(zip(self._hand.grasping, closed.tolist(), strict=True)),
            height=self._height,
            R_world_palm=R_world_palm,
        )
        return grasp, ""

    def _place(self, posture: Array, R_world_palm: Array) -> None:
        """Places the hand in a posture."""
        angles = self._data.qpos
        angles[self._joint_places] = posture[6:]
        for name, of, _ in self._leads:
            self._data.joint(name).qpos[:] = of.position(self._lead(of))
        T_world_palm = se3.compose(se3.rotation_exp(posture[3:6]) @ R_world_palm, posture[:3])
        T_world_mount = T_world_palm @ se3.inverse(self._hand.T_mount_palm)
        self._data.joint("mount").qpos[:] = rows(T_world_mount)
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_comPos(self._model, self._data)

    def _lead(self, of: Follower) -> float:
        """Returns the position of the joint that another one follows, 0 where there is none."""
        return float(self._data.joint(of.leader).qpos[0]) if of.leader else 0.0

    def _moves(self, geom: int, point: Array, posture: Array) -> Array:
        """Returns the derivatives (6, 6 + n) of the point (3,) of a geom, and of its rotation, by the posture."""
        model = self._model
        by_joint = np.zeros((6, model.nv))
        body = model.geom_bodyid[geom]
        self._mujoco.mj_jac(model, self._data, by_joint[:3], by_joint[3:], point, body)
        for name, of, slope in self._leads:
            if of.leader:
                own = by_joint[:, model.joint(name).dofadr[0]]
                by_joint[:, model.joint(of.leader).dofadr[0]] += slope(self._lead(of)) * own
        found = np.zeros((6, len(posture)))
        found[:, 6:] = by_joint[:, self._dofs]
        # By a small rotation before that of the posture, to first order in the latter.
        found[3:, 3:6] = np.eye(3) + se3.skew(posture[3:6]) / 2
        found[:3, :3] = np.eye(3)
        found[:3, 3:6] = -se3.skew(point - posture[:3]) @ found[3:, 3:6]
        return found

    def _distances(self, points: Array) -> Array:
        """Returns distances (n,) of points from the standing object's planes [m]."""
        return np.asarray(self._heights(points).max(axis=1))

    def _heights(self, points: Array) -> Array:
        """Returns the heights (..., m) of points (..., 3) above the planes of the standing object's faces [m]."""
        return np.asarray(points @ self._normals.T - self._offsets)

    def _blended_normals(self, points: Array) -> Array:
        """Returns the object's normals (..., 3) near points (..., 3), blended between its faces."""
        heights = self._heights(points)
        near = np.exp((heights - heights.max(axis=-1, keepdims=True)) / SOFT)
        # Triangles of one side count by their area, so that how a side is cut does not matter.
        normals = (self._areas * near) @ self._normals
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    def _tips_at_object(self, posture: Array, used: Indices) -> TipsAtObject:
        """Returns where the used tips face the object."""
        geoms = self._tips[used]
        centers = self._data.geom_xpos[geoms]
        R = self._data.geom_xmat[geoms].reshape(-1, 3, 3)
        step = 1e-4
        normals = self._blended_normals(centers)
        stepped = self._blended_normals(centers[:, None] + step * np.eye(3))
        by_center = (stepped - normals[:, None]).swapaxes(1, 2) / step
        semi_axes = self._semi_axes[used]
        scaled = -semi_axes * np.einsum("kji,kj->ki", R, normals)
        lengths = np.linalg.norm(scaled, axis=1, keepdims=True)
        points = centers + np.einsum("kij,kj->ki", R, semi_axes * scaled / lengths)
        moved = np.array([self._moves(*each, posture) for each in zip(geoms, points, strict=True)])
        by_turn = moved[:, 3:]
        by_centers = moved[:, :3] + se3.skew(points - centers) @ by_turn
        return TipsAtObject(
            points=points,
            normals=normals,
            pads=np.einsum("kij,kj->ki", R, self._pads[used]),
            by_point=moved[:, :3],
            by_turn=by_turn,
            by_normal=by_center @ by_centers,
        )

    def _clearances(self, used: Indices) -> Iterator[tuple[int, int, float, Array]]:
        """Yields two geoms that should not touch, their distance [m], and the points (6,) nearest to each other.

        Links and unused tips are clear of the object, all are of the table, and neighbouring tips of each other.
        """
        off_object = [*self._links, *np.delete(self._tips, used)]
        off_table = [*self._links, *self._tips]
        pairs = [(geom, self._object) for geom in off_object] + [(geom, self._table) for geom in off_table]
        for one, other in (*pairs, *self._neighbours):
            nearest = np.zeros(6)
            distance = self._mujoco.mj_geomDistance(self._model, self._data, one, other, 1.0, nearest)
            yield one, other, distance, nearest

    def _linear(self, posture: Array, start: Start, away: float = 0.0) -> tuple[Array, Array]:
        """Returns the weighted errors (m,) of a posture, and their derivatives (m, 6 + n) by it."""
        self._place(posture, start.R_world_palm)
        at = self._tips_at_object(posture, start.used)
        still = 0.1 * np.eye(len(posture))[6:]
        parts = [(still @ (posture - start.posture), still)]
        missed = self._distances(at.points) - away
        parts.append((missed / 0.001, np.einsum("kj,kjn->kn", at.normals, at.by_point) / 0.001))
        parts.append(self._off_pads(at, start.used))
        parts.append(self._too_near(posture, start.used))
        if not away:
            parts.append(self._unbalanced(at))
        errors, derivatives = zip(*parts, strict=True)
        return np.concatenate(errors), np.concatenate(derivatives)

    def _off_pads(self, at: TipsAtObject, used: Indices) -> tuple[Array, Array]:
        """Returns how far each tip meets the object off its pad, and the derivatives (k, 6 + n)."""
        lacking = self._pad_cosines[used] + (at.pads * at.normals).sum(axis=1)
        by_posture = np.einsum("kj,kjn->kn", np.cross(at.pads, at.normals), at.by_turn)
        by_posture += np.einsum("kj,kjn->kn", at.pads, at.by_normal)
        off = lacking > 0
        return 10 * lacking * off, 10 * by_posture * off[:, None]

    def _too_near(self, posture: Array, used: Indices) -> tuple[Array, Array]:
        """Returns by how much parts are too near to each other, and the derivatives (m, 6 + n)."""
        errors = []
        rows = []
        for one, other, distance, nearest in self._clearances(used):
            lacking = LINK_CLEARANCE - distance
            row = np.zeros(len(posture))
            if lacking > 0 and distance:
                towards = (nearest[3:] - nearest[:3]) / distance
                row = towards @ self._moves(one, nearest[:3], posture)[:3]
                if other in self._tips:
                    row = row - towards @ self._moves(other, nearest[3:], posture)[:3]
            errors.append(max(lacking, 0) / 0.003)
            rows.append(row / 0.003)
        return np.array(errors), np.array(rows)

    def _unbalanced(self, at: TipsAtObject) -> tuple[Array, Array]:
        """Returns force and torque that remain where tips press along the normals (6,), and the derivatives."""
        share = shares(len(at.points))[:, None]
        pressing = share * at.normals
        by_posture = share[:, None] * at.by_normal
        arms = (at.points - self._mass) / LEVER
        turning = np.cross(arms, pressing)
        by_turning = se3.skew(arms) @ by_posture - se3.skew(pressing) @ at.by_point / LEVER
        errors = np.concatenate([pressing, turning], axis=1).sum(axis=0)
        return 4 * errors, 4 * np.concatenate([by_posture, by_turning], axis=1).sum(axis=0)


def shares(fingers: int) -> Array:
    """Returns how hard each finger presses, relative to the first, which presses against all others."""
    return np.append(1.0, np.full(fingers - 1, 1 / (fingers - 1)))
