"""A camera's rays are those that its pixels are hit by, through any lens; its drawings are what rays meet."""

from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.camera import Camera
from handsight.errors import InvalidInput
from handsight.rig import DepthCamera, MountedCamera
from handsight.vision import PRESETS
from testbed.refusals import refused

MATRIX = np.array([[300.0, 0, 158.0], [0, 310, 121.0], [0, 0, 1]])
BARREL = (-0.28, 0.07, 2e-4, 1.6e-5, 0.0)
RATIONAL = (0.4, -2.5, 5e-4, -3e-4, 1.5, 0.3, -2.3, 1.4)


def opencv(camera, points):
    """The formula of OpenCV's calibration, plainly."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*camera.lens, *[0.0] * 8)[:8]
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    K = camera.matrix
    return np.stack([K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]], axis=1)


@pytest.mark.parametrize("lens", [(), BARREL[:4], BARREL, RATIONAL])
def test_points_fall_on_the_pixels_of_their_rays(lens):
    camera = Camera(MATRIX, (320, 240), np.array(lens))
    z = np.random.default_rng(0).uniform(0.2, 3, camera.rays.shape[:2])
    points = np.concatenate([camera.rays * z[..., None], z[..., None]], axis=-1).reshape(-1, 3)
    columns, rows = np.meshgrid(np.arange(320), np.arange(240))
    expected = np.stack([columns, rows], axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-3)
    np.testing.assert_allclose(camera.project(points), opencv(camera, points), atol=1e-9)


def test_points_behind_or_beyond_the_lens_have_no_pixel():
    camera = Camera(MATRIX, (320, 240), np.array(BARREL))
    assert np.isnan(camera.project([[0, 0, -1], [0, 0, 0], [3.0, 0, 1]])).all()
    assert np.isfinite(Camera(MATRIX, (320, 240)).project([[3.0, 0, 1]])).all()


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"matrix": np.eye(2)}, "matrix"),
        ({"matrix": np.diag([-300.0, 300, 1])}, "matrix"),
        ({"size": (0, 240)}, "size"),
        ({"size": (99999, 99999)}, "size"),
        ({"lens": np.zeros(3)}, "lens"),
        ({"lens": np.array([np.nan] * 5)}, "lens"),
    ],
)
def test_what_is_no_camera_is_said(changes, field):
    with refused(InvalidInput, field):
        Camera(**({"matrix": MATRIX, "size": (320, 240)} | changes))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_drawings_are_what_rays_meet(seed):
    """Against trimesh's rays; triangles reach behind the camera, cross each other and leave the image."""
    rng = np.random.default_rng(seed)
    camera = Camera(np.array([[40.0, 0, 19.5], [0, 40, 14.5], [0, 0, 1]]), (40, 30))
    vertices = rng.normal(size=(12, 3)) * [0.5, 0.4, 0.5] + [0, 0, 0.6]
    faces = rng.permuted(np.tile(np.arange(12), (6, 1)), axis=1)[:, :3]
    depth, labels = camera.draw(vertices, faces, np.arange(6))
    rays = np.concatenate([camera.rays, np.ones((30, 40, 1))], axis=-1).reshape(-1, 3)
    # Möller and Trumbore, every ray with every triangle.
    a, ab, ac = vertices[faces[:, 0]], *(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))
    across = np.cross(rays[:, None], ac)
    scale = (across * ab).sum(axis=-1)
    u = (across * -a).sum(axis=-1) / scale
    along = np.cross(-a, ab)
    v, z = (rays[:, None] * along).sum(axis=-1) / scale, (along * ac).sum(axis=-1) / scale
    z[(u < 0) | (v < 0) | (u + v > 1) | (z < 0.01)] = np.inf
    expected, found, met = z.min(axis=1), depth.reshape(-1), labels.reshape(-1)
    same = (np.isinf(found) & np.isinf(expected)) | np.isclose(found, expected, rtol=1e-3)
    # Pixels right on an edge may fall either way.
    assert same.mean() > 0.98
    of_label = np.where(met < 0, np.inf, z[np.arange(len(rays)), met])
    np.testing.assert_allclose(of_label[same], expected[same], rtol=1e-3)


@pytest.mark.parametrize("lens", [(), BARREL, RATIONAL])
def test_points_of_a_depth_image_fall_on_their_pixels_at_their_depth(lens):
    camera = Camera(MATRIX, (320, 240), np.array(lens))
    depth = np.random.default_rng(1).uniform(0.2, 3, (240, 320)).astype(np.float32)
    depth[::7, ::5], depth[1, 1], depth[2, 2], depth[3, 3] = np.nan, 0, np.inf, -1
    points = camera.points(depth)
    known = np.isfinite(depth) & (depth > 0) & np.isfinite(camera.rays[..., 0])
    assert points.dtype == np.float32
    assert np.isnan(points[~known]).all()
    np.testing.assert_array_equal(points[known][:, 2], depth[known])
    rows, columns = np.nonzero(known)
    np.testing.assert_allclose(camera.project(points[known]), np.stack([columns, rows], axis=1), atol=2e-3)


@pytest.mark.parametrize(
    ("depth", "field"),
    [
        (np.ones((320, 240)), "depth"),
        (np.ones((240, 320, 1)), "depth"),
        (np.full((240, 320), 900, np.uint16), "depth"),
    ],
)
def test_depth_of_another_size_or_kind_is_said(depth, field):
    with refused(InvalidInput, field):
        Camera(MATRIX, (320, 240)).points(depth)


def test_a_rigs_camera_is_one_with_its_lens():
    made = Camera.of(MountedCamera(intrinsics=MATRIX, size=(320, 240), lens=np.array(BARREL)))
    np.testing.assert_array_equal(made.matrix, MATRIX)
    np.testing.assert_array_equal(made.lens, BARREL)
    assert made.size == (320, 240)
    with refused(InvalidInput, "camera"):
        Camera.of(None)
    with refused(InvalidInput, "camera"):
        Camera.of(MountedCamera())


def test_each_kind_of_depth_camera_that_a_rig_may_have_is_known():
    assert sorted(PRESETS) == sorted(get_args(DepthCamera))
    with refused(InvalidInput, "depth_camera"):
        MountedCamera(depth_camera="stero")
    with refused(InvalidInput, "lens"):
        MountedCamera(lens=np.zeros(3))
