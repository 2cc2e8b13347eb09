"""An edge on a tactile array says where the object is along the slide that fingertips leave open."""

import numpy as np
import pytest

import handsight as hs
import scenes
import skin_scenes
from handsight import se3
from handsight.correction import Outside
from handsight.errors import InvalidInput

ARRAY = skin_scenes.palm_array()


def across(scene, estimate):
    """Error across the edge [m]."""
    truth = scenes.nearest_truth(scene.model, scene.T_palm_object, estimate.T_palm_object)
    return abs(se3.difference(estimate.T_palm_object, truth)[:3] @ scene.across)


@pytest.mark.parametrize("draw", [skin_scenes.box_on_skin, skin_scenes.can_on_skin])
def test_an_edge_on_the_array_ends_the_slide(draw):
    """Seeds that no constant was chosen on."""
    errors, inside = [], []
    for seed in range(12):
        scene = draw(np.random.default_rng([100, seed]), ARRAY)
        touch = scene.touch(ARRAY)
        contacts = scene.tips.joined(touch.contacts(np.eye(4)))
        outside = Outside.of_skin(touch, np.eye(4))
        estimate = hs.correct_pose(scene.model, contacts, vision=scene.vision, outside=outside)
        assert estimate.consistent
        errors.append(across(scene, estimate))
        inside.append(scenes.region(scene.model, estimate, scene.T_palm_object)["in 95%"])
    assert np.mean(errors) < 2e-3
    assert np.mean(inside) > 0.8


def test_the_answer_is_as_uncertain_as_the_array():
    scene = skin_scenes.box_on_skin(np.random.default_rng(3), ARRAY)
    touch = scene.touch(ARRAY)
    contacts = scene.tips.joined(touch.contacts(np.eye(4)))
    by_error = np.zeros((6, 2))
    by_error[0, 0], by_error[4, 1] = 0.01, 0.1
    for errors, least in ((None, [5e-4, 5e-4, 5e-4]), (by_error, [0.01, 5e-4, 5e-4])):
        outside = Outside.of_skin(touch, np.eye(4), errors)
        estimate = hs.correct_pose(scene.model, contacts, vision=scene.vision, outside=outside)
        assert (np.sqrt(np.diag(estimate.covariance))[:3] >= np.array(least)).all()
    assert outside.skin[4] > 0.1


def test_what_two_say_is_said_together():
    a = Outside([[0, 0, 1.0], [0, 0, 2]], sigmas=1e-3, links=[4, 4], slacks=[0.0, 0.1])
    b = Outside([[1.0, 0, 0]], sigmas=[2e-3], skin=np.arange(6.0))
    both = a.joined(b)
    np.testing.assert_array_equal(both.points_palm, [[0, 0, 1], [0, 0, 2], [1, 0, 0]])
    np.testing.assert_array_equal(both.sigmas, [1e-3, 1e-3, 2e-3])
    np.testing.assert_array_equal(both.links, [4, 4, 5])
    np.testing.assert_array_equal(both.slacks, [0, 0.1, 0])
    np.testing.assert_array_equal(both.skin, np.arange(6.0))


def test_a_skin_of_another_shape_is_told():
    with pytest.raises(InvalidInput, match=r"outside\.skin: expected 6 finite numbers"):
        Outside([[0, 0, 1.0]], sigmas=1e-3, skin=[1e-3])
