"""One camera in the files of many programs is one camera; what a file does not say comes from the image, or is asked for."""

import json

import numpy as np
import pytest

from handsight.errors import InvalidFile, InvalidInput
from handsight.vision import read_camera
from handsight.vision.camera_file import read_camera_file
from testbed.refusals import refused

FX, FY, CX, CY = 525.0, 524.5, 189.5, 154.25
WIDTH, HEIGHT = 360, 300
SIZE = WIDTH, HEIGHT
K = [[FX, 0, CX], [0, FY, CY], [0, 0, 1]]
FLAT = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
COLUMNS = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
PLUMB_BOB = [0.1, -0.2, 1e-3, 2e-3, 0.05]
RATIONAL = [0.4, -2.5, 5e-4, -3e-4, 1.5, 0.3, -2.3, 1.4]
SIDES = {"width": WIDTH, "height": HEIGHT}
FOCAL = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
ROS = f"""
header:
  stamp: {{sec: 3, nanosec: 5}}
  frame_id: depth
height: {HEIGHT}
width: {WIDTH}
distortion_model: plumb_bob
d: [0.0, 0.0, 0.0, 0.0, 0.0]
k: {FLAT}
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [{FX}, 0.0, {CX}, 0.0, 0.0, {FY}, {CY}, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
---
"""
CALIBRATION = f"""
image_width: {WIDTH}
image_height: {HEIGHT}
camera_name: depth
camera_matrix: {{rows: 3, cols: 3, data: {FLAT}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: {PLUMB_BOB}}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
"""
OPENCV = f"""%YAML:1.0
---
image_width: {WIDTH}
image_height: {HEIGHT}
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: {FLAT}
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: {PLUMB_BOB}
"""
ORB_SLAM = f"Camera.fx: {FX}\nCamera.fy: {FY}\nCamera.cx: {CX}\nCamera.cy: {CY}\nCamera.width: {WIDTH}\nCamera.height: {HEIGHT}\n"
KALIBR = f"cam0:\n  intrinsics: [{FX}, {FY}, {CX}, {CY}]\n  resolution: [{WIDTH}, {HEIGHT}]\n  distortion_model: radtan\n  distortion_coeffs: {PLUMB_BOB[:4]}\n"
WITHOUT_SIZE = {
    "cam_K.txt": "\n".join(" ".join(map(str, row)) for row in K),
    "intrinsic_depth.txt": "\n".join(
        " ".join(map(str, row)) for row in [*([*r, 0] for r in K), [0, 0, 0, 1]]
    ),
    "commas.csv": "# fx 0 cx\n" + "\n".join(", ".join(map(str, row)) for row in K),
    "sam6d.json": {"cam_K": FLAT, "depth_scale": 1.0},
    "scene_camera.json": {"3": {"cam_K": FLAT, "depth_scale": 0.1}, "8": {"cam_K": FLAT, "depth_scale": 0.1}},
    "row.txt": f"{FX} {FY} {CX} {CY}\n",
    "megapose.json": {"K": K, "resolution": [HEIGHT, WIDTH]},
    "kalibr.yaml": KALIBR,
}
WITH_SIZE = {
    "handsight.json": FOCAL | SIDES | {"lens": PLUMB_BOB},
    "rational.json": FOCAL | SIDES | {"lens": RATIONAL},
    "bop_camera.json": FOCAL | SIDES | {"depth_scale": 0.1},
    "open3d.json": SIDES | {"intrinsic_matrix": COLUMNS},
    "open3d_view.json": {"class_name": "PinholeCameraParameters", "intrinsic": SIDES | {"intrinsic_matrix": COLUMNS}, "extrinsic": [1.0] * 16},
    "realsense.json": {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "model": "distortion.brown_conrady", "coeffs": PLUMB_BOB} | SIDES,
    "unused_lens.json": {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "model": "inverse_brown_conrady", "coeffs": [0.0] * 5} | SIDES,
    "nerf.json": {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": WIDTH, "h": HEIGHT, "k1": 0.1, "k2": -0.2, "p1": 1e-3, "p2": 2e-3},
    "echo.yaml": ROS,
    "calibration.yaml": CALIBRATION,
    "opencv.yaml": OPENCV,
    "orb_slam.yaml": ORB_SLAM,
    "with_mark.json": "\ufeff" + json.dumps(FOCAL | SIDES),
}  # fmt: skip
LENSES = dict.fromkeys(("handsight.json", "realsense.json", "calibration.yaml", "opencv.yaml"), PLUMB_BOB)
LENSES |= {"rational.json": RATIONAL, "nerf.json": PLUMB_BOB[:4], "kalibr.yaml": PLUMB_BOB[:4]}


def written(folder, name, content):
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", [*WITH_SIZE, *WITHOUT_SIZE])
def test_a_camera_is_the_same_in_every_file(tmp_path, name):
    path = written(tmp_path, name, (WITH_SIZE | WITHOUT_SIZE)[name])
    for given in [{"size": SIZE}, *[{}] * (name in WITH_SIZE)]:
        camera = read_camera(path, **given)
        np.testing.assert_array_equal(camera.matrix, K)
        assert camera.size == SIZE
        np.testing.assert_array_equal(camera.lens, LENSES.get(name, []))


@pytest.mark.parametrize("name", WITHOUT_SIZE)
def test_a_size_that_a_file_lacks_is_asked_for(tmp_path, name):
    with refused(InvalidFile, "width"):
        read_camera(written(tmp_path, name, WITHOUT_SIZE[name]))


@pytest.mark.parametrize("name", WITH_SIZE)
def test_another_size_than_the_image_s_is_told_and_scaled_only_on_request(tmp_path, name):
    path, half = written(tmp_path, name, WITH_SIZE[name]), (WIDTH // 2, HEIGHT // 2)
    with refused(InvalidFile, "size"):
        read_camera(path, size=half)
    camera = read_camera(path, size=half, resized=True)
    assert camera.size == half
    # The ray through a pixel's corner stays that of the corner, which is half a pixel before its centre.
    corner = (np.array([2 * 40, 2 * 30]) - 0.5 - [CX, CY]) / [FX, FY]
    np.testing.assert_allclose(([39.5, 29.5] - camera.matrix[:2, 2]) / camera.matrix.diagonal()[:2], corner)


def test_proportions_stay(tmp_path):
    path = written(tmp_path, "a.json", WITH_SIZE["handsight.json"])
    with refused(InvalidFile, "size"):
        read_camera(path, size=(WIDTH, WIDTH), resized=True)
    camera = read_camera(path)
    with refused(InvalidInput, "size"):
        camera.resized((640, 300))


def test_of_several_cameras_the_image_s_is_taken_or_one_is_asked_for(tmp_path):
    other = [2 * number for number in FLAT[:-1]] + [1]
    path = written(tmp_path, "a.json", {"3": {"cam_K": FLAT}, "000012": {"cam_K": other}})
    for image, fx in (("000003", FX), ("depth_12", 2 * FX)):
        assert read_camera(path, size=SIZE, image=image).matrix[0, 0] == fx
    with refused(InvalidFile, "a.json"):
        read_camera(path, size=SIZE)
    with refused(InvalidFile, "a.json"):
        read_camera(path, size=SIZE, image="000004")


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ({"name": "d435"}, "a.json"),
        (FOCAL | SIDES | {"fx": "300"}, "fx"),
        (FOCAL | SIDES | {"fx": -1}, "matrix"),
        (FOCAL | SIDES | {"width": 640.5}, "width"),
        (FOCAL | SIDES | {"lens": [0.1, 0.2]}, "lens"),
        (FOCAL | SIDES | {"cx": 1e400}, "a.json"),
        ([1, 2], "a.json"),
        ("1 2 3\n4 5 6", "matrix"),
        ("1 0 2 0 1 2 0 0", "matrix"),
        (FOCAL | SIDES | {"lense": PLUMB_BOB}, "lense"),
        (FOCAL | SIDES | {"dist": [0.1]}, "dist"),
        (FOCAL | SIDES | {"D": PLUMB_BOB[:4], "distortion_model": "equidistant"}, "distortion_model"),
        (FOCAL | SIDES | {"coeffs": PLUMB_BOB, "model": "distortion.inverse_brown_conrady"}, "distortion_model"),
        (FOCAL | SIDES | {"D": [0.1] * 14}, "lens"),
        ({"K": [[FX, 3.0, CX], [0, FY, CY], [0, 0, 1]]} | SIDES, "K"),
        ({"fx": FX, "cx": CX, "cy": CY} | SIDES, "fy"),
        ("1 PINHOLE 640 480 525 525 319.5 239.5", "a.json"),
        ("[LEFT_CAM_HD]\nfx=525\n", "a.json"),
        ("{" * 1000, "a.json"),
        ("a: [" * 1000, "a.json"),
        ("a: &a [*a]", "a.json"),
        ("nan 0 1\n0 nan 1\n0 0 1", "matrix"),
    ],
)  # fmt: skip
def test_what_is_no_camera_is_refused_by_its_field(tmp_path, content, field):
    path = written(tmp_path, "a.json", content)
    with pytest.raises(InvalidFile) as error:
        read_camera(path, size=SIZE)
    assert field in (error.value.field, error.value.field.rpartition("/")[2].partition(":")[0])


@pytest.mark.parametrize(
    ("content", "metres"),
    [
        (FOCAL | {"depth_scale": 0.001}, 1e-3),
        ({"depth_scale": 2.5e-4, "intrinsics": FOCAL}, 2.5e-4),
        ({"3": {"cam_K": FLAT, "depth_scale": 0.1}}, 1e-4),
        ({"cam_K": FLAT, "depth_scale": 1.0}, 1e-3),
        ({"camera": FOCAL | {"scale": 1, "png_depth_scale": 6553.5}}, 1 / 6553.5),
        (ORB_SLAM + "DepthMapFactor: 5000.0\n", 2e-4),
        (FOCAL, None),
    ],
)
def test_the_unit_of_depth_is_metres_or_millimetres_a_step_or_steps_a_metre(tmp_path, content, metres):
    step, said = read_camera_file(written(tmp_path, "a.json", content)).step("000003")
    assert step == (None if metres is None else pytest.approx(metres))
    assert bool(said) == (metres is not None)
