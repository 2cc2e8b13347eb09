"""What is said of a camera's errors adds up, agrees with those who measured them, and is checked."""

from dataclasses import replace

import numpy as np
import pytest

from handsight.errors import InvalidInput
from handsight.vision import PRESETS, STRUCTURED_LIGHT, DepthNoise
from testbed.refusals import refused


def test_a_kinect_is_about_as_noisy_as_those_found_who_measured_it():
    z = np.linspace(0.65, 1.4, 50)
    nguyen = 1.2e-3 + 1.9e-3 * (z - 0.4) ** 2
    both = np.hypot(STRUCTURED_LIGHT.sigma(z), STRUCTURED_LIGHT.smooth * z**2)
    assert np.abs(both / nguyen - 1).max() < 0.34
    khoshelham = 1.425e-3 * z**2
    assert np.abs(STRUCTURED_LIGHT.sigma(z) / khoshelham - 1).max() < 0.05


def test_stereo_is_known_to_a_part_of_a_pixel_of_disparity():
    z = np.array([0.5, 1.0, 2.0])
    np.testing.assert_allclose(
        425 * 0.05 / z - 425 * 0.05 / (z + PRESETS["stereo"].sigma(z)), 0.08, rtol=0.02
    )


def test_time_of_flight_hardly_gets_worse_with_distance():
    time_of_flight = PRESETS["time_of_flight"]
    assert time_of_flight.sigma(2.0) < 1.5 * time_of_flight.sigma(0.6)
    assert STRUCTURED_LIGHT.sigma(2.0) > 9 * STRUCTURED_LIGHT.sigma(0.6)


@pytest.mark.parametrize("kind", sorted(PRESETS))
def test_sigmas_are_of_the_depths_shape_and_multiples_multiply_them(kind):
    noise, z = PRESETS[kind], np.linspace(0.5, 3, 12).reshape(3, 4)
    assert noise.sigma(z).shape == noise.bias(z).shape == (3, 4)
    assert (noise.sigma(z) > 0).all()
    for amount in (0, 0.5, 3):
        np.testing.assert_allclose(noise.times(amount).sigma(z), amount * noise.sigma(z))
        np.testing.assert_allclose(noise.times(amount).bias(z), amount * noise.bias(z))
    assert noise.times(50).edges == 1


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"axial": (0.1, 0.2)}, "axial"),
        ({"smooth": -1e-3}, "smooth"),
        ({"offset": np.nan}, "offset"),
        ({"edges": 1.1}, "edges"),
        ({"edge_width": 1.5}, "edge_width"),
        ({"nearest": 2.0, "farthest": 1.0}, "farthest"),
    ],
)
def test_what_no_camera_has_is_said(changes, field):
    with refused(InvalidInput, field):
        replace(STRUCTURED_LIGHT, **changes)
    with refused(InvalidInput, "amount"):
        DepthNoise(axial=(0, 0, 1e-3)).times(-1)
