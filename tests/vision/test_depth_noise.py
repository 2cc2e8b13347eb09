"""What is said of a camera's errors adds up, agrees with those who measured them, and is checked."""

from dataclasses import replace

import numpy as np
import pytest

from handsight.errors import InvalidInput
from handsight.vision import PRESETS, STEREO, STRUCTURED_LIGHT, TIME_OF_FLIGHT, DepthNoise


def test_a_kinect_is_about_as_noisy_as_those_found_who_measured_it():
    z = np.linspace(0.65, 1.4, 50)
    nguyen = 1.2e-3 + 1.9e-3 * (z - 0.4) ** 2
    both = np.hypot(STRUCTURED_LIGHT.sigma(z), STRUCTURED_LIGHT.smooth * z**2)
    assert np.abs(both / nguyen - 1).max() < 0.34
    khoshelham = 1.425e-3 * z**2
    assert np.abs(STRUCTURED_LIGHT.sigma(z) / khoshelham - 1).max() < 0.05


def test_stereo_is_known_to_a_part_of_a_pixel_of_disparity():
    z = np.array([0.5, 1.0, 2.0])
    np.testing.assert_allclose(425 * 0.05 / z - 425 * 0.05 / (z + STEREO.sigma(z)), 0.08, rtol=0.02)


def test_time_of_flight_hardly_gets_worse_with_distance():
    assert TIME_OF_FLIGHT.sigma(2.0) < 1.5 * TIME_OF_FLIGHT.sigma(0.6)
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
    ("changes", "message"),
    [
        ({"axial": (0.1, 0.2)}, "axial: expected 3 finite numbers"),
        ({"smooth": -1e-3}, "smooth: expected a number from 0 to 100, got -0.001"),
        ({"offset": np.nan}, "offset: expected a finite number"),
        ({"edges": 1.1}, "edges: expected a number from 0 to 1, got 1.1"),
        ({"edge_width": 1.5}, "edge_width: expected a whole number from 0 to 100, got 1.5"),
        ({"nearest": 2.0, "farthest": 1.0}, "farthest: expected more than nearest, 2, got 1"),
    ],
)
def test_what_no_camera_has_is_said(changes, message):
    with pytest.raises(InvalidInput, match=f"^{message}"):
        replace(STRUCTURED_LIGHT, **changes)
    with pytest.raises(InvalidInput, match="^amount: expected a number of at least 0, got -1"):
        DepthNoise(axial=(0, 0, 1e-3)).times(-1)
