"""Parts are connected pixels, normals those of the planes that are seen."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from handsight.vision.kernels import depth_image
from handsight.vision.kernels.vision_records import DEPTH_POINT, HAND, OUT, TABLE
from testbed.sight_scenes import CAMERA


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95), st.sampled_from([1, 5]))
def test_parts_of_a_flat_image_are_those_of_its_mask(seed, share, least):
    wanted = np.random.default_rng(seed).random((23, 31)) < share
    labels, sizes = np.where(wanted, depth_image.OPEN, TABLE).astype(np.int32), np.empty(wanted.size)
    count = depth_image.label_parts(np.ones(wanted.shape, np.float32), labels, least, sizes)
    expected, many = label(wanted)
    big = np.isin(expected, [k for k in range(1, many + 1) if (expected == k).sum() >= least])
    assert set(zip(labels[big].tolist(), expected[big].tolist(), strict=True)) == set(
        zip(range(count), dict.fromkeys(expected[big].tolist()), strict=True)
    )
    np.testing.assert_array_equal(sizes[:count], np.bincount(labels[big], minlength=count))
    assert (labels[wanted & ~big] == OUT).all()
    assert (labels[~wanted] == TABLE).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_pixels_are_sorted_by_what_they_may_be(seed):
    """The table's where they are near its plane, on whichever side; of an object only what is above it."""
    rng = np.random.default_rng(seed)
    depth = rng.choice([0, -1, np.nan, np.inf, 0.5, 1.0, 1.5], size=(240, 320)).astype(np.float32)
    wanted, hand = rng.random((2, 240, 320)) < 0.7
    table = np.array([0.1, -0.5, -0.8, 0.9, 0.01])
    known, labels = np.empty(depth.shape, np.float32), np.empty(depth.shape, np.int32)
    depth_image.sort_pixels(CAMERA.rays, (depth, wanted, hand), table, known, labels)
    there = np.isfinite(depth) & (depth > 0)
    np.testing.assert_array_equal(known, np.where(there, depth, 0))
    height, within = CAMERA.points(depth) @ table[:3] + table[3], 0.01 * np.maximum(known**2, 1)
    clear = np.abs(np.abs(height) - within) > 1e-6
    expected = np.where(wanted & (height > within), depth_image.OPEN, OUT)
    expected[there & (np.abs(height) <= within)] = TABLE
    expected[hand] = HAND
    np.testing.assert_array_equal(labels[clear | ~there], expected[clear | ~there])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.005, 0.1), st.integers(1, 300))
def test_of_each_cube_of_space_the_first_pixel_is_taken(seed, spacing, most):
    rng = np.random.default_rng(seed)
    depth = (0.5 + 0.02 * rng.random((240, 320))).astype(np.float32)
    order = rng.permutation(depth.size)[:3000]
    chosen = np.empty(most, dtype=np.int64)
    count = depth_image.spread(CAMERA.rays, depth, order, spacing, chosen)
    z = depth.reshape(-1)[order].astype(np.float64) / spacing
    places = np.c_[CAMERA.rays.reshape(-1, 2)[order] * z[:, None], z]
    cubes = np.unique(np.floor(places), axis=0, return_index=True)[1]
    np.testing.assert_array_equal(chosen[:count], order[np.sort(cubes)[:most]])


def test_a_step_in_depth_parts():
    depth = np.ones((10, 20), np.float32)
    depth[:, 10:] += 0.03
    labels = np.full(depth.shape, depth_image.OPEN, dtype=np.int32)
    assert depth_image.label_parts(depth, labels, 1, np.empty(depth.size)) == 2
    assert len(np.unique(labels[:, :10])) == len(np.unique(labels[:, 10:])) == 1


def seen_at(depth, pixels):
    out = np.zeros(len(pixels), dtype=DEPTH_POINT)
    labels = np.zeros(depth.shape, dtype=np.int32)
    depth_image.normals_at(
        CAMERA.rays, depth, labels, np.ravel_multi_index(np.transpose(pixels), depth.shape), out
    )
    return out


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0.2, -0.8), (-0.3, -0.6, -0.7)])
def test_normals_of_a_plane_are_its_own(normal):
    n = np.array(normal) / np.linalg.norm(normal)
    rays = np.concatenate([CAMERA.rays, np.ones((240, 320, 1), np.float32)], axis=-1)
    depth = ((n @ [0, 0, 0.6]) / (rays @ n)).astype(np.float32)
    pixels = np.random.default_rng(0).integers([20, 20], [220, 300], size=(50, 2))
    found = seen_at(depth, pixels)
    np.testing.assert_allclose(found["normal"], np.tile(n, (50, 1)), atol=2e-3)
    np.testing.assert_allclose(found["point"] @ n, n @ [0, 0, 0.6], atol=1e-5)


def test_pixels_with_few_neighbours_have_no_normal():
    depth = np.zeros((240, 320), np.float32)
    depth[100, 100:110] = 0.5
    np.testing.assert_array_equal(seen_at(depth, [[100, 105]])["normal"], 0)
