"""Malformed input is answered, or refused by an error of handsight of one printable line that names the field."""

import io
import json
import os
import zlib
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import handsight as hs
import malformed as m
from handsight.correction import Plane
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.objects import Library, read_shape
from handsight.recording import read_poses
from handsight.recording.frames import Beside, open_frames
from handsight.tracking import TrackerSettings
from handsight.vision import read_camera, read_depth

BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])
BOM = "\ufeff"
NEAR = hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1)
POINTS = [[0.03, 0.0, 0.0], [-0.03, 0.01, 0.02], [0.0, 0.045, -0.03]]


def at(x):
    T = np.eye(4)
    T[0, 3] = x
    return T


def changed(**fields):
    return m.PROBLEM | fields


def contact(**fields):
    return changed(contacts=[m.PROBLEM["contacts"][0] | fields])


def vision(**fields):
    return changed(vision=m.PROBLEM["vision"] | fields)


def wrenches(old, new, text=m.WRENCHES):
    assert old in text
    return text.replace(old, new)


def rig(old, new):
    assert old in m.RIG
    return m.RIG.replace(old, new)


def png(pixels):
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


DEPTH = png(np.full((24, 32), 700, np.uint16))
MASKED = np.ma.masked_less(POINTS, 0)
TWICE = "{" + ",".join(f'"k{i % 20_000}": 1' for i in range(40_000)) + "}"
DEEP = json.dumps(m.PROBLEM).replace("[0.06, 0.09, 0.14]", "[" * 900 + "]" * 900)


@pytest.mark.parametrize(
    ("field", "line"),
    [
        pytest.param("k0", json.dumps({f"k{i}": i for i in range(40_000)}), id="40 000 unknown keys"),
        pytest.param("k0", TWICE, id="keys twice"),
        pytest.param("object.box", DEEP, id="900 deep"),
        pytest.param("object.mesh", changed(object={"mesh": "\ud800.ply"}), id="half a surrogate in a name"),
        pytest.param("line", changed(**{"\ud800": 1}), id="half a surrogate in a key"),
        pytest.param("method", changed(method="\ud800"), id="a method so named"),
        pytest.param("object.box[0]", changed(object={"box": [10**400, 1, 1]}), id="400 digits"),
        pytest.param("object.box", changed(object={"box": [0.06, 0.09]}), id="of wrong shape"),
        pytest.param("contacts[0].point", contact(point=[np.nan, 0, 0.1]), id="NaN"),
        pytest.param("contacts[0].point", contact(point=[np.inf, 0, 0.1]), id="infinite"),
        pytest.param("contacts[0].point", contact(point=[31, 0, 100]), id="millimetres"),
        pytest.param("contacts[0].sigma_point", contact(sigma_point=200), id="a sigma in millimetres"),
        pytest.param("contacts[0].sigma_normal_deg", contact(sigma_normal_deg=400), id="400 degrees"),
        pytest.param("vision.position", vision(position=[20, 0, 100]), id="vision in millimetres"),
        pytest.param("vision.quaternion_xyzw", vision(quaternion_xyzw=[1, 2, 0, 0]), id="no quaternion"),
        pytest.param("line", BOM + BOM + json.dumps(m.PROBLEM), id="two marks of UTF-8"),
        pytest.param("line", json.dumps(m.PROBLEM)[:-9], id="cut"),
        pytest.param("line", b"\xff\xfe" + json.dumps(m.PROBLEM).encode(), id="bytes of no text"),
    ],
)  # fmt: skip
def test_a_line_of_problems_is_refused_by_its_field(field, line):
    with pytest.raises(InvalidInput) as refused:
        m.solve(line)
    m.check_refusal(refused.value)
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("kind", "table"),
    [
        pytest.param("csv", BOM + BOM + m.WRENCHES, id="two marks of UTF-8"),
        pytest.param("csv", wrenches("0.1,0", f"{BOM}0.1,0"), id="a mark in a cell"),
        pytest.param("csv", "0" * 10**6, id="a line of a million zeros"),
        pytest.param("csv", wrenches("0.1,0,-1", "0.1,0,-1e300"), id="1e300 N"),
        pytest.param("jsonl", wrenches("0.0012", "1e300", m.WRENCH_LINES), id="1e300 N m"),
        pytest.param("jsonl", wrenches('"stamp": 2', '"stamp": NaN', m.WRENCH_LINES), id="a stamp of NaN"),
        pytest.param("jsonl", wrenches('"ff"', '"\\ud800"', m.WRENCH_LINES), id="half a surrogate"),
        pytest.param("jsonl", wrenches('"torque"', '"force"', m.WRENCH_LINES), id="a key twice"),
    ],
)
def test_a_table_of_wrenches_is_refused(kind, table):
    with pytest.raises(InvalidFile) as refused:
        m.sense(table, kind)
    m.check_refusal(refused.value)


