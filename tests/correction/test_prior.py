"""Vision's pose before touch: its error along the ray from the camera is not that across it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handsight as hs
from handsight.rig import MountedCamera
from testbed.refusals import refused

direction = st.tuples(*[st.floats(-5, 5)] * 3).filter(lambda ray: np.linalg.norm(ray) > 0.1)
sigma = st.floats(1e-4, 0.1)


@given(direction, sigma, sigma)
def test_a_priors_sigmas_are_along_and_across_the_ray(ray, along, across):
    prior = hs.PosePrior.from_sigmas(np.eye(4), across, 0.1, ray=ray, sigma_ray=along)
    unit = np.array(ray) / np.linalg.norm(ray)
    side = np.linalg.svd(unit[None])[2][1]
    C = prior.covariance[:3, :3]
    assert unit @ C @ unit == pytest.approx(along**2)
    assert side @ C @ side == pytest.approx(across**2)
    assert unit @ C @ side == pytest.approx(0, abs=1e-6 * max(along, across) ** 2)
    np.testing.assert_allclose(prior.covariance[3:, 3:], 0.01 * np.eye(3))


@given(direction, sigma, sigma)
def test_a_mounted_cameras_noise_is_that_of_a_prior_along_its_ray(place, along, across):
    camera = MountedCamera(
        T_mount_camera=np.linalg.inv(np.block([[np.eye(3), np.ones((3, 1))], [np.zeros((1, 3)), 1]])),
        sigma_position=across,
        sigma_ray=along,
        sigma_rotation=0.1,
    )
    position = np.array(place) - 1  # the camera is at (-1, -1, -1)
    prior = hs.PosePrior.from_sigmas(np.eye(4), across, 0.1, ray=place, sigma_ray=along)
    np.testing.assert_allclose(camera.noise_at(position), prior.covariance, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    ("given_ray", "field"),
    [
        ({"ray": [0, 0, 1]}, "sigma_ray"),
        ({"sigma_ray": 0.01}, "ray"),
        ({"ray": [0, 0, 0], "sigma_ray": 0.01}, "ray"),
        ({"ray": [0, 0, 1], "sigma_ray": -1}, "sigma_ray"),
    ],
)
def test_a_ray_and_its_sigma_come_together_and_are_checked(given_ray, field):
    with refused(hs.InvalidInput, field):
        hs.PosePrior.from_sigmas(np.eye(4), 0.01, 0.1, **given_ray)
