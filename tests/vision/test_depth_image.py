"""Parts are connected pixels, normals those of the planes that are seen."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from handsight._kernels import depth_image
from handsight._kernels.sight_records import SEEN
from sight_scenes import CAMERA


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_parts_of_a_flat_image_are_those_of_its_mask(seed, share):
    wanted = np.random.default_rng(seed).random((23, 31)) < share
    labels = np.empty(wanted.shape, dtype=np.int32)
    count = depth_image.label_parts(np.ones(wanted.shape, np.float32), wanted, labels)
    expected, many = label(wanted)
    assert count == many
    pairs = set(zip(labels[wanted].tolist(), expected[wanted].tolist(), strict=True))
    assert len(pairs) == many
    assert (labels[~wanted] == -1).all()


def test_a_step_in_depth_parts():
    depth = np.ones((10, 20), np.float32)
    depth[:, 10:] += 0.03
    labels = np.empty(depth.shape, dtype=np.int32)
    assert depth_image.label_parts(depth, np.ones(depth.shape, bool), labels) == 2
    assert len(np.unique(labels[:, :10])) == len(np.unique(labels[:, 10:])) == 1


def seen_at(depth, pixels):
    out = np.zeros(len(pixels), dtype=SEEN)
    labels = np.zeros(depth.shape, dtype=np.int32)
    depth_image.look_at(CAMERA.rays, depth, labels, np.asarray(pixels), out)
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


def test_where_little_is_seen_there_is_no_normal():
    depth = np.zeros((240, 320), np.float32)
    depth[100, 100:110] = 0.5
    np.testing.assert_array_equal(seen_at(depth, [[100, 105]])["normal"], 0)