@pytest.mark.parametrize(
    "bring",
    [
        lambda folder: m.solve(BOM + json.dumps(m.PROBLEM)),
        lambda folder: m.sense(BOM + m.WRENCHES),
        lambda folder: m.sense(BOM + m.WRENCH_LINES, "jsonl"),
        lambda folder: m.rig(folder, BOM + m.RIG),
        lambda folder: m.shape(folder, "a.obj", BOM + m.OBJ),
        lambda folder: m.shape(folder, "a.off", BOM + m.OFF),
        lambda folder: m.shape(folder, "a.xyz", BOM + m.XYZ),
        lambda folder: read_poses(m.written(folder, "a.csv", BOM + m.POSES)),
    ],
    ids=["problems", "wrenches", "wrench-lines", "rig", "obj", "off", "xyz", "poses"],
)
def test_one_mark_of_utf_8_before_a_file_is_no_fault(tmp_path, bring):
    bring(tmp_path)


NO_FILES = {
    "folder": os.mkdir,
    "pipe": os.mkfifo,
    "device": lambda path: os.symlink("/dev/zero", path),
    "circle of links": lambda path: os.symlink(path, path),
    "nothing": lambda path: None,
}
READERS = {"a.stl": read_shape, "a.yaml": hs.Rig.from_file, "a.json": read_camera, "a.png": read_depth}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_refused(tmp_path, kind, name):
    NO_FILES[kind](tmp_path / name)
    with pytest.raises(InvalidFile) as refused:
        READERS[name](tmp_path / name)
    m.check_refusal(refused.value)


@pytest.mark.parametrize(
    ("field", "call"),
    [
        ("points", lambda: hs.Contacts(MASKED)),
        ("points", lambda: hs.Contacts([[np.nan, 0, 0]])),
        ("points", lambda: hs.Contacts([[31, 0, 100]])),
        ("points", lambda: hs.Contacts([[0, 0]])),
        ("sigma_point", lambda: hs.Contacts(POINTS, sigma_point=1e155)),
        ("sigma_normal", lambda: hs.Contacts(POINTS, [[0, 0, 1]] * 3, sigma_normal=5.0)),
        ("sigma_rotation", lambda: hs.PosePrior.from_sigmas(np.eye(4), 0.01, 15.0)),
        ("sigma_position", lambda: hs.PosePrior.from_sigmas(np.eye(4), 1e160, 0.1)),
        ("vision.T_palm_object", lambda: hs.PosePrior.from_sigmas(at(1e20), 0.01, 0.1)),
        ("vision.T_palm_object", lambda: hs.PosePrior.from_sigmas(np.diag([1.0, 1, -1, 1]), 0.01, 0.1)),
        ("outside", lambda: hs.correct_pose(BOX, hs.Contacts(POINTS), vision=NEAR, outside=[[1e200, 0, 0]])),
        ("outside", lambda: hs.correct_pose(BOX, hs.Contacts(POINTS), vision=NEAR, outside=np.ones((20_000, 3)))),
        ("plane.sigma", lambda: Plane([0, 0, 0], [0, 0, 1], 1e-12)),
        ("vertices", lambda: hs.ObjectModel.from_mesh(np.ma.masked_less(BOX.vertices, -0.06), BOX.faces)),
        ("center_of_mass", lambda: BOX.with_weight(center_of_mass=[0, 0, 20.0])),
        ("settings.rate", lambda: TrackerSettings(rate=0.0)),
        ("depth", lambda: hs.Camera(np.diag([60.0, 60, 1]), (64, 48)).points(np.ma.masked_less(np.ones((48, 64)), 2))),
    ],
)  # fmt: skip
def test_an_argument_is_refused_by_its_name(field, call):
    with pytest.raises(InvalidInput) as refused:
        call()
    m.check_refusal(refused.value)
    assert refused.value.field.startswith(field)


def test_a_mask_of_nothing_is_no_fault():
    assert len(hs.Contacts(np.ma.masked_invalid(POINTS))) == 3


