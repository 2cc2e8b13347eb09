"""Folders are read as they are, and it is said what was taken for what."""

import json

import numpy as np
import pytest
from PIL import Image

from handsight.errors import InvalidFile
from handsight.recording.folder import TUM_SCALE, read_folder
from handsight.recording.frames import Beside, Frame, Unread, open_frames
from testbed.refusals import refused

WIDTH, HEIGHT = 40, 30
K = np.array([[50.0, 0, 19.5], [0, 50, 14.5], [0, 0, 1]])
RNG = np.random.default_rng(0)
STEPS = RNG.integers(400, 900, (HEIGHT, WIDTH)).astype(np.uint16)
COLOR = RNG.integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
MASK = np.zeros((HEIGHT, WIDTH), np.uint8)
MASK[5:15, 10:20] = 255
MESH = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def saved(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, np.ndarray):
        Image.fromarray(content).save(path)
    else:
        path.write_text(content)
    return path


def matrix_text(numbers):
    return "\n".join(" ".join(map(str, row)) for row in numbers)


def foundationpose(folder):
    for stem in ("1581120424100262102", "1581120424148532296"):
        saved(folder / "depth" / f"{stem}.png", STEPS)
        saved(folder / "rgb" / f"{stem}.png", COLOR)
        saved(folder / "ob_in_cam" / f"{stem}.txt", matrix_text(np.eye(4)))
    saved(folder / "masks" / "1581120424100262102.png", MASK)
    saved(folder / "cam_K.txt", matrix_text(K))
    saved(folder / "mesh" / "textured_simple.off", MESH)
    return {"color": 2, "masks": 1, "camera": "cam_K.txt", "poses": "ob_in_cam", "meshes": 1}


def sam6d(folder):
    saved(folder / "depth.png", STEPS)
    saved(folder / "rgb.png", COLOR)
    saved(folder / "camera.json", json.dumps({"cam_K": K.ravel().tolist(), "depth_scale": 1.0}))
    saved(folder / "obj_000005.off", MESH)
    saved(folder / "sam6d_results" / "detection_pem.json", "[]")
    return {"color": 1, "camera": "camera.json", "poses": "detection_pem.json", "meshes": 1}


def megapose(folder):
    saved(folder / "image_depth.png", STEPS)
    saved(folder / "image_rgb.png", COLOR)
    saved(folder / "camera_data.json", json.dumps({"K": K.tolist(), "resolution": [HEIGHT, WIDTH]}))
    saved(folder / "meshes" / "mug" / "mug.off", MESH)
    return {"color": 1, "camera": "camera_data.json", "meshes": 1}


def tum(folder):
    for depth, color in (("10.000", "10.011"), ("10.033", "10.041"), ("20.0", "25.0")):
        saved(folder / "depth" / f"{depth}.png", STEPS * 5)
        saved(folder / "rgb" / f"{color}.png", COLOR)
    saved(folder / "depth.txt", "# depth maps")
    saved(folder / "rgb.txt", "# color images")
    saved(folder / "camera.json", json.dumps({"K": K.tolist()}))
    return {"color": 2, "camera": "camera.json", "scale": TUM_SCALE}


def own(folder):
    names = "depth_000001", "depth_000002"
    for name in names:
        saved(folder / f"{name}.png", STEPS)
        saved(folder / f"rgb_{name[-6:]}.jpg", COLOR)
    sides = {"width": WIDTH, "height": HEIGHT}
    focal = {"fx": 50, "fy": 50, "cx": 19.5, "cy": 14.5}
    saved(folder / "camera.json", json.dumps(focal | sides))
    return {"color": 2, "camera": "camera.json"}


def scannet(folder):
    saved(folder / "depth" / "0.png", STEPS)
    saved(folder / "color" / "0.jpg", COLOR)
    saved(folder / "pose" / "0.txt", matrix_text(np.eye(4)))  # the camera's
    square = np.eye(4)
    square[:3, :3] = K
    saved(folder / "intrinsic" / "intrinsic_depth.txt", matrix_text(square))
    saved(folder / "intrinsic" / "extrinsic_depth.txt", matrix_text(np.eye(4)))
    return {"color": 1, "camera": "intrinsic_depth.txt"}


@pytest.mark.parametrize("layout", [foundationpose, sam6d, megapose, tum, own, scannet])
def test_a_folder_is_read_as_it_is(tmp_path, layout):
    expected = layout(tmp_path)
    found = read_folder(tmp_path)
    assert (len(found.color), len(found.masks)) == (expected["color"], expected.get("masks", 0))
    assert found.camera.name == expected["camera"]
    assert (found.poses.name if found.poses else None) == expected.get("poses")
    assert len(found.meshes) == expected.get("meshes", 0)
    assert found.depth_scale == expected.get("scale")
    sentence = found.sentence(tmp_path)
    assert expected["camera"] in sentence
    frames = open_frames(tmp_path, Beside())
    for frame, path in zip(frames.each, found.depth, strict=True):
        assert isinstance(frame, Frame)
        np.testing.assert_array_equal(frame.camera.matrix, K)
        np.testing.assert_allclose(frame.depth, 1e-3 * STEPS, rtol=1e-6)
        assert (frame.color is not None) == (path.stem in found.color)
        assert (frame.wanted is not None) == (path.stem in found.masks)


def test_one_image_finds_the_camera_of_its_folder(tmp_path):
    foundationpose(tmp_path)
    (frame,) = open_frames(tmp_path / "depth" / "1581120424100262102.png", Beside()).each
    np.testing.assert_array_equal(frame.camera.matrix, K)


def test_images_of_two_sizes_have_a_camera_each_if_they_were_resized(tmp_path):
    own(tmp_path)
    saved(tmp_path / "depth_000002.png", STEPS[::2, ::2].copy())
    (tmp_path / "rgb_000002.jpg").unlink()
    first, second = open_frames(tmp_path, Beside()).each
    assert isinstance(first, Frame)
    assert isinstance(second, Unread)
    first, second = open_frames(tmp_path, Beside(resized=True)).each
    assert second.camera.size == (WIDTH // 2, HEIGHT // 2)


def test_an_empty_mask_is_told(tmp_path):
    foundationpose(tmp_path)
    saved(tmp_path / "masks" / "1581120424100262102.png", np.zeros_like(MASK))
    first, second = open_frames(tmp_path, Beside()).each
    assert isinstance(first, Unread)
    assert "masks" in first.reason
    assert isinstance(second, Frame)


def test_a_folder_without_depth_is_refused(tmp_path):
    saved(tmp_path / "rgb" / "0.png", COLOR)
    with refused(InvalidFile, tmp_path.name):
        read_folder(tmp_path)
