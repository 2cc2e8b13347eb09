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


@pytest.mark.parametrize(
    "lens", [[], [-0.2, 0.05, 1e-4, 2e-4], [0.4, -2.5, 5e-4, -3e-4, 1.5, 0.3, -2.3, 1.4]]
)
def test_a_camera_has_the_numbers_of_its_file(tmp_path, lens):
    camera = read_camera(saved(tmp_path, INTRINSICS | ({"lens": lens} if lens else {}), "camera.json"))
    np.testing.assert_array_equal(camera.matrix, CAMERA.matrix)
    np.testing.assert_array_equal(camera.lens, lens)
    assert camera.size == (5, 6)


def png(pixels, folder):
    return saved(folder, pixels, "whole.png").read_bytes()


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (STEPS // 300, {}, r"expected depth in millimetres \(16UC1\), got a median of 10.* \(another unit\?\)"),
        (STEPS * 0 + 65000, {}, r"expected depth in millimetres \(16UC1\), got a median of 6.5e\+04 \(another unit"),
        (STEPS, {"scale": 1e-6}, r"expected depth in units of 0.001 mm, got a median of \d+ \(another unit\?\)"),
        (STEPS * 0, {}, "expected depth, got none at any pixel"),
        (STEPS.astype(np.uint8), {}, "expected a PNG of 16 bits for depth, got mode L"),
        (np.zeros((6, 5, 3), np.uint8), {}, "expected a PNG of 16 bits for depth, got mode RGB"),
        (STEPS[:, :4], {"camera": CAMERA}, "expected 5 x 6 pixels as the camera's, got 4 x 6"),
        (b"", {}, "expected a PNG or JPEG, got: "),
        (b"nothing", {}, "expected a PNG or JPEG, got: "),
    ],
)  # fmt: skip
def test_what_is_no_depth_image_is_said(tmp_path, content, options, message):
    path = saved(tmp_path, content)
    with pytest.raises(InvalidFile, match=f"^{path}: {message}"):
        read_depth(path, **options)


def test_an_image_that_was_cut_is_none_unless_all_its_pixels_are_there(tmp_path):
    whole = png(RNG.integers(300, 9000, (60, 50)).astype(np.uint16), tmp_path)
    expected, read = read_depth(saved(tmp_path, whole)), 0
    for left in range(0, len(whole), 97):
        path = saved(tmp_path, whole[:left], "cut.png")
        with pytest.raises(InvalidFile, match=f"^{path}: expected a PNG or JPEG, got: "):
            read_depth(path)
    for left in range(len(whole) - 40, len(whole)):
        try:
            np.testing.assert_array_equal(read_depth(saved(tmp_path, whole[:left], "cut.png")), expected)
            read += 1
        except InvalidFile:
            pass
    assert read > 0


@pytest.mark.parametrize(
    ("scale", "message"),
    [
        (0, "above 0"),
        (np.nan, "finite"),
        (1000.0, r"metres from 1e-07 to 1, got 1000 \(mill"),
        ("1", "finite"),
    ],
)
def test_a_scale_that_is_none_is_said(tmp_path, scale, message):
    with pytest.raises(InvalidInput, match=f"^scale: expected .*{message}"):
        read_depth(saved(tmp_path, STEPS), scale)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"[1", "expected JSON, got other text"),
        (b"[1]", r"expected an object \{...\}, got \[1\]"),
        ({k: v for k, v in INTRINSICS.items() if k != "fx"}, "fx: expected a finite number, got nothing"),
        (INTRINSICS | {"fx": "300"}, r"fx: expected a finite number, got 300 \(a text\)"),
        (INTRINSICS | {"fx": -1}, "fx: expected a number above 0, got -1"),
        (INTRINSICS | {"width": 640.5}, "width: expected a whole number, got 640.5"),
        (INTRINSICS | {"lenses": []}, "lenses: unknown key; the nearest valid one is 'lens'"),
        (INTRINSICS | {"lens": [0.1, 0.2]}, "lens: expected 0, 4, 5, 8 numbers, got 2"),
        (INTRINSICS | {"cx": 1e400}, "expected JSON|cx"),
        (INTRINSICS | {"width": 40_000_000, "height": 40_000_000}, "size: expected"),
    ],
)
def test_what_is_no_camera_file_is_said(tmp_path, content, message):
    path = saved(tmp_path, content, "camera.json")
    with pytest.raises(InvalidFile, match=f"^{path}: {message}"):
        read_camera(path)


def test_a_file_that_is_not_there_is_said(tmp_path):
    for read in (read_camera, read_depth, read_color):
        with pytest.raises(InvalidFile, match=f"^{tmp_path}/none: cannot be read"):
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
    with pytest.raises(MissingExtra, match=r"^images need pillow: pip install 'handsight\[vision\]'"):
        read_depth(path)
