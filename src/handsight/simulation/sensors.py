"""The simulated world to what the robot measures of it, with all errors of its sensors."""

from collections import deque
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.observation import Observation, PoseMeasurement
from handsight.simulation.camera import believed_camera, displacement, kinect
from handsight.simulation.rendering import Renderer
from handsight.simulation.scenario import Nuisances, Scenario
from handsight.simulation.scene import FINGERS, GRAVITY, TIP_MASS, mujoco_module, tip_shape
from handsight.simulation.world import World

VISION_PER_SECOND, IMAGES_PER_SECOND = 10.0, 30.0
UNLOADED = np.array(
    [
        [0.21, -0.34, 0.12, 0.0021, -0.0013, 0.0008],
        [-0.15, 0.08, 0.43, -0.0009, 0.0017, -0.0011],
        [0.32, 0.17, -0.26, 0.0014, 0.0006, 0.0019],
        [-0.28, 0.24, 0.19, -0.0018, -0.0022, 0.0005],
        [0.09, -0.19, -0.37, 0.0007, 0.0012, -0.0016],
    ]
)
"""What each finger's sensor reads without load [N, N m]: calibration knows it."""


class Sensors:
    """Joints, wrenches, camera: errors that are constant are drawn at the start, noise at every sample."""

    def __init__(self, scenario: Scenario, world: World) -> None:
        """Draws by the scenario's seed, a stream for each sensor, so that none depends on another's settings."""
        self.scenario, self.world, self.nuisances = scenario, world, scenario.nuisances
        seed, n = int(scenario.seed), scenario.nuisances
        constant = np.random.default_rng((seed, 2))
        self._offsets = n.joint_offset * constant.normal(size=len(world.scene.joints))
        sigma_bias = np.repeat([n.force_bias, n.torque_bias], 3)
        sigma_drift = np.repeat([n.force_drift, n.torque_drift], 3)
        self._bias = UNLOADED + sigma_bias * constant.normal(size=(len(FINGERS), 6))
        self._drift = sigma_drift * constant.normal(size=(len(FINGERS), 6))
        self._noise = np.random.default_rng((seed, 3))
        self._vision = np.random.default_rng((seed, 5))
        self._grain = np.random.default_rng((seed, 6))
        # The scene stands on its table; the world is the robot's, which has the table elsewhere.
        self.T_world_scene = _table(n, np.random.default_rng((seed, 9)))
        self._T_camera_world = se3.inverse(believed_camera()) @ displacement(n, seed)
        self._past: deque[tuple[Array, Array]] = deque(maxlen=1 + round(n.vision_delay * scenario.rate))
        self._renderer = Renderer(world.scene) if scenario.images else None
        self._samples = 0
        self._angles = list(world.scene.joints.values())
        self._own = {finger: _joints_of(finger, list(world.scene.joints)) for finger in FINGERS}
        self._dofs = np.array(list(world.scene.dofs.values()))

    def close(self) -> None:
        """Frees what drew the images."""
        if self._renderer is not None:
            self._renderer.close()

    def observe(self) -> Observation:
        """What is measured now; the world must have been refreshed."""
        self._past.append((self.T_world_scene @ self.world.pose("object"), self.world.data.qpos.copy()))
        T_world_object, configuration = self._past[0]  # as old as the delay, or the oldest there is
        vision = self._vision_pose(T_world_object) if self._due(VISION_PER_SECOND) else None
        images = {}
        if self._renderer is not None and self._due(IMAGES_PER_SECOND):
            images = self._images(self._renderer, configuration)
        self._samples += 1
        # A load bends the tip, which the joints do not tell: it is as if they were turned the other way.
        bent = self._bent()
        joints = self.world.data.qpos[self._angles] + self._offsets - bent
        joints = joints + self.nuisances.joint_noise * self._noise.normal(size=len(joints))
        return Observation(
            stamp=self.world.time,
            joint_positions=dict(zip(self.world.scene.joints, joints.tolist(), strict=True)),
            wrenches=self._wrenches(),
            vision=vision,
            T_world_palm=self.T_world_scene @ self.world.pose("palm"),
            **images,
        )

    def _due(self, per_second: float) -> bool:
        """Whether something that comes so often comes with this sample."""
        so_far = per_second / self.scenario.rate * np.array([self._samples - 1, self._samples]) + 1e-9
        return bool(np.floor(so_far[1]) > np.floor(so_far[0]))

    def _wrenches(self) -> dict[str, Array]:
        sigma = np.repeat([self.nuisances.force_noise, self.nuisances.torque_noise], 3)
        noise = sigma * self._noise.normal(size=(len(FINGERS), 6))
        wrong = self._bias + self._drift * self.world.time + noise
        return {finger: self.world.reading(finger) + row for finger, row in zip(FINGERS, wrong, strict=True)}

    def _bent(self) -> Array:
        """By how much the joints (24,) would have to turn to bring the tips where loads have bent them [rad]."""
        bent = np.zeros(len(self.world.scene.joints))
        if self.nuisances.tip_compliance == 0:
            return bent
        model, data = self.world.scene.model, self.world.data
        for finger in FINGERS:
            T = self.world.pose(finger)
            force = -T[:3, :3] @ self.world.reading(finger)[:3] - TIP_MASS * GRAVITY
            center = T[:3, :3] @ [0, 0, tip_shape(finger)[1]] + T[:3, 3]
            jacobian = np.zeros((3, model.nv))
            mujoco_module().mj_jac(model, data, jacobian, None, center, self.world.scene.bodies[finger])
            own = self._own[finger]
            J = jacobian[:, self._dofs[own]]
            # Damped by 1 mm, else a stretched finger would turn far to give way along itself.
            gram = J @ J.T + 1e-6 * np.eye(3)
            bent[own] = J.T @ np.linalg.solve(gram, self.nuisances.tip_compliance * force)
        return bent

    def _vision_pose(self, T_world_object: Array) -> PoseMeasurement:
        sigma = np.repeat([self.nuisances.vision_position, self.nuisances.vision_rotation], 3)
        T_camera_object = self._T_camera_world @ T_world_object
        return PoseMeasurement(se3.moved(T_camera_object, sigma * self._vision.normal(size=6)), "camera")

    def _images(self, renderer: Renderer, configuration: Array) -> dict[str, Any]:
        T_scene_camera = se3.inverse(self._T_camera_world @ self.T_world_scene)
        color, depth = renderer.take(configuration, T_scene_camera)
        return {"color": color, "depth": kinect(depth, self.nuisances.depth_noise, self._grain)}


def _table(nuisances: Nuisances, rng: np.random.Generator) -> Array:
    """T_world_scene (4, 4): how far the table is from where the robot has it."""
    height, *tilt = rng.normal(size=3)
    turn = se3.rotation_exp(nuisances.table_tilt * np.array([*tilt, 0.0]))
    return se3.compose(turn, np.array([0.0, 0.0, nuisances.table_height * height]))


def _joints_of(finger: str, names: list[str]) -> list[int]:
    """Which of the joints move that finger."""
    return [i for i, name in enumerate(names) if name.startswith(f"robot0:{finger.upper()}J")]
