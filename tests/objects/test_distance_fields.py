import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from handsight.objects import ExactField, GridField
from objects.object_shapes import box_mesh, triangles
from oracles import fields, meshes

HALF = np.array([0.03, 0.045, 0.07])
CELL = 0.005


def gridded(distance, half_width=0.1):
    n = round(2 * half_width / CELL) + 1
    axis = np.linspace(-half_width, half_width, n)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    values = distance(nodes).reshape(n, n, n).astype(np.float32)
    return GridField(np.full(3, -half_width), CELL, values)


BOX = ExactField("box", HALF)
CYLINDER = ExactField("cylinder", np.array([0.033, 0.0575, 0]))
SPHERE = ExactField("sphere", np.array([0.04, 0, 0]))
EXACT = [BOX, CYLINDER, SPHERE]
FIELDS = [*EXACT, *(gridded(lambda p, f=field: fields.evaluate(f, p).distance) for field in EXACT)]
names = [f"{kind} {shape}" for kind in ("exact", "grid of") for shape in ("box", "cylinder", "sphere")]


def points_away_from_kinks(field, rng, n=400):
    """Where the field is smooth: off the medial axis, and farther from edges than curvature is held."""
    points = rng.uniform(-0.085, 0.085, (n, 3))
    if isinstance(field, GridField):
        return points
    around = np.stack([field.evaluate(points + 2e-5 * d).gradient for d in rng.normal(size=(12, 3))])
    change = np.ptp(around, axis=0).max(axis=1)
    inner = np.linalg.norm(points[:, :2], axis=1) > 0.005
    return points[(change < 0.05) & inner & (np.abs(field.evaluate(points).distance) > 0.004)]


@pytest.mark.parametrize("field", FIELDS, ids=names)
def test_the_gradient_is_the_derivative_of_the_distance(field, rng):
    points, e = points_away_from_kinks(field, rng), 1e-6
    assert len(points) > 100
    numeric = [(field.evaluate(points + e * d).distance - field.evaluate(points - e * d).distance) / (2 * e)
               for d in np.eye(3)]  # fmt: skip
    np.testing.assert_allclose(field.evaluate(points).gradient, np.stack(numeric, axis=1), atol=2e-6)


@pytest.mark.parametrize("field", FIELDS, ids=names)
def test_the_hessian_is_the_derivative_of_the_gradient(field, rng):
    points, e = points_away_from_kinks(field, rng), 1e-6
    numeric = [(field.evaluate(points + e * d).gradient - field.evaluate(points - e * d).gradient) / (2 * e)
               for d in np.eye(3)]  # fmt: skip
    hessian = field.evaluate(points).hessian
    np.testing.assert_allclose(hessian, np.stack(numeric, axis=2), atol=1e-4)
    np.testing.assert_allclose(hessian, hessian.swapaxes(1, 2), atol=1e-9)


def test_the_exact_box_is_as_far_as_its_triangles_say(rng):
    points = rng.uniform(-0.12, 0.12, (2000, 3))
    distance = BOX.evaluate(points).distance
    brute = meshes.closest_points(points, triangles(*box_mesh(2 * HALF)).corners)[0]
    np.testing.assert_allclose(np.abs(distance), brute, atol=1e-12)
    np.testing.assert_array_equal(distance < 0, (np.abs(points) < HALF).all(axis=1))


def test_the_exact_cylinder_is_as_far_as_its_densely_sampled_surface(rng):
    angle, part = rng.uniform(0, 2 * np.pi, 200_000), rng.uniform(-1, 1, 200_000)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wall = np.column_stack([0.033 * ring, 0.0575 * part])
    cap = np.column_stack([0.033 * np.sqrt(np.abs(part))[:, None] * ring, 0.0575 * np.sign(part)])
    points = rng.uniform(-0.09, 0.09, (500, 3))
    brute = cKDTree(np.vstack([wall, cap])).query(points)[0]
    values = CYLINDER.evaluate(points)
    np.testing.assert_allclose(np.abs(values.distance), brute, atol=3e-4)
    inside = (np.linalg.norm(points[:, :2], axis=1) < 0.033) & (np.abs(points[:, 2]) < 0.0575)
    np.testing.assert_array_equal(values.distance < 0, inside)


@pytest.mark.parametrize("field", EXACT, ids=names[:3])
def test_gradients_are_unit_and_point_from_the_surface(field, rng):
    points = rng.uniform(-0.12, 0.12, (1000, 3))
    distance, gradient, _ = field.evaluate(points)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1.0, atol=1e-12)
    foot = points - distance[:, None] * gradient
    np.testing.assert_allclose(field.evaluate(foot).distance, 0.0, atol=1e-12)


@pytest.mark.parametrize("field", EXACT, ids=names[:3])
@given(
    st.tuples(
        *[st.sampled_from([0.0, -0.0, 1e-170, -1e-12, 0.03, -0.033, 0.0575, 0.07, 0.04, 1.0, 50.0])] * 3
    )
)
def test_no_point_is_answered_with_nan_or_unbounded_curvature(field, point):
    distance, gradient, hessian = field.evaluate(np.array([point]))
    assert np.isfinite(distance).all()
    np.testing.assert_allclose(np.linalg.norm(gradient), 1.0, atol=1e-9)
    assert np.abs(hessian).max() <= 1 / fields.least_radius(field) * (1 + 1e-9)


def test_a_grid_reproduces_a_plane_exactly(rng):
    points = rng.uniform(-0.09, 0.09, (200, 3))
    distance, gradient, hessian = gridded(lambda p: p @ [0.6, 0.0, 0.8] - 0.01).evaluate(points)
    np.testing.assert_allclose(distance, points @ [0.6, 0.0, 0.8] - 0.01, atol=2e-8)
    np.testing.assert_allclose(gradient, np.broadcast_to([0.6, 0.0, 0.8], gradient.shape), atol=2e-5)
    np.testing.assert_allclose(hessian, 0.0, atol=5e-3)


@pytest.mark.parametrize("field", FIELDS[3:], ids=names[3:])
def test_outside_its_grid_a_field_goes_on_without_a_jump_and_without_blowing_up(field, rng):
    toward = rng.normal(size=(200, 3))
    toward /= np.abs(toward).max(axis=1, keepdims=True)
    edge = 0.095 * toward
    before, after = field.evaluate(edge * (1 - 1e-7)), field.evaluate(edge * (1 + 1e-7))
    np.testing.assert_allclose(before.distance, after.distance, atol=1e-6)
    for far in (1.2, 3.0, 10.0):
        distance, gradient, hessian = field.evaluate(far * edge)
        assert (distance > before.distance).all()
        assert (np.linalg.norm(gradient, axis=1) < 1.1).all()
        assert np.isfinite(hessian).all()
