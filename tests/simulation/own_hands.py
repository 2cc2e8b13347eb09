"""Rigs of hands for the tests of the simulation: one that is written here, and those of real hands' files."""

from dataclasses import replace
from pathlib import Path

import handsight as hs
from hand.hands import data_file

FILES = {
    "allegro": "allegro_hand/allegro_hand_right.urdf",
    "leap_xela": "leap_hand/right_hand.xml",
    "dg5f": "dg5f_description/urdf/dg5f_right.urdf",
}
FINGER = """
  <link name="{0}_low"><collision><origin xyz="0 0 0.025"/><geometry><box size="0.014 0.014 0.04"/></geometry></collision></link>
  <link name="{0}_end"><collision><origin xyz="0 0 0.015"/><geometry><box size="0.012 0.012 0.02"/></geometry></collision></link>
  <joint name="{0}_knuckle" type="revolute"><parent link="palm"/><child link="{0}_low"/>
    <origin xyz="{1} {2} 0.02" rpy="0 0 {3}"/><axis xyz="0 1 0"/><limit lower="-0.9" upper="0.9" effort="1" velocity="1"/></joint>
  <joint name="{0}_middle" type="revolute"><parent link="{0}_low"/><child link="{0}_end"/>
    <origin xyz="0 0 0.05"/><axis xyz="0 1 0"/><limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>{4}</joint>"""
ARM = """
  <link name="base"/>
  <joint name="wrist" type="continuous"><parent link="base"/><child link="palm"/><origin xyz="0.1 0 0.4" rpy="0.2 0 0.5"/>
    <axis xyz="0 0 1"/></joint>"""


def written(folder, *, reading="on_tip", arm="", follows=None):
    """The rig file of a hand with a finger against two others; each bends at two joints, towards the middle or away.

    `follows`: the ratio by which the second joint follows the first one, and the position at which it begins; None: it
    has its own motor."""
    fingers = {"one": (-0.045, 0.0, 0.0), "two": (0.045, 0.025, 3.14159), "three": (0.045, -0.025, 3.14159)}
    mimic = '<mimic joint="{}_knuckle" multiplier="{}" offset="{}"/>'
    coupled = {name: mimic.format(name, *follows) if follows else "" for name in fingers}
    parts = "".join(FINGER.format(name, *place, coupled[name]) for name, place in fingers.items())
    palm = '<link name="palm"><collision><geometry><box size="0.1 0.08 0.02"/></geometry></collision></link>'
    (folder / "claw.urdf").write_text(f'<robot name="claw">{arm}{palm}{parts}</robot>')
    tips = "".join(
        f"""
  {name}:
    frame: {name}_end
    surface: {{position: [0, 0, 0.035]}}
    tip: {{sphere: 0.01, cap: -0.006, max_friction: 1.2}}
    sensor: {{pose: {{position: [0.001, 0, 0.02], quaternion_xyzw: [0, 0, 1, 0]}}, reading: {reading},
      bias: {{force: [0.1, 0, 0.2], torque: [0, 0.001, 0]}}, tip_mass: 0.01, tip_center: [0.001, 0, 0.012]}}"""
        for name in fingers
    )
    topics = "".join(f"\n    {name}: /claw/{name}" for name in fingers)
    text = "version: 1\nhand: {file: claw.urdf, palm: palm, joint_offset_deg: 0.5, joint_noise_deg: 0.05}\n"
    text += f"fingers:{tips}\ntopics:\n  joint_states: /claw/joints\n  wrenches:{topics}\n"
    (folder / "claw.rig.yaml").write_text(text)
    return folder / "claw.rig.yaml"


def real(name, monkeypatch):
    """The rig of an example, with a force/torque sensor in each tip; skipped where the hand's file is absent."""
    file = data_file(f"hands/{FILES[name]}")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(file.parents[FILES[name].count("/")]))
    rig = hs.Rig.from_file(Path(hs.__file__).with_name("data") / f"rigs/{name}.rig.yaml")
    wrenches = {finger: f"/{finger}/wrench" for finger in rig.fingers}
    return replace(rig, skin={}, topics=replace(rig.topics, skin={}, skin_fields={}, wrenches=wrenches))
