"""What goes out to those who take covariances alone is never certain where nothing is known."""

import numpy as np
import pytest

from handsight.correction import PoseEstimate, bounded_covariance


def informed(rng, rank):
    """Information of so many directions, as contacts have it: deviations of 0.1 to 10 mm and millirad."""
    deviations = 10 ** rng.uniform(-4, -2, size=(rank, 1))
    directions = np.linalg.qr(rng.normal(size=(6, 6)))[0][:rank]
    rows = directions / deviations
    return rows.T @ rows, directions


@pytest.mark.parametrize("rank", range(7))
def test_open_directions_and_only_they_have_a_variance_of_one_or_more(rank):
    information, directions = informed(np.random.default_rng(rank), rank)
    covariance = bounded_covariance(information)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-6, atol=1e-12)
    values = np.linalg.eigvalsh(covariance)
    assert (values >= 1 - 1e-9).sum() == 6 - rank
    assert values.min() > 0
    known = directions @ information @ directions.T  # what is known stays as it was
    np.testing.assert_allclose(directions @ covariance @ directions.T @ known, np.eye(rank), atol=2e-3)


def test_a_spin_about_the_origin_has_the_variance_of_a_full_turn():
    information = np.diag([1e6, 1e6, 1e6, 1e4, 1e4, 0.0])
    assert bounded_covariance(information)[5, 5] == pytest.approx(np.pi**2 / 3, rel=1e-12)


def test_a_known_covariance_is_its_own_bounded_covariance():
    covariance = np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4])
    estimate = PoseEstimate.from_gaussian(np.eye(4), covariance, np.zeros((0, 6)))
    np.testing.assert_array_equal(estimate.bounded_covariance, covariance)
    spun = estimate.with_gaussian(np.eye(4), None, np.diag([1e6, 1e6, 1e6, 1e4, 1e4, 0.0]))
    assert spun.bounded_covariance[5, 5] == pytest.approx(np.pi**2 / 3, rel=1e-12)
