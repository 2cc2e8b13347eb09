"""Depth points in one solve with contacts: they know no more than the pose that they gave, and lead to the truth."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.errors import InvalidInput
from handsight.vision import depth_points

BOX = hs.ObjectModel.box((0.06, 0.08, 0.12))
T = se3.compose(se3.rotation_exp(np.array([0.3, -0.5, 0.2])), np.array([0.02, -0.01, 0.1]))


def seen(rng, count=300, off=0.0):
    """Points of one half of the surface in the palm, some pixels without, some of other things."""
    points = BOX.points_object[BOX.points_object @ [0.5, 0.6, 0.7] > 0.01][:count]
    points = se3.apply(T, points) + off * rng.normal(size=(len(points), 3))
    return np.vstack([points, np.full((5, 3), np.nan), points[:20] + 0.2])


def vision(rng):
    root = 0.02 * rng.normal(size=(6, 6)) * np.repeat([0.1, 1.0], 3)[:, None]
    return hs.PosePrior(T, root @ root.T + np.diag(np.repeat([1e-3**2, 0.01**2], 3)))


@pytest.mark.parametrize("seed", range(5))
def test_points_know_no_more_than_their_pose_in_any_direction(seed):
    rng = np.random.default_rng(seed)
    prior = vision(rng)
    contacts = depth_points(BOX, seen(rng), prior)
    assert not contacts.has_normal.any()
    surface = BOX.evaluate(se3.apply(se3.inverse(T), contacts.points_palm))
    normals = surface.gradient @ T[:3, :3].T
    rows = np.hstack([normals, np.cross(contacts.points_palm - T[:3, 3], normals)])
    rows /= np.sqrt(contacts.covariance[:, 0, 0])[:, None]
    left = np.linalg.eigvalsh(np.linalg.inv(prior.covariance) - rows.T @ rows)
    assert left[0] > -1e-6 * left[-1]
    share = np.linalg.eigvals(prior.covariance @ rows.T @ rows).real
    assert share.max() == pytest.approx(1.0, abs=1e-6)  # and in one as much


def test_one_solve_of_points_and_touches_finds_the_pose():
    rng = np.random.default_rng(1)
    prior = hs.PosePrior.from_sigmas(T, 0.002, 0.02)
    touched = hs.Contacts(se3.apply(T, np.array([[-0.03, 0.01, 0.0], [0.0, -0.04, 0.02]])))
    contacts = touched.joined(depth_points(BOX, seen(rng, off=5e-4), prior))
    begun = se3.moved(T, np.array([0.008, -0.006, 0.007, 0.05, -0.04, 0.06]))
    found = hs.correct_pose(BOX, contacts, vision=hs.PosePrior.from_sigmas(begun, 0.02, 0.2))
    off = se3.difference(found.T_palm_object, T)
    assert np.linalg.norm(off[:3]) < 0.0015
    assert np.linalg.norm(off[3:]) < 0.03


def test_where_no_point_is_the_objects_there_are_none_and_what_is_no_point_is_refused():
    prior = hs.PosePrior.from_sigmas(T, 0.002, 0.02)
    for none in (np.empty((0, 3)), np.full((4, 3), np.nan), np.ones((4, 3))):
        assert depth_points(BOX, none, prior) is None
    for wrong in (np.ones(3), np.ones((3, 2)), np.ones((3, 3), dtype=int)):
        with pytest.raises(InvalidInput, match=r"points_palm: expected floats of shape \(n, 3\), got"):
            depth_points(BOX, wrong, prior)
