"""Depth, colour and intrinsics are what their files hold; what they cannot be is said in a sentence that begins with the file."""

import json
import sys

import numpy as np
import pytest
from PIL import Image

from hand.hands import data_file
from handsight.camera import Camera
from handsight.errors import InvalidFile, InvalidInput, MissingExtra
from handsight.vision import read_camera, read_color, read_depth
from handsight.vision.pixels import measured_depth
from testbed.refusals import refused

RNG = np.random.default_rng(0)
STEPS = RNG.integers(300, 9000, (6, 5)).astype(np.uint16)
STEPS[2, 3] = 0
INTRINSICS = {"fx": 300.5, "fy": 310, "cx": 2.25, "cy": 3, "width": 5, "height": 6}
CAMERA = Camera(np.array([[300.5, 0, 2.25], [0, 310, 3], [0, 0, 1]]), (5, 6))


def saved(folder, content, name="d.png"):
    """A file of an array (PNG, JPEG by its name), a mapping (JSON), or bytes."""
    path = folder / name
    if isinstance(content, np.ndarray):
        Image.fromarray(content).save(path)
    else:
        path.write_bytes(json.dumps(content).encode() if isinstance(content, dict) else content)
    return path


@pytest.mark.parametrize("scale", [1e-3, 1e-4, 2.5e-4])
def test_depth_is_steps_times_their_size_and_nan_where_there_is_none(tmp_path, scale):
    depth = read_depth(saved(tmp_path, STEPS), scale, camera=CAMERA)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, np.where(STEPS > 0, STEPS * scale, np.nan), rtol=1e-6)


@pytest.mark.parametrize("name", ["c.png", "c.jpg"])
def test_colour_is_red_green_blue(tmp_path, name):
    color = np.full((16, 16, 3), (200, 100, 50), np.uint8)
    np.testing.assert_allclose(read_color(saved(tmp_path, color, name)).astype(int), color, atol=3)
    grey = saved(tmp_path, np.full((4, 4), 9, np.uint8), name)
    np.testing.assert_array_equal(read_color(grey), np.full((4, 4, 3), 9))


def png(pixels, folder):
    return saved(folder, pixels, "whole.png").read_bytes()


