"""Taxel arrays: pressed taxels are contacts, untouched ones are points without object, others are no evidence."""

from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.contact import TactileSurface
from handsight.contact.taxels import CLEARANCE, MAX_CONTACTS, grid_places
from handsight.errors import InvalidInput
from testbed.refusals import refused

FIELDS = {
    "frame": "palm",
    "T_frame_grid": np.eye(4),
    "rows": 6,
    "columns": 9,
    "pitch": 0.004,
    "threshold": 0.1,
}
ARRAY = TactileSurface.grid(**FIELDS)
T = se3.random(np.random.default_rng(1), spread=0.2)


def block(rows=slice(1, 4), columns=slice(2, 6), value=1.0):
    """Readings with a pressed rectangle."""
    reading = np.zeros(ARRAY.shape)
    reading[rows, columns] = value
    return reading


def test_taxels_lie_about_the_middle_of_the_grid_a_pitch_apart():
    places = grid_places(*ARRAY.places, ARRAY.pitch)
    np.testing.assert_allclose(places.mean(axis=(0, 1)), 0, atol=1e-15)
    np.testing.assert_allclose(np.diff(places, axis=1), np.tile([0.004, 0, 0], (6, 8, 1)), atol=1e-15)
    np.testing.assert_allclose(np.diff(places, axis=0), np.tile([0, 0.004, 0], (5, 9, 1)), atol=1e-15)


def test_pressed_taxels_are_contacts_that_the_object_pushes_into_the_link():
    touch = ARRAY.touch(block())
    contacts = touch.contacts(T)
    assert len(contacts) == 12
    np.testing.assert_allclose(contacts.normals_palm, np.tile(-T[:3, 2], (12, 1)))
    in_grid = se3.apply(se3.inverse(T), contacts.points_palm)
    expected = grid_places(*ARRAY.places, ARRAY.pitch)[touch.pressed]
    apart = np.linalg.norm(in_grid[:, None] - expected, axis=2)
    np.testing.assert_allclose([apart.min(axis=0), apart.min(axis=1)], 0, atol=1e-12)
    own = T[:3, :3].T @ contacts.covariance[0, :3, :3] @ T[:3, :3]
    np.testing.assert_allclose(own, np.diag([0.004**2 / 12, 0.004**2 / 12, ARRAY.sigma_point**2]), atol=1e-15)


def test_untouched_ones_are_points_above_the_skin():
    touch = ARRAY.touch(block())
    points = se3.apply(se3.inverse(T), touch.outside(T))
    assert len(points) == touch.untouched.sum() == 54 - 12
    np.testing.assert_allclose(points[:, 2], CLEARANCE, atol=1e-12)


def test_nothing_is_pressed_below_the_threshold():
    touch = ARRAY.touch(block(value=0.09))
    assert touch.contacts(T) is None
    assert touch.untouched.all()


@pytest.mark.parametrize("dead", [np.nan, np.inf, 0.0, -5.0])
def test_a_dead_taxel_amid_pressed_ones_is_no_evidence(dead):
    reading = block()
    reading[2, 3] = dead
    touch = ARRAY.touch(reading)
    assert not touch.pressed[2, 3]
    assert not touch.untouched[2, 3]
    assert touch.pressed.sum() == 11


def test_a_taxel_that_is_pressed_alone_far_from_the_others_is_stuck():
    reading = block()
    reading[5, 8] = 1.0
    touch, plain = ARRAY.touch(reading), ARRAY.touch(block())
    np.testing.assert_array_equal(touch.pressed, plain.pressed)
    assert plain.untouched.sum() - touch.untouched.sum() == 1
    alone = np.zeros(ARRAY.shape)
    alone[5, 8] = 1.0  # where nothing else is, it is all there is
    assert ARRAY.touch(alone).pressed.sum() == 1


def test_a_taxel_that_is_half_covered_is_no_evidence():
    reading = block()
    reading[1:4, 6] = 0.3
    touch = ARRAY.touch(reading)
    assert not (touch.pressed | touch.untouched)[1:4, 6].any()
    assert touch.untouched[1:4, 7].all()


def test_a_baseline_is_subtracted_and_a_taxel_without_one_is_no_evidence():
    offset = np.random.default_rng(0).normal(size=ARRAY.shape)
    offset[0, 0] = np.nan
    touch, plain = ARRAY.touch(block() + offset, offset), ARRAY.touch(block())
    np.testing.assert_array_equal(touch.pressed, plain.pressed)
    assert not touch.untouched[0, 0]
    assert plain.untouched.sum() - touch.untouched.sum() == 1


def test_a_taxel_at_full_scale_is_pressed_whatever_its_baseline():
    array = replace(ARRAY, full_scale=2.0)
    assert array.touch(block(value=2.0), baseline=1.95).pressed.sum() == 12
    reading = block(value=1.5)
    reading[2, 3] = 2.0  # those around it are pressed, too
    assert array.touch(reading).pressed.sum() == 12


def test_of_many_taxels_the_outermost_are_kept():
    array = TactileSurface.grid(**FIELDS | {"rows": 20, "columns": 20})
    contacts = array.touch(np.ones((20, 20))).contacts(np.eye(4))
    assert len(contacts) == MAX_CONTACTS
    corners = np.abs(contacts.points_palm[:, :2]).min(axis=1) > 0.0379
    assert corners.sum() == 4


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("rows", 0, "rows"),
        ("columns", 2.5, "columns"),
        ("rows", 1000, "rows"),
        ("pitch", 4.0, "pitch"),
        ("threshold", 0.0, "threshold"),
        ("full_scale", 0.05, "full_scale"),
        ("sigma_normal", 5.0, "sigma_normal"),
    ],
)
def test_what_is_no_array_is_reported(field, value, named):
    with refused(InvalidInput, named):
        TactileSurface.grid(**FIELDS | {field: value})
