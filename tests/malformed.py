"""What malformed inputs are tried on: valid contents of each format, the doors that they enter by, and what spoils them."""

import io
import json
import math
import re
import struct
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

import handsight as hs
from handsight.batch.blocks import blocks
from handsight.batch.problems import Reader, answer_text
from handsight.contact import Sphere, convert
from handsight.errors import HandsightError, InvalidInput
from handsight.hand import Hand
from handsight.objects import read_shape

PROBLEM = {
    "object": {"box": [0.06, 0.09, 0.14]},
    "contacts": [
        {
            "point": [0.03, 0.01, 0.03],
            "normal": [1.0, 0.0, 0.0],
            "sigma_point": 0.001,
            "sigma_normal_deg": 5.0,
        },
        {"point": [-0.01, 0.045, 0.02], "normal": [0.0, 1.0, 0.0]},
        {"point": [0.01, 0.02, 0.07], "covariance": (1e-6 * np.eye(6)).tolist()},
    ],
    "vision": {
        "position": [0.02, -0.01, 0.015],
        "quaternion_xyzw": [0.025, 0.01, -0.02, 1.0],
        "sigma_position": 0.03,
        "sigma_rotation_deg": 15.0,
    },
    "outside": [[0.05, 0.1, 0.1], [0.2, 0.0, 0.0]],
}
WRENCHES = """stamp,finger,fx,fy,fz,tx,ty,tz
1712345678.123456789,ff,0.1,0,-1,0,0.0012,0.0001
2,"l,f",0,0,-0.01,0,0,0
3,th,3,0,-1,0,0.036,0
4,mf,0,,nan,0,0,0
"""
WRENCH_LINES = """{"stamp": 1.5, "finger": "ff", "force": [0.1, 0.0, -1.0], "torque": [0.0, 0.0012, 0.0001]}
{"stamp": 2, "finger": "ff", "force": [0.1, null, -1.0], "torque": [0.0, 0.0012, 0.0001]}
"""
URDF = """<robot name="pinch">
  <link name="palm"/>
  <link name="one"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>
  <link name="two"><collision><geometry><box size="0.01 0.02 0.03"/></geometry></collision></link>
  <joint name="a" type="revolute"><parent link="palm"/><child link="one"/><origin xyz="0 0.05 0" rpy="0 0 0.1"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1.6" effort="1" velocity="1"/></joint>
  <joint name="b" type="prismatic"><parent link="palm"/><child link="two"/><axis xyz="1 0 0"/></joint>
</robot>"""
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
      full_scale: [50, 0.5]
  two: {<<: *one, frame: two}
camera:
  pose: {position: [-0.45, 0.5, 0.6]}
  intrinsics: {width: 640, height: 480, fx: 525, fy: 525, cx: 319.5, cy: 239.5}
table: {height: 0.0, sigma_height: 0.003, sigma_tilt_deg: 1}
topics: {vision: /vision, wrenches: {one: /a, two: /b}}
objects: {can: {cylinder: {radius: 0.033, height: 0.122}}}
"""
CAMERA = {
    "fx": 30.5,
    "fy": 30.0,
    "cx": 15.5,
    "cy": 11.5,
    "width": 32,
    "height": 24,
    "lens": [-0.28, 0.07, 0, 0, 0],
}
POSES = "scene_id,im_id,obj_id,score,R,t,time\n1,0,5,0.9,1 0 0 0 1 0 0 0 1,10 -20 800,0.5\n"
CORNERS = np.array([[x, y, z] for x in (-30.0, 30) for y in (-45.0, 45) for z in (-25.0, 25)])
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


def rows(values: np.ndarray, before: str = "") -> str:
    """A line of text for each row."""
    return "".join(f"{before}{' '.join(map(str, row))}\n" for row in values.tolist())


OBJ = rows(CORNERS, "v ") + rows(SIDES + 1, "f ")
OFF = "OFF\n8 6 0\n" + rows(CORNERS) + rows(SIDES, "4 ")
XYZ = rows(np.random.default_rng(0).normal(size=(40, 3)).round(3))


def check_numbers(value: object) -> None:
    """Asserts that every number in an answer is finite."""
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            check_numbers(part)
    elif isinstance(value, float):
        assert math.isfinite(value), value


def solve(line: str | bytes | dict) -> None:
    """Answers a line of `handsight correct`; raises the refusal that it writes."""
    if isinstance(line, dict):
        line = json.dumps(line)
    data = line.encode("utf-8", "surrogatepass") if isinstance(line, str) else line
    for block in blocks(io.BytesIO(data)):
        for each in block:
            found = json.loads(answer_text(Reader(Path()), each))
            check_numbers(found)
            if "error" in found:
                raise InvalidInput(found["error"])


def sense(table: str | bytes, kind: str = "csv") -> None:
    """Converts a table of wrenches to contacts, as CSV or as JSON lines."""
    data = table.encode("utf-8", "surrogatepass") if isinstance(table, str) else table
    sink, source = io.StringIO(), io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
    convert(source, sink, Sphere(0.008, cap=0.0, max_friction=1.0), format=kind)
    if kind == "jsonl":
        for row in map(json.loads, sink.getvalue().splitlines()):
            check_numbers({key: value for key, value in row.items() if key not in ("stamp", "finger")})


def written(folder: Path, name: str, content: str | bytes) -> Path:
    """The path of a new file with this content."""
    path = folder / name
    path.write_bytes(content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content)
    return path


def shape(folder: Path, name: str, content: str | bytes) -> None:
    """Reads a mesh or a cloud, and builds no object of it."""
    found = read_shape(written(folder, name, content))
    assert found.vertices.ndim == 2
    assert len(found.vertices) < 10_000


def rig(folder: Path, content: str) -> None:
    """Reads a rig file beside a valid hand."""
    written(folder, "hand.xml", URDF)
    for finger in hs.Rig.from_file(written(folder, "rig.yaml", content)).fingers.values():
        assert np.isfinite(finger.T_frame_surface).all()


def hand(folder: Path, content: str) -> None:
    """Reads a robot's description, and moves the robot."""
    made = Hand.from_file(
        written(folder, "hand.xml", content), palm="palm", tips={"one": "one", "two": "two"}
    )
    assert np.isfinite(made.Ts_palm_tip(dict.fromkeys(made.moving, 0.3))).all()


