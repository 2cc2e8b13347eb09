"""The robot's own knowledge: its rig and its model of the object, as a user would write them down."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handsight import se3
from handsight.contact import Ellipsoid, WrenchCalibration
from handsight.hand import Hand
from handsight.objects import ObjectModel, ObjectSpec
from handsight.rig import Finger, MountedCamera, Rig, Table, Topics
from handsight.simulation import scene
from handsight.simulation.camera import CALIBRATED_CAMERA, INTRINSICS
from handsight.simulation.scenario import FINGERS, OBJECT_MASS, Nuisances, Scenario
from handsight.simulation.taxels import surfaces


def rig_of(scenario: Scenario) -> Rig:
    """Returns the robot's rig: calibrated sensors, the camera as calibrated, and the sigmas of default nuisances.

    It is the same for all seeds and nuisances, for a robot's errors are not in its rig file. Of a user's own rig,
    hand, sensors and their topics stay. Raises MissingExtra without mujoco or gymnasium-robotics.
    """
    usual = Nuisances()
    own = scenario.rig
    if own is None:
        wrenches = scenario.sensors == "wrench"
        own = Rig(
            hand=_hand(),
            fingers={finger: _finger(finger, sensing=wrenches) for finger in FINGERS},
            sigma_joint_offset=usual.joint_offset,
            sigma_joint=usual.joint_noise,
            topics=Topics(wrenches={finger: f"/{finger}/wrench" for finger in FINGERS if wrenches}),
        )
    skin = surfaces(scenario.sensors, scenario.skin)
    images: dict[str, Any] = {}
    if scenario.images:
        images = {name: f"/camera/{name}" for name in ("color", "depth", "camera_info")}
    declared: Any = {"center_of_mass": "homogeneous", "sigma_center_of_mass": 1e-3}
    return replace(
        own,
        camera=MountedCamera(
            T_mount_camera=CALIBRATED_CAMERA,
            intrinsics=INTRINSICS,
            size=scene.IMAGE_SIZE,
            depth_camera=scenario.depth_camera,
            sigma_position=usual.vision_position,
            sigma_rotation=usual.vision_rotation,
            sigma_position_constant=usual.camera_height,
            sigma_rotation_constant=usual.camera_rotation,
            # Images of nearly the same time share as much of a real camera's error.
            sigma_position_correlated=usual.vision_position,
            sigma_rotation_correlated=usual.vision_rotation,
        ),
        table=Table(height=0.0, sigma_height=usual.table_height, sigma_tilt=usual.table_tilt),
        gravity=scene.GRAVITY,
        world_from="tf",
        frames={name: name for name in ("world", "palm", "camera")},
        topics=Topics(
            joint_states=own.topics.joint_states,
            wrenches=own.topics.wrenches,
            truth="/truth/object",
            skin={name: f"/{name}/taxels" for name in skin},
            **images,
        ),
        skin=skin,
        objects={
            "can": ObjectSpec(cylinder=scene.CAN_SIZE, **declared),
            "box": ObjectSpec(box=scene.BOX_SIZE, **declared),
        },
    )


def model_of(scenario: Scenario) -> ObjectModel:
    """Returns the robot's model of the object, of the size and with the weight that the scenario's nuisances say.

    The model of a mesh is its convex hull, which is simulated. Raises InvalidFile, InvalidObject for an unusable mesh.
    """
    n = scenario.nuisances
    if scenario.object == "can":
        radius, height = scene.CAN_SIZE
        model = ObjectModel.cylinder(n.object_scale * radius, n.object_scale * height)
    elif scenario.object == "box":
        model = ObjectModel.box(n.object_scale * np.array(scene.BOX_SIZE))
    else:
        vertices, faces = scene.convex_hull(scenario.object)
        model = ObjectModel.from_mesh(n.object_scale * vertices, faces)
    if not n.declared_mass:
        return model
    mass, sigma = declared_weight(n)
    return model.with_weight(mass=mass, center_of_mass=model.volume_centroid, sigma_center_of_mass=sigma)


def declared_weight(nuisances: Nuisances) -> tuple[float, float]:
    """Returns the object's mass as the robot has it [kg], and the true sigma of its homogeneous centre [m]."""
    n = nuisances
    sigma = float(np.hypot(1e-3, n.object_off_center / np.sqrt(3)))
    return n.declared_mass * (n.object_mass or OBJECT_MASS), sigma


@cache
def _hand() -> Hand:
    scene.hand_file()  # raises MissingExtra where it is absent
    tips = {finger: f"robot0:{finger}distal" for finger in FINGERS}
    return Hand.from_file(f"package://gymnasium_robotics/{scene.HAND_FILE}", palm=scene.PALM, tips=tips)


def _finger(name: str, *, sensing: bool) -> Finger:
    """Returns a finger of the Shadow hand, with a force/torque sensor or without one."""
    semi_axes, center_z = scene.tip_shape(name)
    center = np.array([0.0, 0.0, center_z])
    sensor: dict[str, Any] = {}
    if sensing:
        force, torque = scene.UNLOADED[FINGERS.index(name)].reshape(2, 3)
        calibration = WrenchCalibration(force, torque, scene.TIP_MASS, center, reading="on_tip")
        sensor = {"calibration": calibration, "full_scale": (50.0, 0.5)}
    cap = -semi_axes[2] / 2
    return Finger(
        frame=f"robot0:{name}distal",
        T_frame_surface=se3.translation([0, 0, scene.SENSOR_Z + center_z]),
        tip=Ellipsoid(semi_axes, cap, max_friction=1.2, T_surface_sensor=se3.translation(-center)),
        # The tip is exactly where its file has it; these cover its deflection by `tip_compliance`.
        sigma_point=2e-4,
        sigma_normal=math.radians(0.3),
        sigma_force=Nuisances().force_noise,
        sigma_torque=Nuisances().torque_noise,
        **sensor,
    )
