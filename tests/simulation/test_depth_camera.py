"""A simulated depth camera is wrong by what its numbers say: from image to image, in each image alike, and at edges."""

from dataclasses import replace

import numpy as np
import pytest

from handsight.errors import InvalidInput
from handsight.simulation import Scenario, rig_of, simulate
from handsight.simulation.camera import EDGE, add_depth_noise
from handsight.vision import PRESETS
from simulation.simulated import only
from testbed.refusals import refused

SHAPE = (480, 640)
KINDS = pytest.mark.parametrize("kind", sorted(PRESETS))


def wall(z, shape=SHAPE):
    return np.full(shape, z, dtype=np.float32)


def images(depth, noise, count, seed=0, drawn=0):
    """(count, h, w) one camera's."""
    rng = np.random.default_rng(drawn)
    return np.stack([add_depth_noise(depth, noise, rng, seed) for _ in range(count)])


@KINDS
@pytest.mark.parametrize("z", [0.6, 1.0, 2.0, 3.5])
@pytest.mark.parametrize("amount", [1, 2])
def test_from_image_to_image_depth_differs_by_its_sigma(kind, z, amount):
    noise = PRESETS[kind].times(amount)
    one, other = images(wall(z), noise, 2).astype(float)
    assert np.nanstd(one - other) / 2**0.5 == pytest.approx(amount * PRESETS[kind].sigma(z), rel=0.04)
    assert abs(np.nanmean(one - other)) < 0.05 * noise.sigma(z)


@KINDS
def test_noise_of_neighbouring_pixels_is_correlated_as_stated(kind):
    noise = replace(PRESETS[kind], step=0.0, dropouts=0.0)
    one, other = images(wall(1.0), noise, 2).astype(float)
    off = one - other - (one - other).mean()
    for lag in (1, 3, 5, 8, 16):
        for moved in (np.roll(off, lag, axis=0), np.roll(off, lag, axis=1)):
            expected = noise.correlated * np.exp(-((lag / noise.correlation) ** 2))
            assert (off * moved).mean() / (off**2).mean() == pytest.approx(expected, abs=0.03)


@KINDS
def test_bias_is_the_same_in_all_images_of_a_camera_and_differs_between_cameras(kind):
    noise = replace(PRESETS[kind], dropouts=0.0)
    constant = replace(noise, axial=(0.0, 0.0, 0.0), step=0.0)
    bias, again = images(wall(1.2), constant, 2) - 1.2
    np.testing.assert_array_equal(bias, again)
    mean = images(wall(1.2), noise, 16, drawn=1).astype(float).mean(axis=0) - 1.2
    # What is left is noise of sixteen images: 1/4 of one's, and what rounding keeps of the step.
    left = np.hypot(noise.sigma(1.2) / 4, 0.1 * noise.step * 1.2**2)
    assert (mean - bias).std() < 1.2 * left
    one, other = (np.ravel(images(wall(1.2), constant, 1, seed=seed) - 1.2) for seed in (0, 1))
    assert abs(np.corrcoef(one, other)[0, 1]) < 0.5


@KINDS
@pytest.mark.parametrize("share", [None, 1.0])
def test_depth_is_lost_behind_edges_and_seldom_elsewhere(kind, share):
    noise = PRESETS[kind] if share is None else replace(PRESETS[kind], edges=share)
    depth = wall(1.1)
    depth[100:300, 200:400] = 0.9
    depth[350:400, 200:400] -= EDGE / 2  # no edge
    lost = np.isnan(images(depth, noise, 20)).mean(axis=0)
    reach = noise.edge_width
    behind = np.zeros(SHAPE, dtype=bool)
    behind[100 - reach : 300 + reach, 200 - reach : 400 + reach] = True
    behind[100:300, 200:400] = False
    assert lost[behind].mean() == pytest.approx(noise.edges, abs=0.02)
    assert lost[~behind].mean() == pytest.approx(noise.dropouts, rel=0.03)


@KINDS
def test_without_noise_depth_is_exact_in_range_and_missing_beyond(kind):
    noise = PRESETS[kind]
    rng = np.random.default_rng(0)
    depth = rng.uniform(noise.nearest + 1e-3, noise.farthest - 1e-3, (30, 40)).astype(np.float32)
    depth[0] = 0.9 * noise.nearest
    depth[1] = 1.1 * noise.farthest
    depth[2], depth[3], depth[4], depth[5] = np.nan, np.inf, 0, -1
    seen = add_depth_noise(depth, noise.times(0), rng, 0)
    assert seen.dtype == np.float32
    assert np.isnan(seen[:6]).all()
    np.testing.assert_array_equal(seen[6:], depth[6:])
    spoilt = add_depth_noise(depth, noise, rng, 0)
    assert np.isnan(spoilt[:6]).all()
    assert not np.isinf(spoilt).any()
    assert not (spoilt < 0.9 * noise.nearest).any()


@KINDS
def test_a_scenarios_camera_is_of_the_kind_that_its_rig_states(kind):
    scenario = Scenario(depth_camera=kind, images=True, nuisances=only(depth_noise=1.0))
    assert rig_of(scenario).camera.depth_camera == kind
    exact = Scenario(images=True, nuisances=only(depth_noise=0.0))
    seen, true = (next(sample for sample in simulate(each)).observation.depth for each in (scenario, exact))
    known = np.isfinite(seen) & np.isfinite(true)
    noise, z = PRESETS[kind], np.nanmedian(true)
    # Of the table and the object, edges aside: noise and bias, as large as the camera's.
    spread = np.diff(np.nanpercentile((seen - true)[known], [16, 84]))[0] / 2
    assert 0.6 * noise.sigma(z) < spread < 2 * np.hypot(noise.sigma(z), noise.bias(z))


def test_an_unknown_kind_of_camera_is_rejected():
    with refused(InvalidInput, "depth_camera"):
        Scenario(depth_camera="lidar")
