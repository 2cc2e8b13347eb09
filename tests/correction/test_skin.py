"""An edge on a tactile array says where the object is along the slide that fingertips leave open."""

import numpy as np
import pytest
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from handsight.simulation.taxels import FOAM, RUBBER
from testbed import scenes, skin_scenes
from testbed.refusals import refused

ARRAY = skin_scenes.palm_array()


def across(scene, estimate):
    """Error across the edge [m]."""
    truth = scenes.nearest_truth(scene.model, scene.T_palm_object, estimate.T_palm_object)
    return abs(se3.difference(estimate.T_palm_object, truth)[:3] @ scene.across)


@pytest.mark.parametrize("draw", [skin_scenes.box_on_skin, skin_scenes.can_on_skin])
def test_an_edge_on_the_array_ends_the_slide(draw):
    """The numbers of draws were tried on these seeds, too."""
    errors, inside = [], []
    for seed in range(12):
        scene = draw(np.random.default_rng([100, seed]), ARRAY)
        touch = scene.touch(ARRAY)
        skin = SkinEvidence.of(touch, np.eye(4))
        estimate = hs.correct_pose(scene.model, scene.tips, vision=scene.vision, skin=skin)
        assert estimate.consistent
        errors.append(across(scene, estimate))
        inside.append(scenes.region(scene.model, estimate, scene.T_palm_object)["in 95%"])
    assert np.mean(errors) < 2e-3
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("springs", [RUBBER, FOAM])
def test_errors_on_an_array_are_as_large_as_the_answer_says(springs):
    """Where a skin is hard, half of the taxels under a face are not touched. Tilts are left out: the box has none."""
    squared, flat = [], [0, 1, 2, 5]
    for seed in range(30):
        scene = skin_scenes.box_on_skin(np.random.default_rng([101, seed]), ARRAY, springs=springs)
        skin = SkinEvidence.of(scene.touch(ARRAY), np.eye(4))
        estimate = hs.correct_pose(scene.model, scene.tips, vision=scene.vision, skin=skin)
        truth = scenes.nearest_truth(scene.model, scene.T_palm_object, estimate.T_palm_object)
        error, C = (
            se3.difference(estimate.T_palm_object, truth)[flat],
            estimate.covariance[np.ix_(flat, flat)],
        )
        squared.append(error @ np.linalg.solve(C, error))
    inside = [(np.array(squared) < chdtri(4, 1 - level)).mean() for level in (0.5, 0.95)]
    assert 0.5 < np.mean(squared) / 4 < 1.6
    assert 0.3 < inside[0] < 0.75
    assert inside[1] > 0.85


def test_an_untouched_taxel_says_less_where_covered_ones_are_not_touched():
    """One in four is added to the share of these; with none of either it is 0.3 mm."""
    reading = np.zeros(ARRAY.shape)
    assert ARRAY.touch(reading).sigma_clearance == pytest.approx(5e-4 / np.sqrt(2 * np.log(4)))
    reading[4, 4:7] = 1.0
    assert ARRAY.touch(reading).sigma_clearance == pytest.approx(5e-4 / np.sqrt(2 * np.log(7)))
    reading[4, 5] = 0.0
    assert ARRAY.touch(reading).sigma_clearance == pytest.approx(5e-4 / np.sqrt(2 * np.log(7 / 2)))


def test_the_answer_is_as_uncertain_as_the_array():
    scene = skin_scenes.box_on_skin(np.random.default_rng(3), ARRAY)
    touch = scene.touch(ARRAY)
    by_error = np.zeros((6, 2))
    by_error[0, 0], by_error[4, 1] = 0.01, 0.1
    for errors, least in ((None, [5e-4, 5e-4, 5e-4]), (by_error, [0.01, 5e-4, 5e-4])):
        skin = SkinEvidence.of(touch, np.eye(4), errors)
        estimate = hs.correct_pose(scene.model, scene.tips, vision=scene.vision, skin=skin)
        assert (np.sqrt(np.diag(estimate.covariance))[:3] >= np.array(least)).all()
    assert skin.sigmas[4] > 0.1


def test_an_array_is_combined_with_points_of_the_hand_and_another_array():
    scene = skin_scenes.box_on_skin(np.random.default_rng(3), ARRAY)
    skin = SkinEvidence.of(scene.touch(ARRAY), np.eye(4))
    far = SkinEvidence(None, [[0.0, 0.0, 0.9]], np.full(6, 1e-6))
    alone, both, hand = (
        hs.correct_pose(scene.model, scene.tips, vision=scene.vision, skin=given, outside=outside)
        for given, outside in ((skin, None), (skin.joined(far), None), (skin, [[0.0, 0.0, 0.9]]))
    )
    assert len(skin.joined(far).untouched_palm) == len(skin.untouched_palm) + 1
    np.testing.assert_array_equal(skin.joined(far).sigmas, skin.sigmas)
    for other in (both, hand):
        np.testing.assert_allclose(other.T_palm_object, alone.T_palm_object, atol=1e-9)


def test_wrong_skin_evidence_is_refused():
    with refused(InvalidInput, "skin.sigmas"):
        SkinEvidence(None, np.empty((0, 3)), [1e-3])
    with refused(InvalidInput, "skin.contacts"):
        SkinEvidence(np.eye(3), np.empty((0, 3)), np.ones(6))
    scene = skin_scenes.box_on_skin(np.random.default_rng(3), ARRAY)
    with refused(InvalidInput, "skin"):
        hs.correct_pose(scene.model, scene.tips, skin=3)