@pytest.mark.parametrize(
    "data",
    [DEPTH[:60], png(np.zeros((24, 32), np.uint8)), b"", DEPTH.replace(b"IDAT", b"IDAX"),
     DEPTH[:16] + b"\x00\x0f\xff\xff\x00\x0f\xff\xff" + DEPTH[24:29]
     + zlib.crc32(b"IHDR\x00\x0f\xff\xff\x00\x0f\xff\xff" + DEPTH[24:29]).to_bytes(4, "big") + DEPTH[33:]],
    ids=["cut", "of 8 bits", "empty", "without pixels", "of a million rows"],
)  # fmt: skip
def test_a_depth_image_is_refused(tmp_path, data):
    with pytest.raises(InvalidFile) as refused:
        read_depth(m.written(tmp_path, "a.png", data))
    m.check_refusal(refused.value)


@pytest.mark.parametrize(
    "key", ["../../etc/passwd", "", "-1", "01", "1.0", "1e3", "²", " 1", "9" * 4000, "1\0", "true"]
)
def test_only_numbers_name_models_of_a_library(tmp_path, key):
    m.written(tmp_path, "models_info.json", json.dumps({key: {"diameter": 1.0}}))
    with pytest.raises(InvalidFile) as refused:
        Library(tmp_path).entries()
    m.check_refusal(refused.value)


@pytest.mark.parametrize(
    "camera", [{"cx": 1e300}, {"fx": 1e-300}, {"lens": [1e308] * 8}, {"width": 10**9}, {"lens_": [1.0]}]
)
def test_a_camera_is_refused(tmp_path, camera):
    with pytest.raises(InvalidFile) as refused:
        read_camera(m.written(tmp_path, "a.json", json.dumps(m.CAMERA | camera)))
    m.check_refusal(refused.value)


# Formats that are parsed here: whatever is in them, a door answers or refuses.


def scene(folder, content):
    (folder / "000001" / "depth").mkdir(parents=True, exist_ok=True)
    m.written(folder / "000001", "depth/000000.png", DEPTH)
    m.written(folder / "000001", "scene_camera.json", content)
    list(open_frames(folder / "000001", Beside()).each)


SCENE = {"0": {"cam_K": [30.5, 0, 15.5, 0, 30.0, 11.5, 0, 0, 1], "depth_scale": 1.0}}
TEXTS = {
    "problems": (json.dumps(m.PROBLEM), lambda folder, text: m.solve(text)),
    "wrenches": (m.WRENCHES, lambda folder, text: m.sense(text)),
    "wrench lines": (m.WRENCH_LINES, lambda folder, text: m.sense(text, "jsonl")),
    "rig": (m.RIG, m.rig),
    "robot": (m.URDF, m.hand),
    "obj": (m.OBJ, lambda folder, text: m.shape(folder, "a.obj", text)),
    "off": (m.OFF, lambda folder, text: m.shape(folder, "a.off", text)),
    "xyz": (m.XYZ, lambda folder, text: m.shape(folder, "a.xyz", text)),
    "camera": (json.dumps(m.CAMERA), lambda folder, text: read_camera(m.written(folder, "a.json", text))),
    "poses": (m.POSES, lambda folder, text: read_poses(m.written(folder, "a.csv", text))),
    "scene": (json.dumps(SCENE), scene),
}


def enter(door, folder, content):
    """A door answers, or refuses in one line; any other error fails the test."""
    try:
        door(folder, content)
    except HandsightError as error:
        m.check_refusal(error)


@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=60, derandomize=True)
@given(data=st.data())
def test_spoilt_text_is_answered_or_refused(tmp_path_factory, name, data):
    valid, door = TEXTS[name]
    enter(door, tmp_path_factory.getbasetemp(), data.draw(m.spoilt_texts(valid)))


@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=20, derandomize=True)
@given(data=st.data())
def test_spoilt_bytes_are_answered_or_refused(tmp_path_factory, name, data):
    valid, door = TEXTS[name]
    enter(door, tmp_path_factory.getbasetemp(), data.draw(m.spoilt_bytes(valid.encode())))


@pytest.mark.parametrize(("name", "value"), [("problems", m.PROBLEM), ("camera", m.CAMERA), ("scene", SCENE)])
@settings(max_examples=80, derandomize=True)
@given(data=st.data())
def test_spoilt_values_are_answered_or_refused(tmp_path_factory, name, value, data):
    content = json.dumps(data.draw(m.spoilt_values(value)), default=str)
    enter(TEXTS[name][1], tmp_path_factory.getbasetemp(), content)


@settings(max_examples=60, derandomize=True)
@given(data=st.data())
def test_a_spoilt_depth_image_is_answered_or_refused(tmp_path_factory, data):
    path = m.written(tmp_path_factory.getbasetemp(), "a.png", data.draw(m.spoilt_bytes(DEPTH)))
    with suppress(HandsightError):
        found = read_depth(path)
        assert (np.isnan(found) | (found > 0)).all()
