"""Samples of a scenario: at each instant the truth, and the measurements of the robot's sensors with their errors."""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import compress

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.observation import Observation, PoseMeasurement
from handsight.simulation.camera import (
    Renderer,
    add_depth_noise,
    calibration_error,
    moved_about_target,
    true_camera,
)
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.motion import Grasp
from handsight.simulation.robot import rig_of
from handsight.simulation.scenario import STEPS_PER_SECOND, Sample, Scenario
from handsight.simulation.scene import GRAVITY, mujoco_module, scene
from handsight.simulation.taxels import TaxelSensors
from handsight.simulation.world import World, tip_errors
from handsight.vision.depth_noise import PRESETS


class Sensors:
    """Measures joints, wrenches, vision and taxels in a world, with the errors of its scenario. Constant
    errors are drawn at the start, noise at every sample."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        """Draws by the scenario's seed; each sensor has its own random stream, which no other's settings change."""
        self.scenario = scenario
        self.world = world
        self._data = world.data
        self._tips = world.scene.hand.tips
        self.nuisances = n = scenario.nuisances
        self._constant = constant_errors(scenario)
        self._noise = scenario.stream(3)
        self._vision = scenario.stream(5)
        self._image_noise = scenario.stream(6)
        self._losses = scenario.stream(16)
        self._jitter = scenario.stream(17)
        self._wander = scenario.stream(18)
        self.T_world_scene = self._constant.T_world_scene
        self._T_camera_world = true_camera(scenario)
        self._drift = np.zeros(6)  # of vision, in sigmas
        self._loads: Array | None = None
        self.lost = False  # whether the last observation's joint state was lost, and with it the observation
        self._past = deque[tuple[Array, Array]](maxlen=1 + round(n.vision_delay * scenario.rate))
        self._renderer = Renderer(world.scene) if scenario.images else None
        self._depth_noise = PRESETS[scenario.depth_camera].times(n.depth_noise)
        self._taxels = TaxelSensors(scenario)
        self._samples = 0
        joints = world.scene.joints
        self._joints = list(joints)
        self._angles = list(joints.values())
        self._dofs = [world.scene.model.joint(name).dofadr[0] for name in joints]
        hand = rig_of(scenario).hand
        self._couplings = hand.couplings
        unmeasured = world.scene.hand.coupled if scenario.joints == "driven" else ()
        self._measured = np.array([name not in unmeasured for name in joints])
        moving = {*hand.moving, *hand.needed}
        self._bending = self._measured & [name in moving for name in joints]

    def close(self) -> None:
        """Frees the renderer of the images."""
        if self._renderer is not None:
            self._renderer.close()

    def observe(self) -> Observation:
        """Returns the observation at the current instant; the world must have been refreshed."""
        self._past.append((self.T_world_scene @ self.world.pose("object"), self._data.qpos.copy()))
        T_world_object, configuration = self._past[0]  # as old as the delay, or the oldest there is
        n = self.nuisances
        lost = self._losses.random(3 + len(self._tips)) < n.message_loss  # joints, vision, image, wrenches
        self.lost = bool(lost[0])
        T_camera_world = self._T_camera_world @ self._drifted()
        vision = color = depth = None
        if self._due(10.0):
            off = _errors(n.vision_position, n.vision_rotation, self._vision)
            if not lost[1]:
                vision = PoseMeasurement(se3.moved(T_camera_world @ T_world_object, off), "camera")
        if self._renderer is not None and self._due(30.0):
            T_scene_camera = se3.inverse(T_camera_world @ self.T_world_scene)
            taken, exact = self._renderer.take(configuration, T_scene_camera)
            noisy = add_depth_noise(exact, self._depth_noise, self._image_noise, int(self.scenario.seed))
            if not lost[2]:
                color = taken
                depth = noisy
        self._samples += 1
        # A deflected tip, which the joints do not measure, looks like joints turned the other way.
        joints = self._data.qpos[self._angles] + self._constant.joint_offsets - self._deflections()
        joints = joints + n.joint_noise * self._noise.normal(size=len(joints))
        received = ~lost[3:] & (self.scenario.sensors == "wrench")
        wrenches = zip(self._tips, self._read_wrenches(), strict=True)
        late = min(n.stamp_jitter, 0.9 / self.scenario.rate) * self._jitter.random()
        return Observation(
            stamp=self.world.time + late,
            joint_positions=self._by_joint(joints),
            wrenches=dict(compress(wrenches, received)),
            vision=vision,
            T_world_palm=self.T_world_scene @ self.world.pose(self.world.palm),
            color=color,
            depth=depth,
            skin=self._taxels.readings(self.world),
        )

    def sample(self) -> Sample:
        """Returns the observation and the truth at the current instant; the world must have been refreshed."""
        return Sample(
            observation=self.observe(),
            T_palm_object=self.world.T_palm_object(),
            T_world_object=self.T_world_scene @ self.world.pose("object"),
            contacts_truth=self.world.tip_contacts(),
            phase=self.world.phase,
            dropped=self.world.dropped(),
            configuration=self._data.qpos.copy(),
        )

    def _by_joint(self, positions: Array) -> dict[str, float]:
        """Returns, of all joints' positions (n,), those that are measured, by name."""
        return dict(compress(zip(self._joints, positions.tolist(), strict=True), self._measured))

    def _read_wrenches(self) -> Array:
        """Returns the readings (n, 6) of the fingers' force/torque sensors [N, N m]."""
        n = self.nuisances
        errors = self._constant.bias + self._constant.drift * self.world.time
        errors = errors + _errors(n.force_noise, n.torque_noise, self._noise, len(self._tips))
        true = [of.sign * self.world.reading(finger) for finger, of in self._tips.items()]
        loads = self._constant.gains * true
        play = np.repeat([n.force_backlash, n.torque_backlash], 3)
        last = loads if self._loads is None else self._loads
        self._loads = np.clip(last, loads - play, loads + play)
        return self._loads + errors

    def _drifted(self) -> Array:
        """Returns the wandering part of vision's error at this observation, a motion (4, 4) in the world."""
        n = self.nuisances
        passed = 1 / (self.scenario.rate * n.vision_drift_time) if n.vision_drift_time else np.inf
        kept = np.exp(-passed) if self._samples else 0.0
        self._drift = kept * self._drift + np.sqrt(1 - kept**2) * self._wander.normal(size=6)
        shift = n.vision_drift_position * self._drift[:3]
        return moved_about_target(shift, n.vision_drift_rotation * self._drift[3:])

    def _due(self, per_second: float) -> bool:
        """Returns whether this sample has a measurement that comes at a rate [1/s]."""
        share = per_second / self.scenario.rate
        return math.floor(share * self._samples + 1e-9) > math.floor(share * (self._samples - 1) + 1e-9)

    def _deflections(self) -> Array:
        """Returns the rotations of all joints (n,) that would move the tips as the loads deflect them [rad]."""
        found = np.zeros(len(self._joints))
        if self.nuisances.tip_compliance == 0:
            return found
        model = self.world.scene.model
        # The derivative (n, n) of the joints' positions by those that are measured.
        positions = self._by_joint(self._data.qpos[self._angles])
        follow = self._couplings.changes(self._joints, positions)
        for finger, of in self._tips.items():
            tip = f"{finger}_tip"
            T = self.world.pose(tip)
            force = -T[:3, :3] @ self.world.reading(finger)[:3] - of.mass * GRAVITY
            center = (T @ of.T_sensor_surface)[:3, 3]
            jacobian = np.zeros((3, model.nv))
            mujoco_module().mj_jac(model, self._data, jacobian, None, center, model.body(tip).id)
            by_joint = jacobian[:, self._dofs] @ follow
            own = np.flatnonzero(self._bending & by_joint.any(axis=0))
            J = by_joint[:, own]
            # Damped by 1 mm, else a stretched finger would turn far to move its tip along itself.
            gram = J @ J.T + 1e-6 * np.eye(3)
            found[own] = J.T @ np.linalg.solve(gram, self.nuisances.tip_compliance * force)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class ConstantErrors:
    """What a robot's sensors and its rig have wrong all the time, as drawn: truth for tests."""

    joint_offsets: Array
    """(n,) of the joints' readings [rad], or [m] of a slide."""
    gains: Array
    """(5, 6) of the fingers' force/torque sensors, 1 for a right one."""
    bias: Array
    """(5, 6) readings of the fingers without load [N, N m]; the rig's calibration has `UNLOADED`."""
    drift: Array
    """(5, 6) rate at which the bias grows [N/s, N m/s]."""
    tips: Array
    """(5, 2) true radius and length of the tips less the rig's [m]."""
    T_world_scene: Array
    """(4, 4) where the true table, and all that stands on it, is in the world, in which the rig's table is at 0."""
    T_measured_true: Array
    """(4, 4) in the world: it maps true poses to where the rig's camera places them, without vision's drift."""


