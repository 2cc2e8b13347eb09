"""The simulated world, a step at a time: the hand closes on the object, lets its holder go, and moves.

The object has its mass, and forces on it that no sensor of the hand measures.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.simulation.hand_in_world import servo_name
from handsight.simulation.motion import (
    AT_REST,
    CLOSED_AT,
    FREE_AT,
    LEGS,
    MOVES_AT,
    Grasp,
    palm_poses,
    perturbed,
)
from handsight.simulation.scenario import (
    OBJECT_MASS,
    STEPS_PER_SECOND,
    Phase,
    Profile,
    Scenario,
    TipContact,
)
from handsight.simulation.scene import (
    PALM,
    PALM_GEOM,
    SimulatedScene,
    TipErrors,
    bounds,
    mujoco_module,
    rows,
    scene,
)

if TYPE_CHECKING:
    from mujoco import MjData


PULL_BEGIN = 3.4
"""When the object is lifted and at rest in the motion `pull` [s]."""
PULL_DURATION = 3.0
"""Of the pull at the object, as by a person who lets go once it has slipped [s]."""
PULL_STEP = 0.5
"""Duration of a step of the force [s]."""
PULL_JERK = 0.06
"""Duration of a jerk; one begins with each step [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """The scene with the scenario's mass and centre of mass, and the constant loads on its object."""

    scene: SimulatedScene
    force_palm: Array  # (3,) on the object, which no sensor measures [N]
    point_object: Array  # (3,) where that force acts [m]
    support: float  # upward force in the world by which something else bears the object [N]
    base_object: Array  # (3,) where the support acts [m]

    @classmethod
    def of(cls, scenario: Scenario) -> "Payload":
        """Returns the payload drawn by the scenario's seed; raises as `scene` does."""
        n = scenario.nuisances
        rng = scenario.stream(10)
        off = rng.normal(size=3)
        force = rng.normal(size=3)
        force *= n.unsensed_force / np.linalg.norm(force)
        low, high = bounds(scenario.object)
        size = high - low
        middle = (low + high) / 2
        point = middle + rng.uniform(-0.5, 0.5, 3) * size
        # The underside is the lower end of the object's z axis, which is vertical when it is grasped.
        base = middle + rng.uniform(-0.5, 0.5, 3) * size
        base[2] = low[2]
        x, y, z = np.clip(n.object_off_center * off / np.linalg.norm(off), -size / 3, size / 3)
        built = scene(
            scenario.object,
            float(n.object_mass or OBJECT_MASS),
            (float(x), float(y), float(z)),
            friction=float(n.friction),
            pyramidal=bool(n.pyramidal_friction),
            softness=float(n.contact_softness),
            tip_errors=tip_errors(scenario),
            coupling_errors=coupling_errors(scenario),
            rig=scenario.rig,
        )
        return cls(built, force, point, n.support_force, base)

    def press(self, data: "MjData") -> None:
        """Applies the unsensed force and the support to the object for the next step."""
        if not self.force_palm.any() and not self.support:
            return
        palm = data.body(self.scene.hand.palm)
        body = data.body("object")
        force = palm.xmat.reshape(3, 3) @ self.force_palm
        support = np.array([0.0, 0.0, self.support])
        point, base = np.stack([self.point_object, self.base_object]) @ body.xmat.reshape(3, 3).T
        center = body.xipos - body.xpos
        body.xfrc_applied[:3] = force + support
        body.xfrc_applied[3:] = np.cross(point - center, force) + np.cross(base - center, support)


def tip_errors(scenario: Scenario) -> TipErrors:
    """Returns by how much each finger's true radius and length differ from the rig's [m]."""
    draws = np.clip(scenario.stream(14).normal(size=(len(scenario.fingers), 2)), -2, 2)
    return tuple(map(tuple, (scenario.nuisances.tip_size * draws).tolist()))


def coupling_errors(scenario: Scenario) -> tuple[float, ...]:
    """Returns by how much each coupled joint of a rig's hand is off its law [rad]."""
    laws = scenario.rig.hand.couplings.laws if scenario.rig else ()
    return tuple((scenario.nuisances.coupled_joint * scenario.stream(21).normal(size=len(laws))).tolist())


class Pull:
    """The direction, speed and distance of one pull; `wrench` gives its load on the object over time."""

    def __init__(self, scenario: Scenario, normals_palm: Array) -> None:
        """Draws by the scenario's seed; `normals_palm` (n, 3) are those of the tips' contacts with the object."""
        rng = scenario.stream(11)
        direction, axis = rng.normal(size=(2, 3))
        across = normals_palm.T @ normals_palm / max(len(normals_palm), 1)
        # Rarely across all tips: it pulls along their surfaces, not off them.
        direction = np.linalg.solve(np.linalg.cholesky(across + 0.03 * np.eye(3)).T, direction)
        self._force = scenario.nuisances.pull_force * direction / np.linalg.norm(direction)
        self._torque = scenario.nuisances.pull_torque * axis / np.linalg.norm(axis)
        creep = 0.1 if scenario.motion == "creep" else 1.0
        self._max_speed = creep * rng.uniform(0.03, 0.1)  # at which it no longer follows the object [m/s]
        self._max_travel = rng.uniform(0.005, 0.02)  # of the object until it is let go [m]
        self._profile = scenario.motion
        self._slipped = 0.0

    def wrench(self, time: float, slip_speed: float, speed: float) -> Array:
        """Returns force [N] and torque [N m], (6,) along the palm's axes, for the simulator's next step. `slip_speed`
        is how fast the object slips along the tips, `speed` how fast it moves at all [m/s]."""
        since = time - PULL_BEGIN
        self._slipped += slip_speed / STEPS_PER_SECOND
        if not 0 <= since <= PULL_DURATION or self._slipped > self._max_travel:
            return np.zeros(6)
        # The pull fades as the object gets away from it.
        share = max(0.0, 1 - max(slip_speed / self._max_speed, speed / 0.3) ** 4)
        return share * pull_share(self._profile, since) * np.concatenate([self._force, self._torque])


def pull_share(profile: str, since: float) -> float:
    """Returns the strength of a pull as a share of its greatest force, at a time after its beginning [s]."""
    share = since / PULL_DURATION
    steps, within = divmod(since, PULL_STEP)
    if profile in ("ramp", "creep"):
        return share
    if profile == "steps":
        return min(1.0, (steps + min(within / 0.05, 1.0)) * PULL_STEP / PULL_DURATION)
    if profile == "jerks":
        height = min(1.0, (steps + 1) * PULL_STEP / PULL_DURATION)
        return height * math.sin(math.pi * within / PULL_JERK) ** 2 if within < PULL_JERK else 0.0
    return share * (1 - math.cos(2 * math.pi * 1.5 * since)) / 2


def pulls(motion: str) -> bool:
    """Returns whether the object is pulled in that motion."""
    return motion in get_args(Profile)


MAX_DEPTH = 0.003
"""By which hand and object, or tips and table, overlap at most when the hand is open [m]; with more they do not fit."""
FLYING_SPEED = 3.0  # sideways or upwards [m/s]: no hand of this strength throws an object as fast
FLOOR = -1.0  # height on which a dropped object comes to rest [m]


class World:
    """One random draw of a scenario, which `step` simulates onward."""

    def __init__(self, scenario: Scenario, grasp: Grasp) -> None:
        """Begins at time 0: the hand is open and still, the object stands on the table, held in place. Raises
        InvalidObject where hand and object overlap, or tips and table."""
        self._mujoco = mujoco_module()
        self._scenario = scenario
        self._load = Payload.of(scenario)
        self.scene = self._load.scene
        self.palm = self.scene.hand.palm
        self._model = self.scene.model
        self.data: Any = self._mujoco.MjData(self._model)
        self._grasp = perturbed(grasp, scenario.stream(1))
        self._pulled = pulls(scenario.motion)
        self._pull: Pull | None = None
        self._closed = 0.0
        self._T_palm_object_freed: Array | None = None
        self.steps = 0
        low, high = self.scene.bounds_object
        middle = np.array([0.0, 0.0, grasp.height])
        T_world_middle = se3.compose(grasp.R_world_palm @ grasp.T_palm_middle[:3, :3], middle)
        self._start = rows(T_world_middle @ se3.translation(-(low + high) / 2))
        legs = LEGS["pull" if self._pulled else scenario.motion]
        self.duration = AT_REST + float(legs[:, 0].sum())
        times = np.arange(round(self.duration * STEPS_PER_SECOND) + 1) / STEPS_PER_SECOND
        T_world_palm = T_world_middle @ se3.inverse(self._grasp.T_palm_middle)
        Ts_world_palm = palm_poses(legs, times - AT_REST, T_world_palm, middle)
        self._arm = rows(Ts_world_palm @ se3.inverse(self.scene.hand.T_mount_palm))
        self._open_hand()
        touching = (*self.object_contacts(), *self.tip_contacts())
        if any(contact.depth > MAX_DEPTH for contact in touching):
            size = " x ".join(f"{1000 * side:.0f}" for side in high - low)
            raise InvalidObject(f"object: expected one that fits in the open hand, got {size} mm")

    def _open_hand(self) -> None:
        """Opens the hand, while the object waits far above; then the object stands on the table."""
        for joint, angle in self._grasp.opening.items():
            self.data.joint(joint).qpos[:] = angle
            self._servo(joint).ctrl[:] = angle
        for joint in self.scene.hand.coupled:  # others would be pulled there
            of = self.scene.hand.followers[joint]
            lead = self._grasp.opening.get(of.leader, 0.0)
            self.data.joint(joint).qpos[:] = of.position(lead)
        self._move_arm()
        self.data.joint("mount").qpos[:] = self._arm[0]
        waiting = np.array([0.0, 0.0, 3.0, 1.0, 0.0, 0.0, 0.0])
        for _ in range(round(0.15 * STEPS_PER_SECOND)):  # [s]
            self._hold_object(waiting)
            self._mujoco.mj_step(self._model, self.data)
        self.refresh()

    @property
    def time(self) -> float:
        """Time since the fingers began to close [s]."""
        return self.steps / STEPS_PER_SECOND

    @property
    def phase(self) -> Phase:
        """The phase of the motion."""
        if self.time < FREE_AT:
            return "close"
        if self._pulled and PULL_BEGIN <= self.time <= PULL_BEGIN + PULL_DURATION:
            return "pull"
        moves = self._scenario.motion != "grasp"
        return "move" if moves and self.time >= MOVES_AT else "hold"

    def step(self) -> None:
        """Simulates two milliseconds."""
        if self.phase == "close":
            self._closed = min(self._closed + 1 / (CLOSED_AT * STEPS_PER_SECOND), 1.0)
            for joint, angle in self._grasp.closed.items():
                begin = self._grasp.opening.get(joint, 0.0)
                self._servo(joint).ctrl[:] = begin + self._closed * (angle - begin)
            self._hold_object(self._start)
        elif self._T_palm_object_freed is None:
            self._T_palm_object_freed = self.T_palm_object()
        self._move_arm()
        if self._pulled and self.time >= PULL_BEGIN:
            self._pull_object()
        elif self.phase == "move":
            self._load.press(self.data)
        self._mujoco.mj_step(self._model, self.data)
        fallen = self.data.joint("object")
        if fallen.qpos[2] < FLOOR:
            fallen.qpos[2] = FLOOR
            fallen.qvel[:] = 0.0
        self.steps += 1

    def _pull_object(self) -> None:
        """Applies the pull to the object for the next step; it ends when the object has slipped out of the hand."""
        touching = [contact for contact in self.tip_contacts() if contact.other == "object"]
        if self._pull is None:
            normals = np.array([contact.normal_palm for contact in touching]).reshape(-1, 3)
            self._pull = Pull(self._scenario, normals)
        slip_speed = np.inf if self.dropped() else min((c.speed for c in touching), default=0.0)
        speed = float(np.linalg.norm(self.data.joint("object").qvel[:3]))
        wrench_palm = self._pull.wrench(self.time, slip_speed, speed).reshape(2, 3)
        wrench = wrench_palm @ self.pose(self.palm)[:3, :3].T
        self.data.xfrc_applied[self._model.body("object").id] = wrench.ravel()

    def refresh(self) -> None:
        """Computes poses and sensors at the current instant: after a step they are those of the step's beginning."""
        if self.phase == "close":
            self._hold_object(self._start)
        self._move_arm()  # else the arm is pulled to its target of the previous step
        self._mujoco.mj_forward(self._model, self.data)

    def pose(self, name: str) -> Array:
        """Returns T_world_body (4, 4) of a body; a tip's is its sensor's frame."""
        body = self.data.body(name)
        return se3.compose(body.xmat.reshape(3, 3), body.xpos)

    def reading(self, finger: str) -> Array:
        """Returns force [N] and torque [N m], (6,), of the link on the tip, in the frame of the finger's sensor."""
        return np.concatenate([self.data.sensor(f"{finger}_{kind}").data for kind in ("force", "torque")])

    def T_palm_object(self) -> Array:
        """Returns the true pose (4, 4)."""
        return se3.inverse(self.pose(self.palm)) @ self.pose("object")

    def moved(self) -> tuple[float, float]:
        """Returns how far [m], and by what angle [rad], the object has moved in the palm since it became free."""
        if self._T_palm_object_freed is None:
            return 0.0, 0.0
        moved = se3.difference(self.T_palm_object(), self._T_palm_object_freed)
        shift, turn = np.linalg.norm(moved.reshape(2, 3), axis=1)
        return float(shift), float(turn)

    def dropped(self) -> bool:
        """Returns whether the object has left the grasp since it became free."""
        shift, turn = self.moved()
        return shift > 0.03 or turn > 0.5  # [m, rad]

    def object_contacts(self) -> list[TipContact]:
        """Returns the object's contacts with all parts of the hand, each by the part's geom."""
        names = [self._model.geom(k).name for k in range(self._model.ngeom)]
        hand = {k: name for k, name in enumerate(names) if name not in ("object", "table")}
        return [contact for contact in self._contacts(hand) if contact.other == "object"]

    def thrown(self) -> bool:
        """Returns whether the object flies faster than this hand can throw it: the simulation has failed."""
        velocity = self.data.joint("object").qvel[:3]
        return not (np.linalg.norm(velocity[:2]) < FLYING_SPEED and velocity[2] < FLYING_SPEED)

    def tip_contacts(self) -> tuple[TipContact, ...]:
        """Returns the fingertips' contacts with everything that they touch."""
        return self._contacts(self.scene.tips)

    def link_contacts(self) -> tuple[TipContact, ...]:
        """Returns the contacts of the fingertips and of the Shadow hand's palm, whose `finger` is `palm`."""
        if self.palm != PALM:
            return self.tip_contacts()
        return self._contacts(self.scene.tips | {self._model.geom(PALM_GEOM).id: "palm"})

    def _contacts(self, named: Mapping[int, str]) -> tuple[TipContact, ...]:
        """Returns the contacts of geoms, each with its name."""
        T_palm_world = se3.inverse(self.pose(self.palm))
        R = T_palm_world[:3, :3]
        found = []
        wrench = np.zeros(6)  # along the contact's own axes, its normal first
        for i, contact in enumerate(self.data.contact):
            for side, geom in enumerate(contact.geom.tolist()):
                if geom not in named or contact.exclude:
                    continue
                # MuJoCo's normal and force are from the first geom to the second.
                sign = 1.0 if side == 1 else -1.0
                axes = contact.frame.reshape(3, 3)
                other = int(contact.geom[1 - side])
                # A contact's position is in the middle of the overlap.
                point = contact.pos + sign * contact.dist / 2 * axes[0]
                velocity = self._velocity(other, point) - self._velocity(geom, point)
                self._mujoco.mj_contactForce(self._model, self.data, i, wrench)
                touch = TipContact(
                    finger=named[geom],
                    point_palm=se3.apply(T_palm_world, point[None])[0],
                    force_palm=R @ (sign * axes.T @ wrench[:3]),
                    other=self._model.geom(other).name,
                    normal_palm=R @ (sign * axes[0]),
                    velocity_palm=(velocity @ R.T).ravel(),
                    torque=float(wrench[3]),
                    depth=-float(contact.dist),
                )
                found.append(touch)
        return tuple(found)

    def _velocity(self, geom: int, point: Array) -> Array:
        """Returns velocity [m/s] of a point of a geom's body, and the body's angular velocity [rad/s], (2, 3) in the
        world."""
        body = int(self._model.geom_bodyid[geom])
        found = np.zeros(6)
        kind = self._mujoco.mjtObj.mjOBJ_BODY
        self._mujoco.mj_objectVelocity(self._model, self.data, kind, body, found, 0)
        turning, moving = found.reshape(2, 3)
        return np.stack([moving + np.cross(turning, point - self.data.xipos[body]), turning])

    def _hold_object(self, row: Array) -> None:
        free = self.data.joint("object")
        free.qpos[:] = row
        free.qvel[:] = 0.0

    def _servo(self, joint: str) -> "MjData":
        return self.data.actuator(servo_name(joint))

    def _move_arm(self) -> None:
        row = self._arm[min(self.steps, len(self._arm) - 1)]
        self.data.mocap_pos[0] = row[:3]
        self.data.mocap_quat[0] = row[3:]
