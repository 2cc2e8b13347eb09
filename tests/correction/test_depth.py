"""Depth points in one solve with contacts: they know no more than the pose that they gave, and lead to the truth."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import DepthPoints, solve
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.errors import InvalidInput
from handsight.vision import depth_points
from oracles import correction as oracle

BOX = hs.ObjectModel.box((0.06, 0.08, 0.12))
T = se3.compose(se3.rotation_exp(np.array([0.3, -0.5, 0.2])), np.array([0.02, -0.01, 0.1]))


def depth_pixels(rng, count=300, off=0.0):
    """Points of one half of the surface in the palm, some pixels without, some of other things."""
    points = BOX.points_object[BOX.points_object @ [0.5, 0.6, 0.7] > 0.01][:count]
    points = se3.apply(T, points) + off * rng.normal(size=(len(points), 3))
    return np.vstack([points, np.full((5, 3), np.nan), points[:20] + 0.2])


def vision(rng):
    root = 0.02 * rng.normal(size=(6, 6)) * np.repeat([0.1, 1.0], 3)[:, None]
    return hs.PosePrior(T, root @ root.T + np.diag(np.repeat([1e-3**2, 0.01**2], 3)))


@pytest.mark.parametrize("seed", range(5))
def test_depth_points_have_no_more_information_than_their_pose_in_any_direction(seed):
    rng = np.random.default_rng(seed)
    prior = vision(rng)
    depth = DepthPoints.of_image(BOX, depth_pixels(rng), prior)
    surface = BOX.evaluate(se3.apply(se3.inverse(T), depth.points_palm))
    normals = surface.gradient @ T[:3, :3].T
    rows = np.hstack([normals, np.cross(depth.points_palm - T[:3, 3], normals)]) / depth.sigma
    left = np.linalg.eigvalsh(np.linalg.inv(prior.covariance) - rows.T @ rows)
    assert left[0] > -1e-6 * left[-1]
    share = np.linalg.eigvals(prior.covariance @ rows.T @ rows).real
    assert share.max() == pytest.approx(1.0, abs=1e-6)  # and in one as much


def test_depth_points_and_contacts_together_give_the_pose():
    rng = np.random.default_rng(1)
    prior = hs.PosePrior.from_sigmas(T, 0.002, 0.02)
    touched = hs.Contacts(se3.apply(T, np.array([[-0.03, 0.01, 0.0], [0.0, -0.04, 0.02]])))
    points = depth_pixels(rng, off=5e-4)
    depth = DepthPoints.of_image(BOX, points, prior)
    begun = hs.PosePrior.from_sigmas(
        se3.moved(T, np.array([0.008, -0.006, 0.007, 0.05, -0.04, 0.06])), 0.02, 0.2
    )
    found = hs.correct_pose(BOX, touched, vision=begun, depth=depth)
    off = se3.difference(found.T_palm_object, T)
    assert np.linalg.norm(off[:3]) < 0.0015
    assert np.linalg.norm(off[3:]) < 0.03
    assert len(found.residuals.distance) == 2
    # The former way, as contacts without normals, adds the model's own error to each point, and answers alike.
    with pytest.warns(DeprecationWarning, match="DepthPoints.of_image"):
        contacts = touched.joined(depth_points(BOX, points, prior))
    old = hs.correct_pose(BOX, contacts, vision=begun)
    np.testing.assert_allclose(old.T_palm_object, found.T_palm_object, atol=1e-5)
    np.testing.assert_allclose(old.information, found.information, rtol=0.01, atol=50)


def given(count=12, weight=None):
    """Touches and depth points of the box that fit it somewhere near T, each by noise of its own size."""
    rng = np.random.default_rng(3)
    contacts = hs.Contacts(
        se3.apply(T, np.array([[-0.03, 0.01, 0.0], [0.0, -0.04, 0.02]])) + 1e-3 * rng.normal(size=(2, 3))
    )
    depth = DepthPoints(depth_pixels(rng, off=2e-3)[:count], 0.004)
    return Problem(BOX, contacts, vision(rng), NO_OUTSIDE, None, depth)


def test_the_cost_of_depth_points_is_that_of_their_distances():
    problem, rng = given(), np.random.default_rng(0)
    Ts, everyone = (
        se3.moved(np.tile(T, (10, 1, 1)), 0.01 * rng.normal(size=(10, 6))),
        np.ones((1, 2), dtype=bool),
    )
    expected = np.array([oracle.posterior_cost(problem, T) for T in Ts])
    found = solve.cost(problem, Ts, everyone)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-6, atol=1e-5)


def test_depth_points_are_never_outliers():
    problem = given(48)
    assert (
        problem.freedom(np.ones((1, 2), dtype=bool)) == 2 + 6
    )  # no more than the six of the pose in their place
    moved = DepthPoints(problem.depth.points_palm + np.array([0.02, 0.0, 0.0]), 2e-3)
    found = hs.correct_pose(BOX, problem.contacts, vision=problem.vision, depth=moved)
    assert not found.consistent
    assert max(found.outliers, default=0) < 2


def test_wrong_depth_points_are_refused():
    contacts = given().contacts
    for points, sigma, message in (
        (np.empty((0, 3)), 1e-3, "depth.points_palm: expected from 1 to 48 points, got 0"),
        (np.zeros((49, 3)), 1e-3, "depth.points_palm: expected from 1 to 48 points, got 49"),
        (np.zeros((4, 3)), -1.0, "depth.sigma: expected"),
    ):
        with pytest.raises(InvalidInput, match=message):
            DepthPoints(points, sigma)
    with pytest.raises(InvalidInput, match="depth: expected DepthPoints or None, got Contacts"):
        hs.correct_pose(BOX, contacts, depth=contacts)
    depth = DepthPoints(np.zeros((4, 3)), 1e-3)
    with pytest.raises(InvalidInput, match="depth: expected None, as the paper's method does not use it"):
        hs.correct_pose(BOX, contacts, vision=given().vision, depth=depth, method="paper-lm-distance")


def test_without_points_near_the_object_there_are_none_and_a_wrong_array_is_refused():
    prior = hs.PosePrior.from_sigmas(T, 0.002, 0.02)
    for none in (np.empty((0, 3)), np.full((4, 3), np.nan), np.ones((4, 3))):
        assert DepthPoints.of_image(BOX, none, prior) is None
    for wrong in (np.ones(3), np.ones((3, 2)), np.ones((3, 3), dtype=int)):
        with pytest.raises(InvalidInput, match=r"points_palm: expected floats of shape \(n, 3\), got"):
            DepthPoints.of_image(BOX, wrong, prior)
    known_height = hs.PosePrior(T, np.diag([1e-6, 1e-6, 0.0, 1e-4, 1e-4, 1e-4]))
    with pytest.raises(InvalidInput, match=r"vision\.covariance: expected a positive definite one"):
        DepthPoints.of_image(BOX, depth_pixels(np.random.default_rng(0)), known_height)
