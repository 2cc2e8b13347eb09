"""The error of a field is large at the edges, which a grid rounds off, and small on the faces."""

import numpy as np
import pytest
import trimesh

import handsight as hs
from oracles import fields


@pytest.fixture(scope="module")
def box_mesh():
    mesh = trimesh.creation.box((0.06, 0.09, 0.14))
    return hs.ObjectModel.from_mesh(mesh.vertices, mesh.faces)


def measured(model, points, normals):
    """Squared distance and squared normal angle per axis of the fine field, averaged over the points."""
    distance, gradient, _ = model.fine.evaluate(points)
    sine = np.linalg.norm(np.cross(gradient, normals), axis=1)
    angle = np.arctan2(sine, (gradient * normals).sum(axis=1))
    return np.array([(distance**2).mean(), (angle**2).mean() / 2])


def on_top(model, low, high, count=400):
    """Points on the +z face, between two shares of the way from its middle to its edge along x."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(low, high, count) * 0.03, rng.uniform(-0.5, 0.5, count) * 0.045
    return np.column_stack([x, y, np.full(count, 0.07)]), np.tile([0, 0, 1.0], (count, 1))


def test_the_field_error_is_small_on_a_face_and_large_at_an_edge(box_mesh):
    face, _ = on_top(box_mesh, -0.3, 0.3)
    edge, _ = on_top(box_mesh, 0.97, 1.0)
    on_face, at_edge = (fields.variances(box_mesh.field_error, p)[:, :2].mean(axis=0) for p in (face, edge))
    assert np.sqrt(on_face[0]) < 2e-5
    assert np.sqrt(on_face[1]) < np.deg2rad(0.5)
    assert np.sqrt(at_edge[1]) > np.deg2rad(5)


@pytest.mark.parametrize(("low", "high"), [(0.9, 1.0), (0.97, 1.0)])
def test_the_field_error_at_an_edge_is_the_fields_real_error_within_a_factor_of_four(box_mesh, low, high):
    points, normals = on_top(box_mesh, low, high)
    expected = np.sqrt(fields.variances(box_mesh.field_error, points)[:, :2].mean(axis=0))
    found = np.sqrt(measured(box_mesh, points, normals))
    # It is averaged over half a cell around, so that only its order of magnitude can be right.
    assert (expected < 4 * found + [2e-5, 0.01]).all()
    assert (found < 4 * expected + [2e-5, 0.01]).all()


def test_exact_objects_have_no_field_error():
    assert hs.ObjectModel.box((0.06, 0.09, 0.14)).field_error is None
