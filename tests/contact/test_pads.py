"""Pads that say no more than that they are touched: a contact anywhere on them, whose regions hold the truth."""

import numpy as np
import pytest

import handsight as hs
from handsight.errors import InvalidInput
from testbed import pad_scenes, scenes
from testbed.pad_scenes import HELD_OUT, OBJECTS, OBJECTS_HELD_OUT, SHAPES, touching
from testbed.refusals import refused

FLAT, DOME = SHAPES["finger pad"].pad(), SHAPES["dome"].pad()


def test_a_pads_contact_is_as_uncertain_as_the_pad_is_large():
    """Along it twice the variance of a point anywhere on it; across it the skin's height and the mount's alone."""
    contacts = FLAT.touch([1.0]).contacts(np.eye(4))
    assert len(contacts) == 1
    np.testing.assert_allclose(contacts.points_palm[0], 0, atol=1e-12)
    np.testing.assert_allclose(contacts.normals_palm[0], [0, 0, -1])
    shape = SHAPES["finger pad"]
    sides = np.array([shape.width, shape.length]) / np.sqrt(6)  # a side's variance is its square over 12
    np.testing.assert_allclose(np.sqrt(np.diag(contacts.covariance[0])[:2]), sides, rtol=0.03)
    across = FLAT.sigma_point**2 + FLAT.sigma_mount**2
    assert contacts.covariance[0, 2, 2] == pytest.approx(across)


def test_the_normal_of_a_bent_pad_is_less_certain():
    flat, dome = (pad.touch([1.0]).contacts(np.eye(4)).covariance[0] for pad in (FLAT, DOME))
    assert np.trace(dome[3:, 3:]) > np.trace(flat[3:, 3:]) > 2 * np.deg2rad(45) ** 2


def test_a_pad_that_is_not_pressed_says_nothing():
    for reading in ([0.0], [0.49], [np.nan], [-3.0], [False]):
        touch = FLAT.touch(reading)
        assert touch.contacts(np.eye(4)) is None
        assert not len(touch.outside(np.eye(4)))
        assert not touch.pressed.any()
    assert FLAT.touch([True]).pressed.all()


def test_of_several_numbers_the_length_of_their_change_counts():
    magnets = SHAPES["finger pad"].pad(channels=15, threshold=30.0, offset=5.0)
    rest = np.random.default_rng(0).normal(size=15)
    change = np.zeros(15)
    change[[2, 7]] = -18.0, 24.1
    assert magnets.touch(5 + rest + change, rest).pressed.all()
    assert not magnets.touch(5 + rest + 0.99 * change, rest).pressed.any()
    assert not magnets.touch(np.where(change > 0, np.nan, change)).pressed.any()


def answers(model, shape, count, *, tips, seed=31):
    """Whether the 95 % regions hold the truth, with and without the pad, and their sizes as shares of those without."""
    inside, without, shrunk = [], [], []
    contacts = shape.pad().touch([1.0]).contacts(np.eye(4))
    for k in range(count):
        scene = touching(model, shape, np.random.default_rng([seed, k]))
        all_contacts = scene.tips.joined(contacts) if tips else contacts
        estimate = hs.correct_pose(model, all_contacts, vision=scene.vision)
        inside.append(scenes.region(model, estimate, scene.T_palm_object)["in 95%"])
        before = np.linalg.inv(scene.vision.covariance)
        if tips:
            by_tips = hs.correct_pose(model, scene.tips, vision=scene.vision)
            before = by_tips.information
            without.append(scenes.region(model, by_tips, scene.T_palm_object)["in 95%"])
        shrunk.append(pad_scenes.shrunk(before, estimate.information))
    return inside, without, shrunk


@pytest.mark.parametrize("tips", [False, True])
def test_a_pads_contact_does_not_make_the_region_miss_and_is_not_useless(tips):
    """On pads and objects on which no constant was chosen."""
    found = [
        answers(OBJECTS[name](), SHAPES[pad], 50, tips=tips) for name in OBJECTS_HELD_OUT for pad in HELD_OUT
    ]
    inside, without, shrunk = (np.concatenate(each) for each in zip(*found, strict=True))
    # Two tips alone miss a few; of 200 regions a few more or less are chance.
    assert inside.mean() >= (without.mean() - 0.01 if tips else 0.92)
    assert np.median(shrunk) < (0.97 if tips else 0.75)


@pytest.mark.parametrize(
    ("given", "field"),
    [({"channels": 0}, "channels"), ({"channels": 1.5}, "channels"), ({"threshold": -1.0}, "threshold")],
)
def test_a_wrong_pad_is_refused(given, field):
    with refused(InvalidInput, field):
        SHAPES["palm"].pad(**given)


@pytest.mark.parametrize("reading", [[1.0, 2.0], 1.0, "pressed", [[1.0]]])
def test_a_reading_of_another_shape_is_refused(reading):
    with refused(InvalidInput, "reading"):
        FLAT.touch(reading)
