"""What CameraInfo says becomes the camera of the images that come; what is no pinhole behind a lens is told."""

import numpy as np
import pytest

from handsight.camera import Camera
from messages.ros import START, Messages, heard, rig, touched

M = Messages()
K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
RATIONAL = (0.4, -2.5, 5e-4, -3e-4, 1.5, 0.3, -2.3, 1.4)


def told(*messages, robot=None):
    """The stream that has heard them among joints and wrenches."""
    rows = touched(30) + [(topic, START + 0.1, message) for topic, message in messages]
    return heard(sorted(rows, key=lambda row: row[1]), robot)[1]


def info(*said, **cut):
    return "/info", M.info(START, *said, **cut)


@pytest.mark.parametrize(
    ("lens", "model", "expected"),
    [
        ((), "plumb_bob", ()),
        ((), "", ()),
        ((0.0,) * 5, "plumb_bob", ()),
        ((0.1, -0.2, 1e-3, 2e-3), "plumb_bob", (0.1, -0.2, 1e-3, 2e-3)),
        ((0.1, -0.2, 1e-3, 2e-3, 0.05), "plumb_bob", (0.1, -0.2, 1e-3, 2e-3, 0.05)),
        (RATIONAL, "rational_polynomial", RATIONAL),
        ((*RATIONAL, 0, 0, 0, 0), "rational_polynomial", RATIONAL),
    ],
)
def test_the_lens_is_that_of_the_message(lens, model, expected):
    stream = told(info(K, (640, 480), lens, model))
    camera = stream.intrinsics
    np.testing.assert_array_equal(camera.lens, expected)
    np.testing.assert_array_equal(camera.matrix, K)
    assert camera.size == (640, 480)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ((K, (640, 480), (0.1, 0.2, 0.3, 0.4), "equidistant"), "expected a distortion model plumb_bob or rational_polynomial, got 'equidistant'"),
        ((K, (640, 480), (0.0,) * 4, "equidistant"), "expected a distortion model plumb_bob or rational_polynomial, got 'equidistant'"),
        ((K, (640, 480), (0.1,) * 5, ""), "expected a distortion model plumb_bob or rational_polynomial, got ''"),
        ((K, (640, 480), RATIONAL, "plumb_bob"), "expected at most 5 numbers of a plumb_bob lens, got 8"),
        ((K, (640, 480), (*RATIONAL, 0.1, 0, 0, 0), "rational_polynomial"), "expected at most 8 numbers of a rational_polynomial lens, got 12"),
        ((K, (640, 480), (0.1, 0.2), "plumb_bob"), "lens: expected 0, 4, 5, 8 numbers, got 2"),
        ((K, (640, 480), (np.nan,) * 5, "plumb_bob"), "lens: expected finite numbers"),
        ((K, (0, 0)), "size: expected width and height above 0, got 0 x 0"),
        ((0 * K, (640, 480)), "expected focal lengths above 0, got an uncalibrated camera"),
        ((K + np.eye(3, k=1) * [0, 1, 0], (640, 480)), "matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got"),
    ],
)  # fmt: skip
def test_a_camera_that_is_no_pinhole_is_rejected_with_the_reason(said, reason):
    stream = told(info(*said))
    assert stream.intrinsics is None
    ((found, count),) = stream.report.topics["/info"].reasons.items()
    assert found.startswith(reason)
    assert count == 1


def test_cropped_and_binned_images_show_the_same_points():
    """A pixel of what comes is the mean of those it was made of."""
    whole = Camera(K, (640, 480))
    cut = info(K, (640, 480), x_offset=100, y_offset=60, width=400, height=300, binning_x=2, binning_y=3)
    camera = told(cut).intrinsics
    assert camera.size == (200, 100)
    points = np.random.default_rng(0).uniform([-0.3, -0.3, 0.5], [0.3, 0.3, 2], (50, 3))
    u, v = whole.project(points).T
    # The middles of the pixels that are one: 100, 101 are 0; 60, 61, 62 are 0.
    expected = np.stack([(u - 100.5) / 2, (v - 61) / 3], axis=1)
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-9)
    only = told(info(K, (640, 480), binning_x=2, binning_y=2)).intrinsics
    assert only.size == (320, 240)


def test_images_of_another_size_than_their_cameras_are_reported():
    depth = ("/depth", M.image(START + 0.1, np.full((48, 64), 1.0, "<f4"), "32FC1"))
    wrong = "depth images on /depth: expected 640 x 480 pixels as its camera's, got 64 x 48"
    assert wrong in told(depth).lacks()
    assert wrong in told(depth, info(K, (640, 480))).lacks()
    assert not any("pixels" in said for said in told(depth, info(K, (64, 48))).lacks())
    right = ("/depth", M.image(START + 0.1, np.full((480, 640), 1.0, "<f4"), "32FC1"))
    assert not any("pixels" in said for said in told(right, info(K, (640, 480))).lacks())
    assert not any("pixels" in said for said in told(right, robot=rig(camera_info=None)).lacks())
