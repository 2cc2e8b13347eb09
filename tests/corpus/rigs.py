"""Rig files, robot descriptions, and the numbers of fingertips and their sensors."""

import random
import re
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import handsight as hs
from handsight.contact import (
    Ellipsoid,
    Sphere,
    calibrate_wrench,
    compensate,
    contact_from_wrench,
    contacts_from_wrenches,
)
from handsight.hand import Hand
from handsight.rig import layouts
from tests.corpus.door import NUMBERS, Case, Door, check_covariance, check_pose, spoilt_text, spoilt_value

URDF = """<robot name="pinch">
  <link name="palm"/>
  <link name="one"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
  <link name="two"><collision><geometry><box size="0.01 0.02 0.03"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="palm"/><child link="one"/><origin xyz="0 0.05 0" rpy="0 0 0.1"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1.6" effort="1" velocity="1"/></joint>
  <joint name="b" type="prismatic"><parent link="palm"/><child link="two"/><axis xyz="1 0 0"/></joint>
</robot>"""
MJCF = """<mujoco>
  <compiler angle="radian"/>
  <default><geom type="capsule" size="0.01 0.02"/></default>
  <worldbody><body name="palm" pos="0 0 0.1" quat="1 0 0 0">
    <geom type="ellipsoid" size="0.01 0.02 0.03"/>
    <body name="one" euler="0 0 0.3"><joint name="a" axis="0 1 0" range="-1 1" ref="0.1"/><geom/></body>
    <body name="two"><joint name="b" type="slide" axis="0 1 1"/><geom type="box" size="0.01 0.02 0.03"/></body>
  </body></worldbody>
</mujoco>"""
RIG = """version: 1
hand: {file: hand.xml, palm: palm, joint_offset_deg: 1, joint_noise_deg: 0.1}
fingers:
  one: &one
    frame: one
    surface: {position: [0.0, 0.0, 0.0165], quaternion_xyzw: [0.0, 0.0, 0.0, 1.0]}
    tip: {ellipsoid: [0.009, 0.009, 0.0145], min_force: 0.1, cap: -0.007, max_friction: 1.2}
    sigma_point: 0.0002
    sensor:
      pose: {position: [0.0, 0.0, 0.002]}
      reading: on_tip
      noise: {force: 0.01, torque: 5.0e-05}
      bias: {force: [0.21, -0.34, 0.12], torque: [0.0021, -0.0013, 0.0008]}
      tip_mass: 0.004
      full_scale: [50, 0.5]
  two: {<<: *one, frame: two}
camera:
  pose: {position: [-0.45, 0.5, 0.6]}
  noise: {position: 0.005, rotation_deg: 3}
  intrinsics: {width: 640, height: 480, fx: 525, fy: 525, cx: 319.5, cy: 239.5}
  lens: [-0.28, 0.07, 2.0e-4, 1.6e-5, 0.0]
  depth_camera: stereo
table: {height: 0.0, sigma_height: 0.003, sigma_tilt_deg: 1}
world: {palm_from: tf, gravity: [0.0, 0.0, -9.81]}
topics: {vision: /vision, wrenches: {one: /a, two: /b}}
objects: {can: {cylinder: {radius: 0.033, height: 0.122}}}
skin:
  pad: {frame: one, rows: 4, columns: 3, pitch: 0.004, radius: 0.02, components: 3, scale: [1, 1, 0.5], threshold: 0.1}
  tip: {frame: two, taxels: [[0, 0, 0.01, 0, 0, 1], [0, 0.004, 0.01, 0, 0.1, 1]], unit: m, threshold: 0.1}
"""
FOLDER = tempfile.TemporaryDirectory()


SENSORS = """<robot name="hand"><link name="palm"/>
  <sensor name="pad"><parent link="palm"/><origin xyz="0 0 0.03" rpy="0 1.5 0"/>
    <tactile><array rows="2" cols="3" order="row-major" size="0.005 0.004" offset="0.001 0"/></tactile></sensor>
  <sensor name="list"><parent link="palm"/><tactile><taxel idx="0" xyz="0.01 0 0" rpy="0 0.3 0"/>
    <taxel idx="1" xyz="0.01 0.004 0" rpy="0 0 0"/></tactile></sensor></robot>"""