def constant_errors(scenario: Scenario) -> ConstantErrors:
    """Returns the constant errors that a scenario's seed draws, of the sizes of its nuisances; raises as `scene`."""
    n = scenario.nuisances
    built = scene(scenario.object, rig=scenario.rig)
    unloaded = np.array([tip.unloaded for tip in built.hand.tips.values()])
    rng = scenario.stream(2)
    offsets = n.joint_offset * rng.normal(size=len(built.joints))
    bias = unloaded + _errors(n.force_bias, n.torque_bias, rng, len(unloaded)) + tip_biases(scenario)
    drift = _errors(n.force_drift, n.torque_drift, rng, len(unloaded))
    height, *tilt = scenario.stream(9).normal(size=3)
    turn = se3.rotation_exp(n.table_tilt * np.array([*tilt, 0.0]))
    return ConstantErrors(
        joint_offsets=offsets,
        gains=1 + n.force_gain * scenario.stream(15).normal(size=bias.shape),
        bias=bias,
        drift=drift,
        tips=np.array(tip_errors(scenario)),
        T_world_scene=se3.compose(turn, np.array([0.0, 0.0, n.table_height * height])),
        T_measured_true=calibration_error(scenario),
    )


def tip_biases(scenario: Scenario) -> Array:
    """Returns constant errors (n, 6) of the fingers' wrenches [N, N m]: one finger's force is wrong, all else is 0."""
    rng = scenario.stream(12)
    # Of the Shadow hand, the fingers that grip can and box alike.
    gripping = [k for k, name in enumerate(scenario.fingers) if scenario.rig or name not in ("rf", "lf")]
    finger = rng.choice(gripping)
    direction = rng.normal(size=3)
    bias = np.zeros((len(scenario.fingers), 6))
    bias[finger, :3] = scenario.nuisances.tip_bias * direction / np.linalg.norm(direction)
    return bias


