"""A detected hand measures vision's constant error, once from each side."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.gaussian_pose import GaussianPose
from handsight.tracking import PoseBiasSmoother
from handsight.tracking.camera_from_palm import IN_A_ROW, CameraFromPalm, HandView
from oracles.pose_bias import biased

SEEDS = st.integers(0, 2**32 - 1)
SIGMAS = np.array([0.002] * 3 + [0.02] * 3)
WIDE = np.diag([0.3**2] * 3 + [1.0] * 3)


def view(rng, E, noise=0.0, T=None):
    """Returns the view of a palm at T (random if None) by a camera whose calibration is off by E."""
    T = se3.random(rng, spread=0.3) if T is None else T
    seen = se3.moved(E @ T, noise * SIGMAS * rng.normal(size=6))
    return HandView(T, GaussianPose(seen, np.diag(SIGMAS**2)))


def wrong(rng, size=1.0):
    return se3.moved(np.eye(4), size * rng.normal(size=6) * np.array([0.06] * 3 + [0.1] * 3))


@given(SEEDS)
def test_a_view_predicts_where_vision_measures_an_object(seed):
    """An object anywhere is measured where the bias about any pivot puts it."""
    rng = np.random.default_rng(seed)
    E, pivot = wrong(rng), rng.normal(scale=0.3, size=3)
    bias = view(rng, E).bias(pivot).T_a_b
    T = se3.random(rng, spread=0.3)
    np.testing.assert_allclose(biased(T, bias, pivot), E @ T, atol=1e-12)


def test_a_view_is_confirmed_when_a_few_in_a_row_agree():
    rng = np.random.default_rng(0)
    E, T, camera = wrong(rng), se3.random(rng, spread=0.3), CameraFromPalm()
    for _ in range(IN_A_ROW):
        assert len(camera.confirmed) == 0
        camera = camera.updated(view(rng, E, 1.0, T))
    assert len(camera.confirmed) == 1
    for _ in range(50):  # from the same side they err alike
        camera = camera.updated(view(rng, E, 1.0, T))
    assert len(camera.confirmed) == 1


def test_views_that_contradict_each_other_are_not_confirmed():
    rng = np.random.default_rng(1)
    camera, T = CameraFromPalm(), se3.random(rng, spread=0.3)
    for _ in range(30):
        camera = camera.updated(view(rng, wrong(rng), 1.0, T))
    assert len(camera.confirmed) == 0


def test_a_camera_that_was_moved_is_noticed():
    rng = np.random.default_rng(2)
    camera, one, other = CameraFromPalm(), wrong(rng), wrong(rng)
    for E in (one, other):
        for _ in range(IN_A_ROW):
            camera = camera.updated(view(rng, E, 0.5))
    assert len(camera.confirmed) == 1
    pivot = np.zeros(3)
    np.testing.assert_allclose(camera.confirmed[0].bias(pivot).T_a_b, other, atol=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_a_detected_hand_separates_the_pose_from_the_cameras_error(seed):
    """Without it one palm's pose measurements leave the camera's error in the pose, with it they do not; and the order
    in which the two come does not matter."""
    rng = np.random.default_rng(seed)
    E, pivot = wrong(rng, 0.5), np.zeros(3)
    T_palm_object, T = se3.random(rng, spread=0.1), se3.random(rng, spread=0.3)
    T_mount_object = E @ T @ T_palm_object
    seen, camera = GaussianPose(T_mount_object, np.diag(SIGMAS**2)), np.diag(np.repeat([0.06**2, 0.2**2], 3))
    begun = PoseBiasSmoother.from_prior(se3.inverse(T) @ T_mount_object, WIDE, camera, pivot)
    measured = begun.updated(seen, T)
    updated = view(rng, E, 0.0, T).bias(pivot)
    first, last = begun.informed(updated).updated(seen, T), measured.informed(updated)
    arm = np.linalg.norm(T[:3, 3] @ T[:3, :3] + T_palm_object[:3, 3])
    for smoother in (first, last):
        off = se3.difference(smoother.now.T_palm_object, T_palm_object)
        sigma = np.sqrt(smoother.now.covariance.diagonal()[:6])
        assert (np.abs(off) < 0.5 * sigma).all()
        assert sigma[3:].max() < 0.035
        assert sigma[:3].max() < 0.004 + 0.03 * arm
    before = np.sqrt(measured.now.covariance.diagonal()[:6])
    assert before[:3].max() > 0.05
    np.testing.assert_allclose(first.now.covariance, last.now.covariance, rtol=0.1, atol=1e-6)
