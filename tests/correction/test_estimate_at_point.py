"""What a covariance is at a point of the object, and which of a symmetric object's poses is nearest."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.correction.estimate import point_uncertainty

SEEDS = st.integers(0, 2**32 - 1)
BOX = hs.ObjectModel.box([0.06, 0.09, 0.14])


@given(SEEDS)
def test_a_point_moves_with_the_shift_and_with_the_turn_at_its_lever(seed):
    rng = np.random.default_rng(seed)
    root, point, T = rng.normal(size=(6, 6)), rng.normal(scale=0.1, size=3), se3.random(rng, spread=0.1)
    estimate = SimpleNamespace(T_palm_object=T, information=root @ root.T + 0.1 * np.eye(6))
    found, largest = point_uncertainty(estimate, BOX, point)
    J = np.hstack([np.eye(3), -se3.skew(T[:3, :3] @ point)])
    expected = J @ np.linalg.inv(estimate.information) @ J.T
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert largest == pytest.approx(np.linalg.eigvalsh(expected)[-1], rel=1e-6)
