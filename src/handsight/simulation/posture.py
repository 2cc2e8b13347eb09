"""The hand's posture for a hold: palm and joints bring the tips to their points, servo targets give the forces."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from handsight import se3
from handsight.checks import Array
from handsight.simulation.grasp_candidates import Hold, forces, wished
from handsight.simulation.motion import Grasp
from handsight.simulation.scene import FINGERS, PALM, T_MOUNT_PALM, SimulatedScene, mujoco_module, tip_shape


class PostureOptions(NamedTuple):
    """`PostureOptions` configure the search for the joint angles of a grasp."""

    coupling: float = 1.142  # of the tendon of a finger's last two joints: J0 follows J1 by this ratio
    slack: float = 0.142  # behind it by at most this [rad]
    stiffness: float = 1.0  # of the servos [N m/rad]
    tip_clearance: float = 0.022  # of the open tips from their points [m]
    link_clearance: float = 0.004  # of the other links from the object [m]
    table_clearance: float = 0.003  # of all links from the table [m]
    max_miss: float = 0.002  # distance of a tip from its point that is accepted [m]
    min_clearance: float = 0.0005  # smallest clearance that is accepted [m]
    stop_margin: float = 0.01  # of a joint from its stop [rad]
    tolerance: float = 1e-4  # relative change at which the optimiser stops


POSTURE = PostureOptions()


class Posture:
    """A `Posture` is the hand around one hold; `grasp` computes its closing motion."""

    def __init__(self, scene: SimulatedScene, hold: Hold) -> None:
        """Starts from a hand that grips an object of medium width, moved so that its grip is the hold's."""
        self._mujoco, self._model = mujoco_module(), scene.model
        self._data: Any = self._mujoco.MjData(scene.model)
        self.hold, self._scene, self._used = hold, scene, tuple(hold.points)
        joints = [name for name in scene.joints if name[7:9].lower() in self._used]
        self._follows = [(n.replace("J0", "J1"), n) for n in joints if n.endswith("J0") and n[7:9] != "TH"]
        self._names = [name for name in joints if name not in dict(self._follows).values()]
        self._places = np.array([scene.joints[name] for name in self._names])
        ranges = np.array([self._model.joint(name).range for name in self._names])
        self._low, self._high = ranges[:, 0] + POSTURE.stop_margin, ranges[:, 1] - POSTURE.stop_margin
        # Joints of that hand [rad], 0 for the others; then axes of its grip (thumb to fingers, away from the palm,
        # along the row) and the grip's middle in the palm [m].
        bent = {f"{name.upper()}J{k}": {2: 0.75, 1: 0.6}[k] for name in FINGERS[:4] for k in (2, 1)}
        bent |= {"THJ4": 0.2, "THJ3": 1.1, "THJ2": 0.1, "THJ1": -0.25, "THJ0": -0.7}
        R_grip_palm = np.array([[0.0, 0.3, 0.954], [0, -0.954, 0.3], [1, 0, 0]])
        grip_palm = np.array([0.005, -0.09, 0.1])
        self._bent = np.array([bent.get(name[7:], 0.0) for name in self._names])
        c, s = np.cos(hold.roll), np.sin(hold.roll)
        self._R = np.array([[1.0, 0, 0], [0, c, s], [0, -s, c]]) @ R_grip_palm
        fingers = np.mean([point for finger, point in hold.points.items() if finger != "th"], axis=0)
        self._p = (hold.points["th"] + fingers) / 2 - self._R @ grip_palm
        # Links that must touch nothing are covered by balls: geom, centre in it and radius [m] of each.
        kinds = self._mujoco.mjtGeom
        balls: list[tuple[int, Any, float]] = []
        for i in range(self._model.ngeom):
            geom = self._model.geom(i)
            x, y, z = geom.size
            if geom.type[0] == kinds.mjGEOM_CAPSULE and geom.contype[0]:
                balls += [(i, (0, 0, t * y), x) for t in (-1, 0, 1)]
            elif geom.name.startswith("robot0:C_") and geom.type[0] == kinds.mjGEOM_BOX:
                grid = [(a, b) for a in (-1, 0, 1) for b in (-1, -0.33, 0.33, 1)]
                balls += [(i, (a * (x - y), 0, b * (z - y)), y) for a, b in grid]
            elif i in scene.tips and scene.tips[i] not in self._used:
                balls += [(i, (0, 0, t * (z - x)), x) for t in (-1, 1)]
        self._geoms, self._centers, self._radii = (np.array(column) for column in zip(*balls, strict=True))

    def grasp(self) -> tuple[Grasp | None, str]:
        """Returns the grasp, or None and the reason why the hand cannot take this hold."""
        x = self._fitted(self._residuals, np.concatenate([np.zeros(6), self._bent]))
        self._place(x)
        missed = [self._tip(finger)[0] - self.hold.points[finger] for finger in self._used]
        if np.linalg.norm(missed, axis=1).max() > POSTURE.max_miss:
            return None, "out of reach"
        if min(clearance.min() for clearance in self._clearances()) < POSTURE.min_clearance:
            return None, "no room for the hand"
        # The servos' targets [rad] are off the joints by the torques of balanced forces.
        self._mujoco.mj_comPos(self._model, self._data)
        points, normals = (np.array([*of.values()]) for of in (self.hold.points, self.hold.normals))
        pressing, _ = forces(points, normals, wished(self.hold.points))
        torques = np.zeros(self._model.nv)
        for finger, point, force in zip(self._used, points, pressing, strict=True):
            J = np.zeros((3, self._model.nv))
            self._mujoco.mj_jac(self._model, self._data, J, None, point, self._model.body(f"{finger}_tip").id)
            torques += J.T @ force
        of_joint = {name: torques[self._model.joint(name).dofadr[0]] for name in self._scene.joints}
        for leader, follower in self._follows:
            of_joint[leader] += POSTURE.coupling * of_joint[follower]
        closed = x[6:] + np.array([of_joint[name] for name in self._names]) / POSTURE.stiffness
        closed = np.clip(closed, self._low - POSTURE.stop_margin, self._high + POSTURE.stop_margin)
        away = POSTURE.tip_clearance
        opened = self._fitted(lambda joints: self._residuals(np.concatenate([x[:6], joints]), away), x[6:])
        self._place(x)
        palm, height = self._data.body(PALM), float(self.hold.body.middle[2])
        R_world_palm = palm.xmat.reshape(3, 3).copy()
        T_world_middle = se3.compose(self.hold.R_world_object, np.array([0.0, 0.0, height]))
        return Grasp(
            T_palm_middle=se3.inverse(se3.compose(R_world_palm, palm.xpos)) @ T_world_middle,
            opening=dict(zip(self._names, opened.tolist(), strict=True)),
            closed=dict(zip(self._names, closed.tolist(), strict=True)),
            height=height,
            R_world_palm=R_world_palm,
        ), ""

    def _fitted(self, residuals: Callable[[Array], Array], start: Array) -> Array:
        """Returns the minimiser of the sum of squares within the joints' range; its last numbers are the joints."""
        free = np.full(len(start) - len(self._low), np.inf)
        low, high = np.concatenate([-free, self._low]), np.concatenate([free, self._high])
        start = np.clip(start, low + POSTURE.tolerance, high - POSTURE.tolerance)
        scale = np.repeat([0.1, 0.5], [len(free), len(self._low)])
        tolerances = dict.fromkeys(("ftol", "xtol"), POSTURE.tolerance)
        found = least_squares(residuals, start, bounds=(low, high), x_scale=scale, max_nfev=40, **tolerances)
        return np.asarray(found.x)

    def _place(self, x: Array) -> None:
        """Places the hand: x is the palm's shift [m] and rotation [rad] from the start, then the joints [rad]."""
        angles = self._data.qpos
        angles[:] = 0.0
        angles[self._places] = x[6:]
        for leader, follower in self._follows:
            leads = angles[self._scene.joints[leader]]
            angles[self._scene.joints[follower]] = max(0.0, POSTURE.coupling * leads - POSTURE.slack)
        T = se3.compose(se3.rotation_exp(x[3:6]) @ self._R, self._p + x[:3]) @ se3.inverse(T_MOUNT_PALM)
        mount = self._data.joint("mount").qpos
        mount[:3], mount[3:] = T[:3, 3], np.roll(se3.quaternion_from_rotation(T[:3, :3]), 1)
        self._mujoco.mj_kinematics(self._model, self._data)

    def _tip(self, finger: str) -> tuple[Array, Array, float]:
        """Returns the point of a tip that meets the object's side [m], its direction in the tip, and the tip's
        height [m]."""
        geom, semi_axes = self._data.geom(f"{finger}_tip"), tip_shape(finger)[0]
        R = geom.xmat.reshape(3, 3)
        towards = -R.T @ self.hold.normals[finger]
        scaled = semi_axes * towards
        return geom.xpos + R @ (semi_axes * scaled / np.sqrt(scaled @ scaled)), towards, float(geom.xpos[2])

    def _residuals(self, x: Array, away: float = 0.0) -> Array:
        """Returns the errors of a posture, weighted; its tips should be at distance `away` from their points [m]."""
        self._place(x)
        parts = [0.15 * (x[6:] - self._bent), 0.5 * x[3:6]]
        for finger in self._used:
            point, towards, height = self._tip(finger)
            goal = self.hold.points[finger] + away * self.hold.normals[finger]
            # Where on the tip the object should be, a direction in the axes of the distal link.
            pad = np.array([-0.85, 0.0, 0.53] if finger == "th" else [0.0, -0.85, 0.53])
            parts += [(point - goal) / 0.002, 0.7 * (towards - pad)]
            parts.append(np.array([max(0.0, 0.009 + POSTURE.table_clearance - height) / 0.002]))
        from_object, from_table = self._clearances()
        parts.append(np.maximum(POSTURE.link_clearance - from_object, 0) / 0.003)
        parts.append(np.maximum(POSTURE.table_clearance - from_table, 0) / 0.003)
        return np.concatenate(parts)

    def _clearances(self) -> tuple[Array, Array]:
        """Returns distances of the links' balls from the planes of the object's faces, and from the table [m]."""
        R = self._data.geom_xmat[self._geoms].reshape(-1, 3, 3)
        at = self._data.geom_xpos[self._geoms] + np.einsum("ijk,ik->ij", R, self._centers)
        body = self.hold.body
        from_object = (at @ body.normals.T - body.offsets).max(axis=1)
        return from_object - self._radii, at[:, 2] - self._radii