TABLES = {
    "a.csv": "x,y,z,nx,ny,nz\n0,0,10,0,0,1\n0,4,10,0,0.1,1\n4,0,10,0.1,0,1\n",
    "a.json": '{"points": [[0, 0, 10, 0, 0, 1], [0, 4, 10, 0, 0.1, 1], [4, 0, 10, 0.1, 0, 1]]}',
}


def surface_spoilt(rng: random.Random) -> None:
    """Reads a layout of taxels from a damaged file or URDF, and touches it."""
    name = rng.choice([*TABLES, "sensors.urdf"])
    text = spoilt_text(TABLES[name], rng) if name in TABLES else spoilt_xml(SENSORS, rng)
    path = Path(FOLDER.name) / name
    path.write_bytes(text.encode("utf-8", "replace"))
    read = (
        layouts.from_file(name, path.parent, 1e-3)
        if name in TABLES
        else layouts.from_urdf(rng.choice(["pad", "list"]), SimpleNamespace(file=str(path)))
    )
    surface = read.surface(np.eye(4), None, {"frame": "palm", "threshold": 0.1})
    contacts = surface.touch(np.ones(surface.shape)).contacts(np.eye(4))
    assert contacts is not None
    for each in contacts.covariance:
        check_covariance(each)


def hand(text: str) -> None:
    """Reads a hand from a robot description, moves it and draws it."""
    path = Path(FOLDER.name) / "spoilt.xml"
    path.write_bytes(text.encode("utf-8", "replace"))
    made = Hand.from_file(path, palm="palm", tips={"one": "one", "two": "two"})
    for T in made.Ts_palm_tip(dict.fromkeys(made.moving, 0.3)):
        check_pose(T)
    assert np.isfinite(made.surface(20).points_body).all()


def spoilt_xml(text: str, rng: random.Random) -> str:
    """Returns XML with a word of an attribute replaced, an element repeated or dropped, or corrupted as any text."""
    if rng.random() < 0.3:
        return spoilt_text(text, rng)
    if rng.random() < 0.3:
        element = rng.choice(re.findall(r"<\w[^<>]*/>", text))
        return text.replace(element, rng.choice(["", element * 2, element * 30]), 1)
    at = rng.choice(list(re.finditer(r'="([^"]*)"', text)))
    words = at[1].split(" ")
    words[rng.randrange(len(words))] = str(
        rng.choice([*NUMBERS[:-1], "x", "", "palm", "one", "0.02", "ball"])
    )
    return f"{text[: at.start(1)]}{' '.join(words)}{text[at.end(1) :]}"


def rig(text: str) -> None:
    """Reads a rig file beside a valid hand."""
    folder = Path(FOLDER.name)
    (folder / "hand.xml").write_text(URDF)
    (folder / "rig.yaml").write_bytes(text.encode("utf-8", "replace"))
    made = hs.Rig.from_file(folder / "rig.yaml")
    for finger in made.fingers.values():
        check_pose(finger.T_frame_surface)


def touch(given: dict[str, object]) -> None:
    """Computes a contact, a batch of one, a calibration and a compensation from these arguments."""
    make = Sphere if "radius" in given else Ellipsoid
    tip = make(given.get("radius", given.get("semi_axes")), *(given.get(k) for k in ("cap", "friction")))  # type: ignore[arg-type]
    felt = contact_from_wrench(given.get("force"), given.get("torque"), tip, sigma_force=given.get("sigma"))  # type: ignore[arg-type]
    if felt:
        assert np.isfinite(felt.point).all()
        check_covariance(felt.covariance)
    batch = contacts_from_wrenches(given.get("forces"), given.get("torques"), tip)  # type: ignore[arg-type]
    assert np.isfinite(batch.points).all()
    assert np.isfinite(batch.covariances).all()
    known = calibrate_wrench(given.get("forces"), given.get("torques"), given.get("gravities"))  # type: ignore[arg-type]
    for left in compensate(given.get("forces"), given.get("torques"), given.get("gravities"), known):  # type: ignore[arg-type]
        assert np.isfinite(left).all()


