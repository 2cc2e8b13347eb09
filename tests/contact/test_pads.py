"""Pads that say no more than that they are touched: a contact anywhere on them, whose regions hold the truth."""

import numpy as np
import pytest

import handsight as hs
from handsight.contact import TactileSurface
from handsight.errors import InvalidInput
from testbed import pad_scenes, scenes
from testbed.pad_scenes import HELD_OUT, OBJECTS, OBJECTS_HELD_OUT, SHAPES, touching
from testbed.refusals import refused

FLAT = SHAPES["finger pad"].pad()


def test_a_pads_contact_is_as_uncertain_as_the_pad_is_large():
    """Along it twice the variance of a point anywhere on it; across it the skin's height and the mount's alone."""
    contacts = FLAT.touch([1.0]).contacts(np.eye(4))
    assert len(contacts) == 1
    np.testing.assert_allclose(contacts.points_palm[0], 0, atol=1e-12)
    np.testing.assert_allclose(contacts.normals_palm[0], [0, 0, -1])
    shape = SHAPES["finger pad"]
    along = np.diag(contacts.covariance[0])[:2] - FLAT.sigma_mount**2
    np.testing.assert_allclose(along, (shape.width**2 + shape.length**2) / 12, rtol=1e-6)
    across = FLAT.sigma_point**2 + FLAT.sigma_mount**2
    assert contacts.covariance[0, 2, 2] == pytest.approx(across)


def test_the_normal_of_one_taxel_is_anywhere_about_its_own():
    single = TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=1, columns=1, pitch=0.027, threshold=0.5
    )
    contacts = single.touch([[1.0]]).contacts(np.eye(4))
    turns = np.diag(contacts.covariance[0])[3:5]
    assert (turns >= np.deg2rad(45) ** 2).all()
    assert np.isnan(single.touch([[1.0]]).wrench).all()  # it measures no force


def test_a_pad_that_is_not_pressed_says_nothing():
    for reading in ([0.0], [0.49], [np.nan], [-3.0], [False]):
        touch = FLAT.touch(reading)
        assert touch.contacts(np.eye(4)) is None
        assert not len(touch.outside(np.eye(4)))
        assert not touch.pressed.any()
    assert FLAT.touch([True]).pressed.all()


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
    [({"pitch": 0.0}, "pitch"), ({"pitch": 27.0}, "pitch"), ({"threshold": -1.0}, "threshold")],
)
def test_a_wrong_pad_is_refused(given, field):
    with refused(InvalidInput, field):
        SHAPES["palm"].pad(**given)


@pytest.mark.parametrize("reading", [[1.0, 2.0], 1.0, "pressed", [[1.0]]])
def test_a_reading_of_another_shape_is_refused(reading):
    with refused(InvalidInput, "reading"):
        FLAT.touch(reading)
