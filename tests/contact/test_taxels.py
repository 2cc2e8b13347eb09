"""Taxel arrays: pressed taxels are contacts, untouched ones are points without object, others are no evidence."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from handsight import se3
from handsight.contact import TactileSurface, TaxelArray
from handsight.contact.taxels import CLEARANCE, MAX_CONTACTS, MAX_FAR
from handsight.errors import InvalidInput

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
    places = ARRAY.places_grid
    np.testing.assert_allclose(places.mean(axis=(0, 1)), 0, atol=1e-15)
    np.testing.assert_allclose(np.diff(places, axis=1), np.tile([0.004, 0, 0], (6, 8, 1)), atol=1e-15)
    np.testing.assert_allclose(np.diff(places, axis=0), np.tile([0, 0.004, 0], (5, 9, 1)), atol=1e-15)


def test_pressed_taxels_are_contacts_that_the_object_pushes_into_the_link():
    touch = ARRAY.touch(block())
    contacts = touch.contacts(T)
    assert len(contacts) == 12
    np.testing.assert_allclose(contacts.normals_palm, np.tile(-T[:3, 2], (12, 1)))
    in_grid = se3.apply(se3.inverse(T), contacts.points_palm)
    expected = ARRAY.places_grid[touch.pressed]
    apart = np.linalg.norm(in_grid[:, None] - expected, axis=2)
    np.testing.assert_allclose([apart.min(axis=0), apart.min(axis=1)], 0, atol=1e-12)
    own = T[:3, :3].T @ contacts.covariance[0, :3, :3] @ T[:3, :3]
    np.testing.assert_allclose(own, np.diag([0.004**2 / 12, 0.004**2 / 12, ARRAY.sigma_point**2]), atol=1e-15)


def test_untouched_ones_are_points_above_the_skin():
    touch = ARRAY.touch(block())
    points = se3.apply(se3.inverse(T), touch.outside(T))
    assert len(points) == touch.untouched.sum() == 54 - 12
    np.testing.assert_allclose(points[:, 2], CLEARANCE, atol=1e-12)


def test_of_many_untouched_taxels_those_near_touched_ones_count_and_the_others_thinned_out():
    array = TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=40, columns=30, pitch=0.002, threshold=0.03
    )
    values = np.zeros((40, 30))
    values[10:13, 5:8] = 1.0
    points = array.touch(values).outside(np.eye(4))[:, :2]
    at, apart = array.points[:, :2], lambda a, b: np.linalg.norm(a[:, None] - b, axis=2)
    to_touched = apart(at, at[values.ravel() > 0]).min(axis=1)
    left_out = apart(at, points).min(axis=1) > 1e-9
    assert not left_out[(to_touched > 0) & (to_touched < 0.0045)].any()
    assert len(points) == ((to_touched > 0) & (to_touched < 0.0057)).sum() + MAX_FAR
    assert apart(at[to_touched > 0], points).min(axis=1).max() < 0.01  # on 78 x 58 mm
    few = TactileSurface.grid(
        frame="palm", T_frame_grid=np.eye(4), rows=6, columns=4, pitch=0.01, threshold=0.03
    )
    assert len(few.touch(np.zeros((6, 4))).outside(np.eye(4))) == 24


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


@given(arrays(np.float64, (6, 9), elements=st.floats(-1, 3, width=32) | st.just(np.nan)))
def test_no_taxel_is_both_pressed_and_untouched(reading):
    touch = ARRAY.touch(reading)
    assert not (touch.pressed & touch.untouched).any()
    assert not (touch.pressed | touch.untouched)[np.isnan(reading)].any()
    assert (reading[touch.pressed] >= 0.1).all()
    assert (reading[touch.untouched] < 0.1).all()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("rows", 0, "rows: expected a whole number from 1 to 4096, got 0"),
        ("columns", 2.5, "columns: expected a whole number from 1 to 4096, got 2.5"),
        ("rows", 1000, "rows: expected at most 4096 taxels, got 9000"),
        ("pitch", 4.0, r"pitch: expected metres from 0.0002 to 0.05, got 4"),
        ("threshold", 0.0, "threshold: expected a number above 0, got 0.0"),
        ("full_scale", 0.05, "full_scale: expected more than the threshold, got 0.05"),
        (
            "sigma_normal",
            5.0,
            r"sigma_normal: expected radians within 3.142, got 5 \(degrees\? 0.08727 rad\)",
        ),
    ],
)
def test_what_is_no_array_is_reported(field, value, message):
    with pytest.raises(InvalidInput, match=message):
        TactileSurface.grid(**FIELDS | {field: value})


@pytest.mark.parametrize("reading", [np.zeros((9, 6)), np.zeros(54), [[1, 2]], [[1, 2], [3]], "much", None])
def test_readings_of_another_shape_are_reported(reading):
    with pytest.raises(InvalidInput, match="reading: expected 6 rows of 9 numbers, got"):
        ARRAY.touch(reading)


def test_a_baseline_of_another_shape_is_reported():
    with pytest.raises(InvalidInput, match=r"baseline: expected a number or 6 rows of 9, got shape \(9,\)"):
        ARRAY.touch(block(), np.zeros(9))


def test_the_former_name_gives_the_same_surface_with_a_warning():
    with pytest.warns(DeprecationWarning, match=r"TactileSurface\.grid"):
        array = TaxelArray(**FIELDS)
    with pytest.warns(DeprecationWarning, match=r"layout\.rows"):
        assert array.rows == 6
    with pytest.warns(DeprecationWarning, match=r"SkinTouch\.surface"):
        assert ARRAY.touch(block()).array is ARRAY
    np.testing.assert_array_equal(array.points, ARRAY.points)
