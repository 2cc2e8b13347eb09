"""The simulated world, a step at a time: the hand closes on the object, lets its holder go, and moves."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.simulation.motion import LEGS, MOTION, PULLED, WEIGH_LEGS, Grasp, palm_poses, perturbed
from handsight.simulation.payload import Payload
from handsight.simulation.pull import PULL, Pull, pulls
from handsight.simulation.scenario import SCENARIO, Phase, Scenario, TipContact
from handsight.simulation.scene import PALM, T_MOUNT_PALM, mujoco_module

if TYPE_CHECKING:
    from mujoco import MjContact, MjData


class WorldOptions(NamedTuple):
    """`WorldOptions` say when a simulated grasp has failed."""

    servo_time: float = 0.15  # for the servos to hold the open hand [s]
    max_shift: float = 0.03  # how far an object moves in a grasp that holds it [m]
    max_rotation: float = 0.5  # by what angle [rad]
    flying_speed: float = 3.0  # sideways or upwards [m/s]: no hand of this strength throws an object as fast
    max_overlap: float = 0.003  # of the open hand and the object [m]: more, and it does not fit in


WORLD = WorldOptions()

AWAY = np.array([0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0])
"""Where the object waits meanwhile: position [m], quaternion, w first."""


class World:
    """A `World` is one draw of a scene over time; `step` is the only thing that changes it."""

    def __init__(self, scenario: Scenario, grasp: Grasp) -> None:
        """At time 0: the hand is open and still, the object stands on the table, held in place.

        Raises InvalidObject where hand and object overlap.
        """
        self._mujoco = mujoco_module()
        self._load = Payload.of(scenario)
        self.scene = self._load.scene
        self.data: Any = self._mujoco.MjData(self.scene.model)
        low, high = self.scene.bounds_object
        self._size = high - low
        middle = np.array([0.0, 0.0, grasp.height])
        self._grasp = perturbed(grasp, np.random.default_rng((int(scenario.seed), 1)))
        T_world_middle = se3.compose(grasp.R_world_palm @ grasp.T_palm_middle[:3, :3], middle)
        T_middle_object = se3.compose(np.eye(3), -(low + high) / 2)
        T_world_palm = T_world_middle @ se3.inverse(self._grasp.T_palm_middle)
        self._moves = scenario.motion != "grasp"
        self._scenario, self._pulled = scenario, pulls(scenario.motion)
        self._pull: Pull | None = None
        moves = {"grasp": LEGS[:1], "manipulate": LEGS, "weigh": WEIGH_LEGS}
        legs = moves.get(scenario.motion, PULLED)
        self.duration = MOTION.at_rest + float(legs[:, 0].sum())
        times = np.arange(round(self.duration * SCENARIO.steps_per_second) + 1) / SCENARIO.steps_per_second
        Ts_world_palm = palm_poses(legs, times - MOTION.at_rest, T_world_palm, middle)
        self._arm = rows(Ts_world_palm @ se3.inverse(T_MOUNT_PALM))
        self._begin = rows((T_world_middle @ T_middle_object)[None])[0]
        self.steps = 0
        self._closed = 0.0
        self._T_palm_object_freed: Array | None = None
        self._open()

    @property
    def time(self) -> float:
        """Since the fingers began to close [s]."""
        return self.steps / SCENARIO.steps_per_second

    @property
    def phase(self) -> Phase:
        """What is going on."""
        if self.time < MOTION.free:
            return "close"
        if self._pulled and PULL.begin <= self.time <= PULL.begin + PULL.duration:
            return "pull"
        return "move" if self._moves and self.time >= MOTION.moves else "hold"

    def step(self) -> None:
        """Simulates two milliseconds."""
        if self.phase == "close":
            self._close_fingers()
            self._hold_object(self._begin)
        elif self._T_palm_object_freed is None:
            self._T_palm_object_freed = self.T_palm_object()
        self._move_arm()
        if self._pulled and self.time >= PULL.begin:
            self._pull_object()
        elif self.phase == "move":
            self._load.press(self.data)
        self._mujoco.mj_step(self.scene.model, self.data)
        self.steps += 1

    def refresh(self) -> None:
        """Computes poses and sensors of this very instant: a step leaves those of its beginning behind."""
        if self.phase == "close":
            self._hold_object(self._begin)
        self._move_arm()  # else the arm is pulled to where it was to be a step ago
        self._mujoco.mj_forward(self.scene.model, self.data)

    def pose(self, name: str) -> Array:
        """Returns T_world_body (4, 4) of a body; a tip's is its sensor's frame."""
        body = self.data.body(name)
        return se3.compose(body.xmat.reshape(3, 3), body.xpos)

    def reading(self, finger: str) -> Array:
        """Returns (6,) what its sensor reads: force [N] and torque [N m] of the link on the tip, in the sensor's
        frame."""
        return np.concatenate([self.data.sensor(f"{finger}_{kind}").data for kind in ("force", "torque")])

    def T_palm_object(self) -> Array:
        """Returns (4, 4) true."""
        return se3.inverse(self.pose(PALM)) @ self.pose("object")

    def moved(self) -> tuple[float, float]:
        """Returns how far [m], and by what angle [rad], the object has moved in the palm since it was free."""
        if self._T_palm_object_freed is None:
            return 0.0, 0.0
        moved = se3.difference(self.T_palm_object(), self._T_palm_object_freed)
        return float(np.linalg.norm(moved[:3])), float(np.linalg.norm(moved[3:]))

    def dropped(self) -> bool:
        """Returns whether the object has left the grasp since it was free."""
        shift, turn = self.moved()
        return shift > WORLD.max_shift or turn > WORLD.max_rotation

    def touches(self) -> list[tuple[str, float, float]]:
        """Returns contacts of the hand with the object: the hand's geom, how hard it presses [N], how deep [m]."""
        found = []
        for i, contact in enumerate(self.data.contact[: self.data.ncon]):
            names = [self.scene.model.geom(int(geom)).name for geom in contact.geom]
            if "object" in names and "table" not in names and contact.exclude == 0:
                wrench = np.zeros(6)
                self._mujoco.mj_contactForce(self.scene.model, self.data, i, wrench)
                force = float(np.linalg.norm(wrench[:3]))
                found.append((names[1 - names.index("object")], force, -float(contact.dist)))
        return found

    def pressed(self, geom: str) -> float:
        """Returns how hard the object presses on one of the hand's geoms, straight at it [N]."""
        total, wrench = 0.0, np.zeros(6)
        pair = {self.scene.model.geom(name).id for name in (geom, "object")}
        for i, contact in enumerate(self.data.contact[: self.data.ncon]):
            if set(contact.geom.tolist()) == pair and contact.exclude == 0:
                self._mujoco.mj_contactForce(self.scene.model, self.data, i, wrench)
                total += float(wrench[0])
        return total

    def thrown(self) -> bool:
        """Returns whether the object flies as nothing that falls does: the simulator's fault."""
        velocity = self.data.joint("object").qvel[:3]
        return not (np.linalg.norm(velocity[:2]) < WORLD.flying_speed and velocity[2] < WORLD.flying_speed)

    def tip_contacts(self) -> tuple[TipContact, ...]:
        """Returns the fingertips' contacts with whatever they touch."""
        T_palm_world = se3.inverse(self.pose(PALM))
        return tuple(
            self._tip_contact(i, contact, side, T_palm_world)
            for i, contact in enumerate(self.data.contact[: self.data.ncon])
            for side, geom in enumerate(contact.geom)
            if int(geom) in self.scene.tips and contact.exclude == 0
        )

    def _tip_contact(self, i: int, contact: "MjContact", side: int, T_palm_world: Array) -> TipContact:
        """Returns contact i as its first or second geom, a tip, has it."""
        sign = 1.0 if side == 1 else -1.0  # MuJoCo's normal and force are from the first geom to the second
        axes = np.asarray(contact.frame).reshape(3, 3)
        wrench = np.zeros(6)
        self._mujoco.mj_contactForce(self.scene.model, self.data, i, wrench)
        # A contact's position is in the middle of the overlap.
        point = contact.pos + sign * contact.dist / 2 * axes[0]
        tip, other = int(contact.geom[side]), int(contact.geom[1 - side])
        velocity = (self._velocity(other, point) - self._velocity(tip, point)) @ T_palm_world[:3, :3].T
        return TipContact(
            finger=self.scene.tips[tip],
            point_palm=se3.apply(T_palm_world, point[None])[0],
            force_palm=T_palm_world[:3, :3] @ (sign * axes.T @ wrench[:3]),
            other=self.scene.model.geom(other).name,
            normal_palm=T_palm_world[:3, :3] @ (sign * axes[0]),
            velocity_palm=velocity.ravel(),
        )

    def _velocity(self, geom: int, point: Array) -> Array:
        """Returns (2, 3) of a geom's body in the world: of its point there [m/s], and of its turn [rad/s]."""
        body, found = int(self.scene.model.geom_bodyid[geom]), np.zeros(6)
        kind = self._mujoco.mjtObj.mjOBJ_BODY
        self._mujoco.mj_objectVelocity(self.scene.model, self.data, kind, body, found, 0)
        return np.stack([found[3:] + np.cross(found[:3], point - self.data.xipos[body]), found[:3]])

    def _pull_object(self) -> None:
        """Applies what pulls the object for the next step; what slips out of the hand is let go."""
        touching = [contact for contact in self.tip_contacts() if contact.other == "object"]
        if self._pull is None:
            normals = np.array([contact.normal_palm for contact in touching]).reshape(-1, 3)
            self._pull = Pull(self._scenario, normals)
        slips = np.inf if self.dropped() else min((contact.speed for contact in touching), default=0.0)
        moves = float(np.linalg.norm(self.data.joint("object").qvel[:3]))
        R_world_palm = self.pose(PALM)[:3, :3]
        wrench = self._pull.wrench(self.time, slips, moves).reshape(2, 3) @ R_world_palm.T
        self.data.xfrc_applied[self.scene.model.body("object").id] = wrench.ravel()

    def _open(self) -> None:
        """Puts the open hand at its place, at rest, the object at its own."""
        for joint, angle in self._grasp.opening.items():
            self.data.joint(joint).qpos[:] = angle
            self._servo(joint).ctrl[:] = angle
        self._move_arm()
        self.data.joint("mount").qpos[:] = self._arm[0]
        for _ in range(round(WORLD.servo_time * SCENARIO.steps_per_second)):
            self._hold_object(AWAY)
            self._mujoco.mj_step(self.scene.model, self.data)
        self.refresh()
        contacts = self.data.contact[: self.data.ncon]
        body_of, object_body = self.scene.model.geom_bodyid, self.scene.model.body("object").id
        between = [c.dist for c in contacts if object_body in body_of[c.geom] and 0 not in body_of[c.geom]]
        if min(between, default=0.0) < -WORLD.max_overlap:
            size = " x ".join(f"{1000 * side:.0f}" for side in self._size)
            raise InvalidObject(f"object: expected one that fits in the open hand, got {size} mm")

    def _hold_object(self, row: Array) -> None:
        free = self.data.joint("object")
        free.qpos[:], free.qvel[:] = row, 0.0

    def _servo(self, joint: str) -> "MjData":
        return self.data.actuator(joint.replace("robot0:", "robot0:A_"))

    def _move_arm(self) -> None:
        row = self._arm[min(self.steps, len(self._arm) - 1)]
        self.data.mocap_pos[0], self.data.mocap_quat[0] = row[:3], row[3:]

    def _close_fingers(self) -> None:
        """Moves the servos' targets on."""
        self._closed = min(self._closed + 1 / (MOTION.closed * SCENARIO.steps_per_second), 1.0)
        for joint, angle in self._grasp.closed.items():
            begin = self._grasp.opening.get(joint, 0.0)
            self._servo(joint).ctrl[:] = begin + self._closed * (angle - begin)


def rows(Ts: Array) -> Array:
    """Returns (n, 7) positions and quaternions, w first as MuJoCo has them, of (n, 4, 4)."""
    xyzw = se3.quaternion_from_rotation(Ts[:, :3, :3])
    return np.hstack([Ts[:, :3, 3], xyzw[:, 3:], xyzw[:, :3]])
