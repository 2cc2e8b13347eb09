import numpy as np
import pytest

from handsight.errors import InvalidInput, InvalidObject
from handsight.objects import ObjectModel, ObjectWarning
from testbed.refusals import refused

SIZE = np.array([0.06, 0.09, 0.14])


@pytest.fixture(scope="module")
def box():
    return ObjectModel.box(SIZE)


@pytest.fixture(scope="module")
def cloud(box):
    return ObjectModel.from_points(*box.sample(3000))


def test_a_cloud_measures_distance_like_the_surface_it_was_drawn_from(box, cloud, rng):
    points = rng.uniform(-0.08, 0.08, (3000, 3))
    exact, found = box.evaluate(points), cloud.evaluate(points)
    error = np.abs(exact.distance - found.distance)
    assert np.median(error) < 3e-4
    assert error.max() < cloud.coarse.cell
    clear = np.abs(exact.distance) > 0.003
    assert ((exact.distance < 0) == (found.distance < 0))[clear].mean() > 0.999


def test_a_cloud_has_the_area_of_its_surface_and_is_closed(box, cloud):
    assert cloud.area == pytest.approx(box.area, rel=0.1)
    assert cloud.closed
    assert cloud.diameter == pytest.approx(box.diameter, rel=0.03)


@pytest.mark.parametrize(
    "shape", [ObjectModel.sphere(0.04), ObjectModel.cylinder(0.03, 0.1)], ids=["ball", "can"]
)
def test_missing_normals_are_estimated_and_point_outwards(shape, rng):
    points, normals = shape.sample(3000)
    model = ObjectModel.from_points(points)
    drawn, found = model.sample(2000)
    truth = shape.evaluate(drawn).gradient
    along = (found * truth).sum(axis=1)
    assert (along > 0).mean() > 0.995
    assert (along > np.cos(np.deg2rad(10))).mean() > 0.85
    assert model.evaluate([[0.0, 0, 0]]).distance < -0.02


def test_repeated_points_are_one(box, cloud):
    points, normals = box.sample(3000)
    with pytest.warns(ObjectWarning):
        again = ObjectModel.from_points(np.vstack([points, points]), np.vstack([normals, normals]))
    np.testing.assert_allclose(again.fine.values, cloud.fine.values, atol=1e-7)


def test_a_cloud_with_a_large_gap_has_no_inside(box):
    points, normals = box.sample(4000)
    lower = points[:, 2] < 0.03
    model = ObjectModel.from_points(points[lower], normals[lower])
    assert not model.closed
    front, behind = model.evaluate([[0.034, 0, -0.03], [0.026, 0, -0.03]]).distance
    assert front == pytest.approx(0.004, abs=5e-4)
    assert behind == pytest.approx(-0.004, abs=5e-4)


def test_a_gap_of_a_few_spacings_leaves_it_closed(box):
    points, normals = box.sample(4000)
    kept = np.linalg.norm(points - [0.03, 0, 0], axis=1) > 0.012
    assert ObjectModel.from_points(points[kept], normals[kept]).closed


def test_samples_are_points_of_the_cloud(box):
    points, normals = box.sample(300)
    model = ObjectModel.from_points(points, normals)
    drawn, directions = model.sample(1000)
    assert {tuple(p) for p in drawn} <= {tuple(p) for p in points}
    assert {tuple(p) for p in model.points_object} <= {tuple(p) for p in points}
    assert len({tuple(p) for p in drawn}) > 0.9 * len(points)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)


def test_sparse_parts_are_sampled_by_their_area_not_their_points(box, rng):
    points, normals = box.sample(6000)
    kept = (points[:, 2] < 0) | (rng.random(6000) < 0.2)
    drawn, _ = ObjectModel.from_points(points[kept], normals[kept]).sample(20_000)
    assert (drawn[:, 2] > 0).mean() == pytest.approx(0.5, abs=0.05)


line = np.linspace(0, 1, 30)[:, None] * [0.1, 0.05, 0.02]


@pytest.mark.parametrize(
    ("points", "normals", "error", "field"),
    [
        (np.zeros((0, 3)), None, InvalidObject, "points"),
        (line[:19], None, InvalidObject, "points"),
        (np.repeat(line[:10], 3, axis=0), None, InvalidObject, "points"),
        (np.full((30, 3), 0.2), None, InvalidObject, "points"),
        (line, None, InvalidObject, "points"),
        (np.full((30, 3), np.nan), None, InvalidInput, "points"),
        (np.zeros((30, 2)), None, InvalidInput, "points"),
        (line, np.zeros((30, 3)), InvalidInput, "normals"),
        (line, np.ones((29, 3)), InvalidInput, "normals"),
    ],
)
def test_arrays_that_are_no_cloud_are_refused(points, normals, error, field):
    with refused(error, field):
        ObjectModel.from_points(points, normals)
