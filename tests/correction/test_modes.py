"""The uncertainty of an answer: information, open directions, regions, fit."""

import numpy as np
import pytest
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.correction import modes
from testbed.scenes import BOX_NORMALS, BOX_POINTS, box, can, can_contacts, grasp


def regions(model, points_normals, count):
    """Share of truths inside the 50 % and the 95 % region, over generated problems with true sigmas."""
    from scipy.special import chdtri

    from handsight.objects.symmetry import nearest

    inside = []
    for seed in range(count):
        contacts, vision, T = grasp(*points_normals(seed), seed)
        estimate = hs.correct_pose(model, contacts, vision=vision)
        truth = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
        delta = se3.difference(truth, estimate.T_palm_object)
        squared = delta @ estimate.information @ delta
        freedom = 6 - len(model.symmetries.axes)
        inside.append([squared < chdtri(freedom, 0.5), squared < chdtri(freedom, 0.05)])
    return np.mean(inside, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("thing", ["can", "box"])
def test_the_truth_is_in_a_region_as_often_as_its_level(thing):
    count = 200
    if thing == "can":
        half, most = regions(can(), lambda _: can_contacts(), count)
    else:
        half, most = regions(box(), lambda _: (BOX_POINTS, BOX_NORMALS), count)
    # Four standard errors of a share of 200.
    assert abs(half - 0.5) < 4 * np.sqrt(0.25 / count)
    assert abs(most - 0.95) < 4 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.slow
@pytest.mark.parametrize("error", [(0.020, np.deg2rad(15)), (0.085, np.deg2rad(30))], ids=["near", "far"])
def test_the_can_and_the_box_are_found_from_near_and_from_far(error):
    found = []
    for seed in range(60):
        for model, points, normals in ((can(), *can_contacts()), (box(), BOX_POINTS, BOX_NORMALS)):
            contacts, vision, T = grasp(points, normals, seed, error=error)
            estimate = hs.correct_pose(model, contacts, vision=vision)
            from handsight.objects.symmetry import nearest

            truth = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
            delta = se3.difference(estimate.T_palm_object, truth) * np.repeat([1.0, model.radius], 3)
            delta -= estimate.unobservable.T @ (estimate.unobservable @ delta)
            turn = np.linalg.norm(delta[3:]) / model.radius
            found.append(np.linalg.norm(delta[:3]) < 0.005 and turn < np.deg2rad(8))
    assert np.mean(found) >= 0.97


def test_whichever_contact_is_wrong_is_an_outlier():
    for wrong in range(5):
        contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, seed=20 + wrong)
        normals = contacts.normals_palm.copy()
        normals[wrong] = np.cross(normals[wrong], T[:3, 0] + 0.3 * T[:3, 1] + 0.2 * T[:3, 2])
        spoiled = hs.Contacts(contacts.points_palm, normals, sigma_point=5e-4, sigma_normal=np.deg2rad(2))
        assert hs.correct_pose(box(), spoiled, vision=vision).outliers == (wrong,)


@pytest.mark.parametrize("alarm", [0.5, 0.1, 0.05, 0.01, 1e-3, 1e-6])
def test_a_quantile_of_chi_square_is_scipys(alarm):
    for freedom in (*range(1, 40), 101, 300, 768, 5000, 60_000):
        assert modes.chi2_limit(freedom, alarm) == pytest.approx(chdtri(freedom, alarm), rel=1e-10)
