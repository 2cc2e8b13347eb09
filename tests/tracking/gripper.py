"""A gripper with two slides that holds a box under a camera, and valid observations of it."""

import functools
import math
import tempfile
from pathlib import Path

import numpy as np

import handsight as hs
from handsight import se3
from handsight.contact import Sphere, WrenchCalibration
from handsight.hand import Hand
from handsight.observation import PoseMeasurement
from handsight.rig import Finger, MountedCamera, Rig

GRIPPER = """<robot name="gripper">
  <link name="world"/><link name="palm"/><link name="left_tip"/><link name="right_tip"/>
  <joint name="wrist" type="continuous"><parent link="world"/><child link="palm"/><axis xyz="0 0 1"/></joint>
  <joint name="left" type="prismatic"><parent link="palm"/><child link="left_tip"/>
    <origin xyz="0.04 0 0.1"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="right" type="prismatic"><parent link="palm"/><child link="right_tip"/>
    <origin xyz="-0.04 0 0.1"/><axis xyz="-1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""
BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])
T_PALM_BOX = se3.compose(np.eye(3), np.array([0.0, 0.0, 0.1]))
PUSHED = np.array([0.0, 0.0, -2.0, 0.0, 0.0, 0.0])
"""The wrench of a contact at a tip's pole [N, N m]; a hundredth of it is too weak for a contact."""


@functools.cache
def gripper(world_from="tf"):
    """Returns the rig; its tips, of 10 mm radius, touch the box while the joints are at zero."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gripper.urdf"
        path.write_text(GRIPPER)
        tips = {"left": "left_tip", "right": "right_tip"}
        hand = Hand.from_file(path, palm="palm", tips=tips)
    none = WrenchCalibration(*(np.zeros(3),) * 2, 0.0, *(np.zeros(3),) * 3, 1.0, "on_sensor")
    towards = {"left": [0.0, -math.pi / 2, 0.0], "right": [0.0, math.pi / 2, 0.0]}
    fingers = {
        name: Finger(
            frame=tips[name],
            T_frame_surface=se3.compose(se3.rotation_exp(np.array(turn)), np.zeros(3)),
            tip=Sphere(0.01),
            calibration=none,
        )
        for name, turn in towards.items()
    }
    return Rig(
        hand=hand, fingers=fingers, camera=MountedCamera(sigma_position_constant=0.003), world_from=world_from
    )


def observed(stamp, *, touching=True, visible=False, T_world_palm=None):
    """Returns a valid observation; `visible`: with a pose of the box that is off by 2 mm and 2 mrad per axis."""
    T = np.eye(4) if T_world_palm is None else T_world_palm
    force = PUSHED if touching else 0.01 * PUSHED
    return hs.Observation(
        stamp,
        {"wrist": 0.0, "left": 0.0, "right": 0.0},
        {"left": force.copy(), "right": force.copy()},
        PoseMeasurement(T @ se3.moved(T_PALM_BOX, np.full(6, 0.002))) if visible else None,
        T.copy(),
    )