def _errors(sigma_first: float, sigma_second: float, rng: np.random.Generator, *rows: int) -> Array:
    """Returns errors (*rows, 6): the first three numbers have one sigma, the last three another."""
    return np.repeat([sigma_first, sigma_second], 3) * rng.normal(size=(*rows, 6))


def simulate(
    scenario: Scenario, progress: Callable[[float], None] | None = None, grasp: Grasp | None = None
) -> Iterator[Sample]:
    """Yields samples at the scenario's rate, from the open hand on; the same scenario gives the same samples.

    The fingers close (1 s, the object held in place), the object is let go, and the palm is still or moves: 1.9 s for
    a grasp, 18.4 s for a manipulation. `grasp` replaces the object's own, or for a mesh the one that `find_grasp` finds
    for this seed. `progress` is called with the share that is done, 0 to 1. Raises MissingExtra without mujoco or
    gymnasium-robotics (`handsight[sim]`), or where images cannot be drawn; InvalidFile or
    InvalidObject for a mesh that cannot be used, or if the simulation fails and throws the object away.
    """
    if grasp is None:
        grasp = grasp_for(scenario.object, int(scenario.seed), skin=scenario.skin, rig=scenario.rig)
    world = World(scenario, grasp)
    for (sample,) in samples(scenario, world, [Sensors(scenario, world)], progress):
        if sample is not None:
            yield sample


def samples(
    scenario: Scenario,
    world: World,
    sensors: Sequence[Sensors],
    progress: Callable[[float], None] | None = None,
) -> Iterator[tuple[Sample | None, ...]]:
    """Yields a world's samples by each of the sensors, at the scenario's rate, and closes these at the end.

    A sample is None where its message is lost. Raises as `simulate`.
    """
    every = round(STEPS_PER_SECOND / scenario.rate)
    steps = round(world.duration * STEPS_PER_SECOND)
    with ExitStack() as stack:
        for each in sensors:
            stack.callback(each.close)
        for step in range(steps + 1):
            if step:
                world.step()
            if step % every:
                continue
            world.refresh()
            if world.thrown():
                when = f"after {world.time:.1f} s"
                raise InvalidObject(f"object: the simulator threw it away {when}, not the hand")
            found = [each.sample() for each in sensors]
            yield tuple(None if each.lost else sample for each, sample in zip(sensors, found, strict=True))
            if progress is not None:
                progress(step / steps)