@pytest.mark.parametrize(
    ("content", "options"),
    [
        (STEPS // 300, {}),
        (STEPS * 0 + 65000, {}),
        (STEPS, {"scale": 1e-6}),
        (STEPS * 0, {}),
        (STEPS.astype(np.uint8), {}),
        (np.zeros((6, 5, 3), np.uint8), {}),
        (STEPS[:, :4], {"camera": CAMERA}),
        (b"", {}),
        (b"nothing", {}),
    ],
)
def test_what_is_no_depth_image_is_refused(tmp_path, content, options):
    path = saved(tmp_path, content)
    with refused(InvalidFile, path.name):
        read_depth(path, **options)


def test_an_image_that_was_cut_is_none_unless_all_its_pixels_are_there(tmp_path):
    whole = png(RNG.integers(300, 9000, (60, 50)).astype(np.uint16), tmp_path)
    expected, read = read_depth(saved(tmp_path, whole)), 0
    for left in range(0, len(whole) - 40, 97):
        path = saved(tmp_path, whole[:left], "cut.png")
        with refused(InvalidFile, path.name):
            read_depth(path)
    for left in range(len(whole) - 40, len(whole)):
        try:
            np.testing.assert_array_equal(read_depth(saved(tmp_path, whole[:left], "cut.png")), expected)
            read += 1
        except InvalidFile:
            pass
    assert read > 0


@pytest.mark.parametrize("scale", [0, np.nan, 1000.0, "1"])
def test_a_scale_that_is_none_is_refused(tmp_path, scale):
    with refused(InvalidInput, "scale"):
        read_depth(saved(tmp_path, STEPS), scale)


def test_a_file_that_is_not_there_is_said(tmp_path):
    for read in (read_camera, read_depth, read_color):
        with refused(InvalidFile, "none"):
            read(tmp_path / "none")


def test_real_depth_is_read_in_metres():
    """Of a bottle within arm's reach, in whole millimetres."""
    depth = read_depth(data_file("m3t_rgbd/_sequence/depth_camera_image_200.png"))
    assert depth.shape == (480, 848)
    assert 0.3 < np.nanmedian(depth) < 3
    known = 1000 * depth[np.isfinite(depth)].astype(float)
    np.testing.assert_allclose(known, np.round(known), atol=2e-3)


def test_without_pillow_the_extra_is_named(tmp_path, monkeypatch):
    path = saved(tmp_path, STEPS)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with refused(MissingExtra, "images need pillow"):
        read_depth(path)


BIG = RNG.integers(400, 900, (48, 64)).astype(np.uint16)
HOLES = RNG.random(BIG.shape) < 0.3
HOLES[::4, ::4] = RNG.random((12, 16)) < 0.5  # wherever a sample of the pixels looks


@pytest.mark.parametrize("value", [65535, 30000])
def test_a_saturated_value_is_no_measurement_and_is_told(tmp_path, value):
    found = measured_depth(saved(tmp_path, np.where(HOLES, np.uint16(value), BIG)))
    np.testing.assert_allclose(found.depth, np.where(HOLES, np.nan, 1e-3 * BIG), rtol=1e-6)
    assert f"{100 * HOLES.mean():.0f} % of pixels are {value:g}" in found.note


@pytest.mark.parametrize("value", [np.inf, 10.0, 1000.0])
def test_a_far_plane_of_floats_is_no_measurement_and_is_told(tmp_path, value):
    path = tmp_path / "d.npy"
    np.save(path, np.where(HOLES, np.float32(value), (1e-3 * BIG).astype(np.float32)))
    found = measured_depth(path)
    np.testing.assert_allclose(found.depth, np.where(HOLES, np.nan, 1e-3 * BIG), rtol=1e-6)
    assert f"{value:g}" in found.note


def test_a_wall_before_the_camera_is_measured(tmp_path):
    wall = np.where(HOLES, np.uint16(950), BIG)
    found = measured_depth(saved(tmp_path, wall))
    np.testing.assert_allclose(found.depth, 1e-3 * wall, rtol=1e-6)
    assert found.note == ""


@pytest.mark.parametrize("kind", ["u16.tiff", "f32.tiff", "u16.npy", "f32.npy", "f64.npy", "columns.npy"])
def test_depth_is_the_same_in_every_format(tmp_path, kind):
    pixels = BIG if kind.startswith("u16") else 1e-3 * BIG
    pixels = pixels.astype(
        np.float64 if kind == "f64.npy" else pixels.dtype if kind[0] == "u" else np.float32
    )
    path = tmp_path / kind
    if kind.endswith("npy"):
        np.save(path, np.asfortranarray(pixels)[..., None] if kind == "columns.npy" else pixels)
    else:
        Image.fromarray(pixels).save(path)
    np.testing.assert_allclose(read_depth(path), 1e-3 * BIG, rtol=1e-6)


@pytest.mark.parametrize(
    "content",
    [
        b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (2, 2), }" + b" " * 55 + b"\n" + b"x" * 32,
        b"\x93NUMPY\x01\x00",
        b"\x76\x2f\x31\x01broken",
        b"II*\x00broken",
    ],
)  # fmt: skip
def test_broken_files_of_depth_are_refused(tmp_path, content):
    path = saved(tmp_path, content, "d.any")
    with pytest.raises((InvalidFile, MissingExtra)):
        read_depth(path)


def test_the_scale_of_a_known_recording_is_named(tmp_path):
    with pytest.raises(InvalidFile) as error:
        read_depth(saved(tmp_path, (BIG * 50).astype(np.uint16)))
    assert "0.0002 for TUM" in str(error.value)


@pytest.mark.parametrize("name", ["Z", "View Layer.Depth.Z", "R"])
def test_an_exr_is_the_depth_in_its_channel(tmp_path, name):
    OpenEXR = pytest.importorskip("OpenEXR", reason="EXR is read by OpenEXR")
    depth = np.linspace(0.4, 0.9, 20 * 30, dtype=np.float32).reshape(20, 30)
    depth[3, 4] = 1e10  # as Blender writes the background
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"View Layer.Combined.A": np.ones_like(depth)} if "." in name else {}
    OpenEXR.File(header, {**channels, name: depth}).write(str(tmp_path / "d.exr"))
    found = read_depth(tmp_path / "d.exr")
    assert np.isnan(found[3, 4])
    np.testing.assert_array_equal(found[5:], depth[5:])


def test_without_what_reads_an_exr_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    (tmp_path / "d.exr").write_bytes(b"\x76\x2f\x31\x01\x02\x00\x00\x00")
    with pytest.raises(MissingExtra):
        read_depth(tmp_path / "d.exr")
