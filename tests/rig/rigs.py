"""A rig of two fingers with every key set, and its text, for the tests of rig files."""

from pathlib import Path

import numpy as np

from handsight import se3
from handsight.contact import Ellipsoid, Sphere, TactileSurface, WrenchCalibration
from handsight.hand import Hand
from handsight.objects import ObjectSpec
from handsight.rig import Finger, MountedCamera, Rig, Table, Topics
from handsight.rig.save import text

URDF = """<robot name="pinch">
  <link name="palm"/><link name="index_tip"/><link name="thumb_tip"/>
  <joint name="index" type="revolute"><parent link="palm"/><child link="index_tip"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1.6" effort="1" velocity="1"/></joint>
  <joint name="thumb" type="revolute"><parent link="palm"/><child link="thumb_tip"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1.6" effort="1" velocity="1"/></joint>
</robot>
"""
TIPS = {"index": "index_tip", "thumb": "thumb_tip"}


def hand(folder):
    """A hand that is written to a folder first."""
    path = Path(folder) / "pinch.urdf"
    if not path.exists():
        path.write_text(URDF)
    return Hand.from_file(path, palm="palm", tips=TIPS)


def finger(rng, name, numbers):
    """Everything of a finger drawn, its sizes from `numbers`."""
    a, b, c = numbers
    options = {"min_force": a, "T_surface_sensor": se3.random(rng, spread=0.05)}
    shape = (
        Sphere(0.01, cap=-0.002, **options)
        if name == "thumb"
        else Ellipsoid([0.009, 0.01, 0.02], max_friction=b, **options)
    )
    calibration = WrenchCalibration(
        bias_force=rng.normal(size=3),
        bias_torque=1e-3 * rng.normal(size=3),
        mass=c,
        center_of_mass=0.01 * rng.normal(size=3),
        residual_force=np.zeros(3),
        residual_torque=np.zeros(3),
        condition=1.0,
        reading="on_tip" if name == "thumb" else "on_sensor",
    )
    return Finger(
        frame=TIPS[name],
        T_frame_surface=se3.random(rng, spread=0.05),
        tip=shape,
        calibration=calibration,
        sigma_force=a,
        sigma_torque=b,
        sigma_point=c,
        sigma_normal=a / 10,
        full_scale=None if name == "thumb" else (30.0, b),
    )


def full(folder, seed=0, numbers=(0.1, 0.7, 0.004), world_from="joints"):
    """A rig in which nothing is as usual."""
    rng = np.random.default_rng(seed)
    a, b, c = numbers
    return Rig(
        hand=hand(folder),
        fingers={name: finger(rng, name, numbers) for name in TIPS},
        sigma_joint_offset=a,
        sigma_joint=b,
        camera=MountedCamera(
            on="palm",
            T_mount_camera=se3.random(rng),
            intrinsics=np.array([[500.5 + a, 0, 320.25], [0, 501.5 + b, 240.75], [0, 0, 1]]),
            size=(640, 480),
            lens=np.array([a, -b, c, -c, b][: 4 + seed % 2]),
            depth_camera="stereo",
            sigma_position=a,
            sigma_rotation=b,
            sigma_position_constant=c,
            sigma_rotation_constant=a + b,
            sigma_ray=c,
            sigma_position_correlated=b,
            sigma_rotation_correlated=c,
            correlation_time=1 + a,
            latency=a,
            sigma_latency=c,
        ),
        table=Table(height=-c, sigma_height=a, sigma_tilt=b),
        gravity=np.array([0.1, 9.7, c]),
        world_from=world_from,
        frames={"world": "map", "palm": 'a "palm": #1', "camera": "kamera é"},
        topics=Topics(
            joint_states="/js",
            wrenches={"index": "/a", "thumb": "/b: c"},
            vision="/see",
            tf="/moves",
            color="/c",
            depth="/d",
            camera_info="/i",
            truth="/t",
            skin={"the palm": "/skin"},
            detections="/boxes",
            mask="/labels",
            offsets={"/a": c, "/see": -b},
        ),
        skin={
            "the palm": TactileSurface.grid(
                frame="palm",
                T_frame_grid=se3.random(rng, spread=0.05),
                rows=3,
                columns=5,
                pitch=0.0035,
                threshold=a,
                full_scale=a + b,
                sigma_point=2.5e-4,
                sigma_normal=0.07,
                sigma_mount=7e-4,
                stiffness=6e7,
                sigma_stiffness=2e7,
            )
        },
        objects={
            "a box": ObjectSpec(box=(a, b, c)),
            "tin": ObjectSpec(cylinder=(a, b)),
            "bottle": ObjectSpec(name="mustard", label="12"),
            "mug": ObjectSpec(mesh=(Path(folder) / "mug.stl").absolute(), scale=c),
        },
    )


def rig_text(folder):
    """The text of the rig in which nothing is as usual."""
    return text(full(folder))