G = 9.81 * np.vstack([np.eye(3), -np.eye(3)])
TOUCH: dict[str, object] = {
    "semi_axes": [0.008, 0.008, 0.012],
    "cap": -0.002,
    "friction": 1.2,
    "force": [0.1, 0.0, -1.0],
    "torque": [0.001, 0.002, 0.0],
    "sigma": 0.01,
    "forces": (0.1 + 0.02 * G).tolist(),
    "torques": (0.001 + np.cross([0.0, 0.0, 0.01], 0.02 * G)).tolist(),
    "gravities": G.tolist(),
}


def touch_spoilt(rng: random.Random) -> None:
    """Computes contacts with one or two corrupted values, or with a sphere for a fingertip."""
    given = dict(TOUCH)
    if rng.random() < 0.3:
        del given["semi_axes"]
        given["radius"] = 0.012
    for _ in range(rng.choice([0, 1, 1, 2])):
        key = rng.choice(sorted(given))
        given[key] = spoilt_value(given[key], rng)
    touch(given)


DOORS = [
    Door("a layout of taxels", surface_spoilt, 200),
    Door("urdf", lambda rng: hand(spoilt_xml(URDF, rng)), 100),
    Door("mjcf", lambda rng: hand(spoilt_xml(MJCF, rng)), 100),
    Door("rig.yaml", lambda rng: rig(spoilt_text(RIG, rng)), 60),
    Door("touch", touch_spoilt, 200),
]
CASES = [
    Case(
        "a surface in millimetres",
        lambda: rig(RIG.replace("0.0165", "16.5")),
        "millimetres? [0, 0, 0.0165] m",
    ),
    Case("an object in millimetres", lambda: rig(RIG.replace("0.033", "33")), "millimetres? 0.033 m"),
    Case(
        "two fingers on one body", lambda: rig(RIG.replace("frame: two", "frame: one")), "fingers.two.frame: "
    ),
    Case(
        "two fingers on one topic",
        lambda: rig(RIG.replace("/b", "/a")),
        "topics.wrenches.two: expected a topic",
    ),
    Case("a dense rig", lambda: rig("a: [" + "1," * 400_000), "expected at most 5000 values"),
    Case(
        "a size of a terabyte", lambda: hand(MJCF.replace("<default>", "<size memory='1T'/><default>")), None
    ),
    Case(
        "a model in itself",
        lambda: hand("<mujoco><asset><model file='spoilt.xml'/></asset></mujoco>"),
        "one model",
    ),
    Case(
        "an include of itself",
        lambda: hand("<mujoco><include file='spoilt.xml'/></mujoco>"),
        "each file once",
    ),
    Case(
        "two roots",
        lambda: hand(URDF.replace("<link", '<link name="x"/><link', 1)),
        "one link that all others",
    ),
    Case(
        "a million links", lambda: hand("<robot>" + "<link/>" * 10**6 + "</robot>"), "at most 50000 elements"
    ),
    Case("a deep robot", lambda: hand("<robot>" * 10**5), "at most 200 deep"),
    Case(
        "an axis of 1e308", lambda: hand(MJCF.replace('axis="0 1 0"', 'axis="0 1e308 0"')), "of some length"
    ),
    Case(
        "a sigma of 200 m",
        lambda: hs.Contacts([[0, 0, 0]], sigma_point=200.0) and None,
        "sigma_point: expected metres within 5, got 200 (millimetres? 0.2 m)",
    ),
    Case(
        "a normal's sigma in degrees",
        lambda: hs.Contacts([[0, 0, 0]], [[0, 0, 1]], sigma_normal=5.0) and None,
        "sigma_normal: expected radians within 3.142, got 5 (degrees? 0.08727 rad)",
    ),
    Case("a force of 1e20 N", lambda: touch({**TOUCH, "force": [0, 0, -1e20]}), "force: expected newtons"),
    Case(
        "a mass of a ton", lambda: touch({**TOUCH, "forces": (1e3 * G).tolist()}), "mass: expected kilograms"
    ),
]