def check_refusal(error: HandsightError) -> None:
    """Asserts that a refusal is one printable line of bounded length."""
    assert 0 < len(str(error)) < 2000
    assert str(error).isprintable()


NUMBERS = [0.0, -1.0, 1e-200, 5e-324, 1e20, 1.7e308, math.nan, math.inf, 2**63, -(2**64), 10**400]
VALUES = [
    *NUMBERS,
    None,
    True,
    "",
    "1",
    "\x1b[31mred\n",
    "\ud800",
    "\ufeff",
    [],
    {},
    [[]],
    [0.0],
    [[1.0, 2.0], [1.0]],
]
WORDS = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e999",
    "",
    "x",
    '"',
    "\x00",
    "\ufeff",
    "\x1b[31m",
    "9" * 400,
    "[",
    "{",
    "&a",
    "*a",
    "<<: *a",
    "!!python/object:os.x ",
    "---\n",
    "%YAML 1.1\n",
    "? ",
]


@st.composite
def spoilt_values(draw, value):
    """A value of JSON of which one part is replaced, dropped, repeated or scaled as by another unit."""
    if isinstance(value, dict) and value and draw(st.integers(0, 9)):
        key = draw(st.sampled_from(sorted(value)))
        rest = {name: each for name, each in value.items() if name != key}
        how = draw(st.sampled_from(["part", "part", "part", "drop", "add"]))
        if how == "add":
            return value | {draw(st.sampled_from([f"{key}s", "", "\x1b[2J", "__class__"])): 1}
        return rest if how == "drop" else rest | {key: draw(spoilt_values(value[key]))}
    if isinstance(value, list) and value and draw(st.integers(0, 9)):
        k = draw(st.integers(0, len(value) - 1))
        new = draw(st.sampled_from([[], 2 * [value[k]], 50 * [value[k]], None, None, None]))
        return [*value[:k], *([draw(spoilt_values(value[k]))] if new is None else new), *value[k + 1 :]]
    if isinstance(value, float) and draw(st.booleans()):
        return value * draw(st.sampled_from([1e3, 57.3, -1.0, 1e20, 1e160, 1e-160]))
    return draw(st.sampled_from(VALUES))


@st.composite
def spoilt_texts(draw, text):
    """A text of which a word or a line is replaced, dropped, repeated, or cut."""
    for _ in range(draw(st.integers(1, 3))):
        parts = re.split(r"([\s,:]+)", text) if draw(st.booleans()) else re.split(r"(\n)", text)
        k = draw(st.integers(0, len(parts) - 1))
        new = draw(st.sampled_from([*WORDS, 2 * parts[k], 100 * parts[k], parts[k][::-1], None]))
        text = "".join(parts[:k] if new is None else [*parts[:k], new, *parts[k + 1 :]])
    return text


@st.composite
def spoilt_bytes(draw, data):
    """Bytes that are cut, flipped, or have a number where a count may be."""
    at = draw(st.integers(0, len(data) - 1))
    number = struct.pack("<Q", draw(st.sampled_from([0, 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1])))
    flipped = bytes([data[at] ^ draw(st.integers(1, 255))])
    return draw(
        st.sampled_from(
            [data[:at], data[:at] + flipped + data[at + 1 :], data[:at] + number + data[at + 8 :], data[at:]]
        )
    )
