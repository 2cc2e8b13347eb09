"""Samples of a scenario: at each instant the truth, and the measurements of the robot's sensors with their errors."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import closing

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.observation import Observation, PoseMeasurement
from handsight.simulation.camera import add_depth_noise, true_camera
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.motion import Grasp
from handsight.simulation.rendering import Renderer
from handsight.simulation.scenario import SCENARIO, Nuisances, Sample, Scenario
from handsight.simulation.scene import FINGERS, GRAVITY, PALM, SCENE, UNLOADED, mujoco_module, tip_shape
from handsight.simulation.skin import PALM_GEOM, PalmSkin
from handsight.simulation.world import World
from handsight.vision.depth_noise import PRESETS


class Sensors:
    """`Sensors` measure joints, wrenches, vision and taxels in a world, with the errors of its scenario.

    Constant errors are drawn at the start, noise at every sample.
    """

    def __init__(self, scenario: Scenario, world: World) -> None:
        """Draws by the scenario's seed; each sensor has its own random stream, which no other's settings change."""
        self.scenario, self.world, self.nuisances = scenario, world, scenario.nuisances
        seed, n = int(scenario.seed), scenario.nuisances
        constant = np.random.default_rng((seed, 2))
        self._offsets = n.joint_offset * constant.normal(size=len(world.scene.joints))
        self._bias = UNLOADED + _errors(n.force_bias, n.torque_bias, constant, len(FINGERS))
        self._bias += tip_biases(n, seed)
        self._drift = _errors(n.force_drift, n.torque_drift, constant, len(FINGERS))
        self._noise, self._vision, self._image_noise = (np.random.default_rng((seed, k)) for k in (3, 5, 6))
        # The scene's table is the true one; the world's is the table of the robot's rig.
        height, *tilt = np.random.default_rng((seed, 9)).normal(size=3)
        turn = se3.rotation_exp(n.table_tilt * np.array([*tilt, 0.0]))
        self.T_world_scene = se3.compose(turn, np.array([0.0, 0.0, n.table_height * height]))
        self._T_camera_world = true_camera(scenario)
        self._past: deque[tuple[Array, Array]] = deque(maxlen=1 + round(n.vision_delay * scenario.rate))
        self._renderer = Renderer(world.scene) if scenario.images else None
        self._depth_noise = PRESETS[scenario.depth_camera].times(n.depth_noise)
        self._skin = PalmSkin(scenario) if scenario.skin else None
        self._samples = 0
        self._angles = list(world.scene.joints.values())
        self._dofs = np.array([world.scene.model.joint(name).dofadr[0] for name in world.scene.joints])

    def close(self) -> None:
        """Frees the renderer of the images."""
        if self._renderer is not None:
            self._renderer.close()

    def observe(self) -> Observation:
        """Returns the observation at the current instant; the world must have been refreshed."""
        self._past.append((self.T_world_scene @ self.world.pose("object"), self.world.data.qpos.copy()))
        T_world_object, configuration = self._past[0]  # as old as the delay, or the oldest there is
        n, color, depth, vision = self.nuisances, None, None, None
        if self._due(10.0):
            off = _errors(n.vision_position, n.vision_rotation, self._vision)
            vision = PoseMeasurement(se3.moved(self._T_camera_world @ T_world_object, off), "camera")
        if self._renderer is not None and self._due(30.0):
            T_scene_camera = se3.inverse(self._T_camera_world @ self.T_world_scene)
            color, exact = self._renderer.take(configuration, T_scene_camera)
            depth = add_depth_noise(exact, self._depth_noise, self._image_noise, int(self.scenario.seed))
        self._samples += 1
        # A deflected tip, which the joints do not measure, looks like joints turned the other way.
        joints = self.world.data.qpos[self._angles] + self._offsets - self._deflections()
        joints = joints + n.joint_noise * self._noise.normal(size=len(joints))
        errors = self._bias + self._drift * self.world.time
        errors = errors + _errors(n.force_noise, n.torque_noise, self._noise, len(FINGERS))
        skin: dict[str, Array] = {}
        if self._skin is not None:
            skin = self._skin.readings(self.world.T_palm_object(), self.world.pressed(PALM_GEOM))
        return Observation(
            stamp=self.world.time,
            joint_positions=dict(zip(self.world.scene.joints, joints.tolist(), strict=True)),
            wrenches={f: self.world.reading(f) + error for f, error in zip(FINGERS, errors, strict=True)},
            vision=vision,
            T_world_palm=self.T_world_scene @ self.world.pose(PALM),
            color=color,
            depth=depth,
            skin=skin,
        )

    def sample(self) -> Sample:
        """Returns the observation and the truth at the current instant; the world must have been refreshed."""
        world = self.world
        return Sample(
            observation=self.observe(),
            T_palm_object=world.T_palm_object(),
            T_world_object=self.T_world_scene @ world.pose("object"),
            contacts_truth=world.tip_contacts(),
            phase=world.phase,
            dropped=world.dropped(),
            configuration=world.data.qpos.copy(),
        )

    def _due(self, per_second: float) -> bool:
        """Returns whether this sample has a measurement that comes at a rate [1/s]."""
        so_far = per_second / self.scenario.rate * np.array([self._samples - 1, self._samples]) + 1e-9
        return bool(np.floor(so_far[1]) > np.floor(so_far[0]))

    def _deflections(self) -> Array:
        """Returns the rotations of all joints (24,) that would move the tips as the loads deflect them [rad]."""
        found = np.zeros(len(self.world.scene.joints))
        if self.nuisances.tip_compliance == 0:
            return found
        model, data = self.world.scene.model, self.world.data
        for finger in FINGERS:
            T = self.world.pose(f"{finger}_tip")
            force = -T[:3, :3] @ self.world.reading(finger)[:3] - SCENE.tip_mass * GRAVITY
            center = T[:3, :3] @ [0, 0, tip_shape(finger)[1]] + T[:3, 3]
            jacobian = np.zeros((3, model.nv))
            mujoco_module().mj_jac(model, data, jacobian, None, center, model.body(f"{finger}_tip").id)
            of_finger = f"robot0:{finger.upper()}J"
            own = [i for i, name in enumerate(self.world.scene.joints) if name.startswith(of_finger)]
            J = jacobian[:, self._dofs[own]]
            # Damped by 1 mm, else a stretched finger would turn far to move its tip along itself.
            gram = J @ J.T + 1e-6 * np.eye(3)
            found[own] = J.T @ np.linalg.solve(gram, self.nuisances.tip_compliance * force)
        return found


def tip_biases(nuisances: Nuisances, seed: int) -> Array:
    """Returns constant errors (5, 6) of the fingers' wrenches [N, N m]: one finger's force is wrong, all else is 0."""
    rng = np.random.default_rng((seed, 12))
    gripping = ("ff", "mf", "th")  # the fingers that grip can and box alike
    finger, direction = rng.choice([FINGERS.index(name) for name in gripping]), rng.normal(size=3)
    bias = np.zeros((len(FINGERS), 6))
    bias[finger, :3] = nuisances.tip_bias * direction / np.linalg.norm(direction)
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
    world = World(scenario, grasp or grasp_for(scenario.object, int(scenario.seed), skin=scenario.skin))
    yield from samples(scenario, world, Sensors(scenario, world), progress)


def samples(
    scenario: Scenario, world: World, sensors: Sensors, progress: Callable[[float], None] | None = None
) -> Iterator[Sample]:
    """Yields samples of a world at the scenario's rate, as `simulate`; closes the sensors at the end."""
    every = round(SCENARIO.steps_per_second / scenario.rate)
    steps = round(world.duration * SCENARIO.steps_per_second)
    with closing(sensors):
        for step in range(steps + 1):
            if step:
                world.step()
            if step % every:
                continue
            world.refresh()
            if world.thrown():
                raise InvalidObject(
                    f"object: the simulator threw it away after {world.time:.1f} s, not the hand"
                )
            yield sensors.sample()
            if progress is not None:
                progress(step / steps)
