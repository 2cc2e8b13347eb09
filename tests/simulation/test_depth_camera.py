"""A simulated depth camera is wrong by what its numbers say: from image to image, in each image alike, and at edges."""

from dataclasses import replace

import numpy as np
import pytest

from handsight.errors import InvalidInput
from handsight.simulation import Scenario, rig_of, simulate
from handsight.simulation.camera import EDGE, add_depth_noise
from handsight.vision import PRESETS, STRUCTURED_LIGHT, DepthNoise
from simulation.simulated import only

SHAPE = (480, 640)
BARE = DepthNoise(axial=(0.0, 0.0, 0.0))
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


def test_depth_is_rounded_to_steps_of_disparity():
    seen = np.unique(images(wall(0.9), STRUCTURED_LIGHT, 1))
    steps = np.diff(1 / (STRUCTURED_LIGHT.step * seen[np.isfinite(seen)].astype(float)))
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    assert len(steps) > 3


def test_a_pixel_has_the_depth_of_a_pixel_near_it():
    """On a slope that is its slope's error; by whole pixels, as Gaussians are rounded."""
    noise, slope = replace(BARE, lateral=0.7), 1e-3
    for axis in (0, 1):
        depth = np.float32(1 + slope * np.indices(SHAPE)[axis])
        off = (images(depth, noise, 1)[0] - depth)[3:-3, 3:-3] / slope
        drawn = np.rint(0.7 * np.random.default_rng(0).normal(size=10**6))
        assert off.std() == pytest.approx(drawn.std(), rel=0.02)
        np.testing.assert_allclose(off, np.round(off), atol=1e-2)


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
def test_bias_is_smooth_of_the_stated_size_and_grows_with_the_square_of_the_depth(kind):
    noise = replace(PRESETS[kind], axial=(0.0, 0.0, 0.0), step=0.0, edges=0.0, dropouts=0.0, lateral=0.0)
    seeds = range(150)
    shape = (160, 160)
    found = {
        z: np.stack([add_depth_noise(wall(z, shape), noise, np.random.default_rng(0), s) for s in seeds]) - z
        for z in (0.7, 2.0)
    }
    offsets = found[0.7] - (found[2.0] - found[0.7]) * 0.7**2 / (2.0**2 - 0.7**2)
    assert np.ptp(offsets, axis=(1, 2)).max() < 1e-5, "what does not grow is the same all over the image"
    assert offsets[:, 0, 0].std() == pytest.approx(noise.offset, rel=0.25)
    smooth = (found[2.0] - offsets) / 2.0**2
    assert smooth.std() == pytest.approx(noise.smooth, rel=0.1)
    apart = (smooth * np.roll(smooth, int(noise.smooth_length), axis=2)).mean() / (smooth**2).mean()
    assert apart == pytest.approx(np.exp(-1), abs=0.1)
    everything = np.sqrt((found[2.0].astype(float) ** 2).mean())
    assert everything == pytest.approx(float(noise.bias(2.0)), rel=0.15)


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


def test_noise_follows_from_the_seed_and_the_generator():
    one, same = (add_depth_noise(wall(1.0), STRUCTURED_LIGHT, np.random.default_rng(3), 4) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    assert (one != add_depth_noise(wall(1.0), STRUCTURED_LIGHT, np.random.default_rng(4), 4)).mean() > 0.3


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
    with pytest.raises(
        InvalidInput, match="^depth_camera: expected one of structured_light, .*, got 'lidar'"
    ):
        Scenario(depth_camera="lidar")
