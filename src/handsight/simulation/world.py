"""The simulated world, a step at a time: the hand closes on the object, lets its holder go, and moves."""

from dataclasses import replace
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.simulation.grasps import BOX, CAN, CLOSING, MESH, Grasp, perturbed
from handsight.simulation.motion import FREED, HELD, KEPT, palm_path
from handsight.simulation.scenario import STEPS_PER_SECOND, Phase, Scenario, TipContact
from handsight.simulation.scene import FINGERS, T_MOUNT_PALM, Scene, mujoco_module, scene

SETTLE = 0.15
"""For the servos to hold the open hand [s]."""
R_WORLD_PALM = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
"""Fingers along x, the palm towards y, the thumb up; a draw turns it a little."""
AWAY = np.array([0.0, 0.0, 3.0])
"""Where the object waits meanwhile [m]."""
PALM_ABOVE_TABLE = 0.0468
"""Of a grasp on any object [m]: lower, the palm's edge touches the table."""
MAX_SHIFT, MAX_TURN = 0.03, 0.5
"""How far [m], and by what angle [rad], an object moves in a grasp that holds it."""
MAX_OVERLAP = 0.003
"""Of the open hand and the object [m]: more, and it does not fit in."""


class World:
    """One draw of a scene over time; `step` is the only thing that changes it."""

    def __init__(self, scenario: Scenario) -> None:
        """At time 0: the hand is open and still, the object stands on the table, held in place."""
        self._mujoco = mujoco_module()
        self.scene = scene(scenario.object)
        self.data: Any = self._mujoco.MjData(self.scene.model)
        grasp = _grasp(scenario, self.scene)
        self.grasp = perturbed(grasp, np.random.default_rng((int(scenario.seed), 1)))
        middle = np.array([0.0, 0.0, self.scene.size_object[2] / 2])
        T_world_middle = se3.compose(R_WORLD_PALM @ grasp.T_palm_middle[:3, :3], middle)
        T_middle_object = se3.compose(np.eye(3), -self.scene.center_object)
        self.T_world_object_begin = T_world_middle @ T_middle_object
        self.path = palm_path(scenario.motion, T_world_middle @ se3.inverse(self.grasp.T_palm_middle), middle)
        self.duration = CLOSING + HELD + FREED + self.path.duration
        times = np.arange(round(self.duration * STEPS_PER_SECOND) + 1) / STEPS_PER_SECOND
        self._arm = _rows(self.path.at(times - (CLOSING + HELD + FREED)) @ se3.inverse(T_MOUNT_PALM))
        self._begin, self._away = _rows(np.array([self.T_world_object_begin, se3.compose(np.eye(3), AWAY)]))
        self.steps = 0
        self._closed = dict.fromkeys(FINGERS, 0.0)
        self._T_palm_object_freed: Array | None = None
        self._open()

    @property
    def time(self) -> float:
        """Since the fingers began to close [s]."""
        return self.steps / STEPS_PER_SECOND

    @property
    def phase(self) -> Phase:
        """What is going on."""
        if self.time < CLOSING + HELD:
            return "close"
        moves = len(self.path.legs) > 1  # the first is to wait
        return "move" if moves and self.time >= CLOSING + HELD + FREED + KEPT else "hold"

    def step(self) -> None:
        """Two milliseconds."""
        if self.phase == "close":
            self._close_fingers()
            self._hold_object(self._begin)
        elif self._T_palm_object_freed is None:
            self._T_palm_object_freed = self.T_palm_object()
        self._move_arm()
        self._mujoco.mj_step(self.scene.model, self.data)
        self.steps += 1

    def refresh(self) -> None:
        """Poses and sensors of this very instant: a step leaves those of its beginning behind."""
        if self.phase == "close":
            self._hold_object(self._begin)
        self._mujoco.mj_forward(self.scene.model, self.data)

    def pose(self, body: str) -> Array:
        """T_world_body (4, 4) of palm, object or a finger's tip (its sensor's frame)."""
        i = self.scene.bodies[body]
        return se3.compose(self.data.xmat[i].reshape(3, 3), self.data.xpos[i])

    def reading(self, finger: str) -> Array:
        """(6,) what its sensor reads: force [N] and torque [N m] of the link on the tip, in the sensor's frame."""
        at = self.scene.readings[finger]
        return np.array(self.data.sensordata[at : at + 6])

    def T_palm_object(self) -> Array:
        """(4, 4) true."""
        return se3.inverse(self.pose("palm")) @ self.pose("object")

    def dropped(self) -> bool:
        """Whether the object has left the grasp since it was free."""
        if self._T_palm_object_freed is None:
            return False
        moved = se3.difference(self.T_palm_object(), self._T_palm_object_freed)
        return bool(np.linalg.norm(moved[:3]) > MAX_SHIFT or np.linalg.norm(moved[3:]) > MAX_TURN)

    def tip_contacts(self) -> tuple[TipContact, ...]:
        """The fingertips' contacts with whatever they touch."""
        T_palm_world = se3.inverse(self.pose("palm"))
        return tuple(
            self._tip_contact(i, contact, side, T_palm_world)
            for i, contact in enumerate(self.data.contact[: self.data.ncon])
            for side, geom in enumerate(contact.geom)
            if int(geom) in self.scene.tips and contact.exclude == 0
        )

    def _tip_contact(self, i: int, contact: Any, side: int, T_palm_world: Array) -> TipContact:
        """Contact i as its first or second geom, a tip, has it."""
        sign = 1.0 if side == 1 else -1.0  # MuJoCo's normal and force are from the first geom to the second
        axes = np.asarray(contact.frame).reshape(3, 3)
        wrench = np.zeros(6)
        self._mujoco.mj_contactForce(self.scene.model, self.data, i, wrench)
        # A contact's position is in the middle of the overlap.
        point = contact.pos + sign * contact.dist / 2 * axes[0]
        return TipContact(
            finger=self.scene.tips[int(contact.geom[side])],
            point_palm=se3.apply(T_palm_world, point[None])[0],
            force_palm=T_palm_world[:3, :3] @ (sign * axes.T @ wrench[:3]),
            other=self.scene.model.geom(int(contact.geom[1 - side])).name,
        )

    def _open(self) -> None:
        """The open hand at its place, at rest, the object at its own."""
        for joint, angle in self.grasp.opening.items():
            self.data.qpos[self.scene.joints[joint]] = angle
            self.data.ctrl[self.scene.servos[joint]] = angle
        self._move_arm()
        self.data.qpos[self.scene.mount_q : self.scene.mount_q + 7] = self._arm[0]
        for _ in range(round(SETTLE * STEPS_PER_SECOND)):
            self._hold_object(self._away)
            self._mujoco.mj_step(self.scene.model, self.data)
        self.refresh()
        deepest = min((c.dist for c in self.data.contact[: self.data.ncon] if self._of_hand(c)), default=0.0)
        if deepest < -MAX_OVERLAP:
            size = " x ".join(f"{1000 * side:.0f}" for side in self.scene.size_object)
            raise InvalidObject(f"object: expected one that fits in the open hand, got {size} mm")

    def _of_hand(self, contact: Any) -> bool:
        """Whether it is between object and hand."""
        of = [int(self.scene.model.geom_bodyid[geom]) for geom in contact.geom]
        return self.scene.bodies["object"] in of and 0 not in of

    def _hold_object(self, row: Array) -> None:
        q, v = self.scene.object_q, self.scene.object_v
        self.data.qpos[q : q + 7], self.data.qvel[v : v + 6] = row, 0.0

    def _move_arm(self) -> None:
        row = self._arm[min(self.steps, len(self._arm) - 1)]
        self.data.mocap_pos[0], self.data.mocap_quat[0] = row[:3], row[3:]

    def _close_fingers(self) -> None:
        """Moves the servos' targets on, of those fingers that do not press enough yet."""
        for finger in FINGERS:
            if np.linalg.norm(self.reading(finger)[:3]) < self.grasp.stop_force:
                further = self._closed[finger] + self.grasp.furthest / (CLOSING * STEPS_PER_SECOND)
                self._closed[finger] = min(further, self.grasp.furthest)
        for joint, angle in self.grasp.closed.items():
            begin = self.grasp.opening.get(joint, 0.0)
            share = self._closed[joint.removeprefix("robot0:")[:2].lower()]
            self.data.ctrl[self.scene.servos[joint]] = begin + share * (angle - begin)


def _grasp(scenario: Scenario, built: Scene) -> Grasp:
    if scenario.object in ("can", "box"):
        return CAN if scenario.object == "can" else BOX
    T = MESH.T_palm_middle.copy()
    T[0, 3] = built.size_object[2] / 2 - PALM_ABOVE_TABLE
    return replace(MESH, T_palm_middle=T)


def _rows(Ts: Array) -> Array:
    """(n, 7) positions and quaternions, w first as MuJoCo has them, of (n, 4, 4)."""
    xyzw = se3.quaternion_from_rotation(Ts[:, :3, :3])
    return np.hstack([Ts[:, :3, 3], xyzw[:, 3:], xyzw[:, :3]])
