"""Robots for the tests of the hand, and what other programs say of them."""

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from handsight.hand import Hand

SHADOW = "package://gymnasium_robotics/envs/assets/hand/reach.xml"
SHADOW_TIPS = {finger: f"robot0:{finger}distal" for finger in ("ff", "mf", "rf", "lf", "th")}
ALLEGRO_TIPS = {
    name: f"link_{k}.0_tip" for name, k in {"index": 3, "middle": 7, "ring": 11, "thumb": 15}.items()
}

# An arm of a turn and a slide, a palm that is bolted on beside the fingers' root, a finger that turns and one that slides.
ROBOT = """<robot name="two fingers">
  <link name="base"/>
  <link name="arm"/>
  <link name="mount">
    <visual><geometry><mesh filename="package://two_fingers/meshes/not_there.stl"/></geometry></visual>
    <collision><origin xyz="0 0 0.01"/><geometry><box size="0.06 0.04 0.02"/></geometry></collision>
  </link>
  <link name="palm"><visual><geometry><mesh filename="meshes/palm.dae"/></geometry></visual></link>
  <link name="turning">
    <visual><geometry><sphere radius="1"/></geometry></visual>
    <collision><origin xyz="0 0 0.02"/><geometry><cylinder radius="0.008" length="0.04"/></geometry></collision>
  </link>
  <link name="sliding"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
  <link name="far"/>
  <joint name="shoulder" type="continuous">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0.5" rpy="0.1 0 0"/><axis xyz="0 1 1"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="arm"/><child link="mount"/><axis xyz="0 0 1"/><limit lower="0" upper="0.3" effort="1" velocity="1"/>
  </joint>
  <joint name="bolt" type="fixed">
    <parent link="mount"/><child link="palm"/><origin xyz="0 0.01 0.03" rpy="0.2 0.3 0.4"/>
  </joint>
  <joint name="knuckle" type="revolute">
    <parent link="mount"/><child link="turning"/><origin xyz="0.02 0 0.03" rpy="0 -0.3 0"/><axis xyz="0 1 0"/>
    <limit lower="-0.2" upper="1.6" effort="1" velocity="1"/>
  </joint>
  <joint name="jaw" type="prismatic">
    <parent link="mount"/><child link="sliding"/><origin xyz="-0.02 0 0.05"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.02" effort="1" velocity="1"/><mimic joint="knuckle" multiplier="0.01"/>
  </joint>
  <joint name="loose" type="floating"><parent link="turning"/><child link="far"/></joint>
  <transmission name="of no use"><type>anything</type></transmission>
</robot>
"""
ROBOT_TIPS = {"turning": "turning", "sliding": "sliding"}


def data_file(name):
    """A file of the data folder; the test is skipped where that is absent."""
    here = Path(__file__).parents[2]
    path = Path(os.environ.get("HANDSIGHT_DATA", here.parent / "shared" / "data")) / name
    if not path.exists():
        pytest.skip(f"{path} is not there: set HANDSIGHT_DATA to the folder with the test data")
    return path


def shadow_file():
    pytest.importorskip("mujoco")
    spec = find_spec("gymnasium_robotics")
    if spec is None:
        pytest.skip("the Shadow hand is in gymnasium-robotics, which is not installed")
    return Path(spec.origin).parent / "envs/assets/hand/reach.xml"


def shadow():
    shadow_file()
    return Hand.from_file(SHADOW, palm="robot0:palm", tips=SHADOW_TIPS)


def allegro_file():
    pytest.importorskip("mujoco")
    return data_file("hands/allegro_hand/allegro_hand_right.urdf")


def within_limits(hand, rng):
    """Positions of all joints of the file at random."""
    low, high = np.nan_to_num(hand.limits, posinf=np.pi, neginf=-np.pi).T
    return dict(zip(hand.joint_names, rng.uniform(low, high), strict=True))
