import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from handsight.errors import InvalidInput
from handsight.objects import ObjectModel, ObjectWarning, Symmetries, diameter
from objects.object_shapes import box_mesh, divided
from testbed.refusals import refused

SIZE = np.array([0.06, 0.09, 0.14])


@pytest.fixture(scope="module")
def models():
    box = ObjectModel.from_mesh(*divided(*box_mesh(SIZE), 2))
    return {
        "box": ObjectModel.box(SIZE),
        "cylinder": ObjectModel.cylinder(0.033, 0.115),
        "sphere": ObjectModel.sphere(0.04),
        "mesh": box,
        "cloud": ObjectModel.from_points(*box.sample(2000)),
    }


KINDS = ["box", "cylinder", "sphere", "mesh", "cloud"]


@pytest.mark.parametrize(
    ("kind", "diameter", "area", "extent"),
    [
        ("box", np.linalg.norm(SIZE), 2 * (0.06 * 0.09 + 0.06 * 0.14 + 0.09 * 0.14), SIZE),
        ("mesh", np.linalg.norm(SIZE), 2 * (0.06 * 0.09 + 0.06 * 0.14 + 0.09 * 0.14), SIZE),
        ("cylinder", np.hypot(0.066, 0.115), 2 * np.pi * 0.033 * (0.033 + 0.115), [0.066, 0.066, 0.115]),
        ("sphere", 0.08, 4 * np.pi * 0.04**2, [0.08, 0.08, 0.08]),
    ],
)
def test_sizes_are_those_of_the_shape(models, kind, diameter, area, extent):
    model = models[kind]
    assert model.diameter == pytest.approx(diameter, rel=1e-9)
    assert model.radius == pytest.approx(diameter / 2, rel=1e-9)
    assert model.area == pytest.approx(area, rel=1e-9)
    assert model.sample_spacing == pytest.approx(np.sqrt(area / 256), rel=1e-9)
    np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), extent, rtol=1e-9)
    np.testing.assert_allclose(model.center_object, 0, atol=1e-12)
    assert model.closed


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 1e-9), (1, 1e-9, 1e-9), (3, 2, 1)])
def test_the_diameter_is_the_largest_of_all_distances(shape, rng):
    cloud = rng.normal(size=(1500, 3))
    ball = cloud / np.linalg.norm(cloud, axis=1, keepdims=True)
    for points in (cloud, ball, cloud[:2], rng.normal(size=(3000, 3))):
        assert diameter(points * shape) == pytest.approx(pdist(points * shape).max(), rel=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_samples_lie_on_the_surface_with_its_normals(models, kind):
    model = models[kind]
    for points, normals in ((model.points_object, model.normals_object), model.sample(500)):
        values = model.evaluate(points)
        edge = models["mesh"].fine.cell if kind in ("mesh", "cloud") else 1e-12
        assert np.abs(values.distance).max() < edge
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
        along = (values.gradient * normals).sum(axis=1)
        assert (along > 0.95).mean() > 0.85  # the others lie at edges


@pytest.mark.parametrize("kind", KINDS)
def test_there_are_256_samples_spread_evenly(models, kind):
    model = models[kind]
    assert model.points_object.shape == model.normals_object.shape == (256, 3)
    gap = cKDTree(model.points_object).query(model.points_object, k=2)[0][:, 1]
    assert gap.mean() > 0.6 * model.sample_spacing  # half for points thrown at random
    reach = cKDTree(model.points_object).query(model.sample(5000, seed=9)[0])[0]
    assert reach.max() < 1.5 * model.sample_spacing


def test_samples_fall_on_each_face_by_its_area(models):
    areas = np.array([0.09 * 0.14, 0.06 * 0.14, 0.06 * 0.09])
    for kind in ("box", "mesh"):
        for points, normals in (
            models[kind].sample(20_000, seed=3),
            (models[kind].points_object, models[kind].normals_object),
        ):
            share = np.array([(np.abs(normals[:, k]) > 0.9).mean() for k in range(3)])
            np.testing.assert_allclose(share, areas / areas.sum(), atol=0.02)
            # Within a face too: a quarter of it holds a quarter of the points.
            face = points[normals[:, 0] > 0.9]
            quarter = ((face[:, 1] > 0) & (face[:, 2] > 0)).mean()
            assert quarter == pytest.approx(0.25, abs=0.03 if len(face) > 1000 else 0.06)


def test_the_same_seed_draws_the_same_samples(models):
    model = models["mesh"]
    np.testing.assert_array_equal(model.sample(100, seed=4)[0], model.sample(100, seed=4)[0])
    assert not np.array_equal(model.sample(100, seed=4)[0], model.sample(100, seed=5)[0])
    again = ObjectModel.from_mesh(model.vertices, model.faces)
    np.testing.assert_array_equal(again.points_object, model.points_object)


def test_a_mesh_of_a_box_agrees_with_the_exact_box(models, rng):
    points = rng.uniform(-0.08, 0.08, (3000, 3))
    exact, grid = models["box"].evaluate(points), models["mesh"].evaluate(points)
    error = np.abs(exact.distance - grid.distance)
    assert np.percentile(error, 50) < 1e-4
    assert error.max() < 0.6 * models["mesh"].coarse.cell
    near = np.abs(exact.distance) < 2 * models["mesh"].fine.cell
    assert error[near].max() < 0.7 * models["mesh"].fine.cell


def test_the_field_of_a_noisy_cloud_is_better_than_its_points(models, rng):
    points, normals = models["box"].sample(4000)
    noisy = ObjectModel.from_points(points + 5e-4 * rng.normal(size=(len(points), 1)) * normals, normals)
    assert 5e-5 < noisy.sigma_point < 2.5e-4


def test_a_cloud_has_no_faces_and_its_points_for_vertices(models):
    assert models["cloud"].faces.shape == (0, 3)
    assert len(models["cloud"].vertices) == 2000
    assert models["mesh"].faces.shape == (192, 3)


def test_a_model_cannot_be_changed(models):
    with pytest.raises(dataclasses.FrozenInstanceError):
        models["box"].diameter = 1.0
    with pytest.raises(ValueError):
        models["box"].points_object[0] = 0


def test_declared_symmetries_replace_those_of_the_shape():
    none = Symmetries()
    model = ObjectModel.cylinder(0.03, 0.1)
    assert model.with_symmetries(none).symmetries is none
    assert len(model.symmetries.axes) == 1
    with refused(InvalidInput, "symmetries"):
        ObjectModel.box(SIZE).with_symmetries("all")
    with refused(InvalidInput, "symmetries"):
        model.with_symmetries(None)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: ObjectModel.box((0.1, 0.1)), "size"),
        (lambda: ObjectModel.box((0.1, 0, 0.1)), "size"),
        (lambda: ObjectModel.box((0.1, np.nan, 0.1)), "size"),
        (lambda: ObjectModel.box((0.1, 1e200, 0.1)), "size"),
        (lambda: ObjectModel.cylinder(-1, 0.1), "radius"),
        (lambda: ObjectModel.cylinder(0.1, np.inf), "height"),
        (lambda: ObjectModel.cylinder(0.1, "tall"), "height"),
        (lambda: ObjectModel.sphere(0), "radius"),
        (lambda: ObjectModel.sphere(1e-200), "radius"),
        (lambda: ObjectModel.box(SIZE).sample(0), "n"),
        (lambda: ObjectModel.box(SIZE).sample(2.5), "n"),
        (lambda: ObjectModel.box(SIZE).evaluate([[0, 0]]), "points_object"),
    ],
)
def test_a_wrong_size_is_named(make, field):
    with refused(InvalidInput, field):
        make()


@pytest.mark.parametrize(
    ("extent", "message"),
    [
        (140.0, r"largest extent 140 m: looks like millimetres; try scale=0.001"),
        (14.0, r"largest extent 14 m: looks like millimetres; try scale=0.001"),
        (3.0, r"largest extent 3 m: looks like centimetres; try scale=0.01"),
        (1.4e-4, r"largest extent 0.00014 m: looks like metres, stated to be millimetres; try scale=1000"),
        (3e-6, r"largest extent 3e-06 m: not the size of an object in a hand"),
    ],
)
def test_a_likely_wrong_unit_warns_with_the_likely_factor(extent, message):
    with pytest.warns(ObjectWarning):
        model = ObjectModel.box((extent, extent / 2, extent / 2))
    assert any(remark.startswith("largest extent") for remark in model.remarks)
