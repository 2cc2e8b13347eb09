"""The kernels that build objects, and evaluate their fields, against brute force and definitions (`oracles`)."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from handsight.objects import ObjectModel
from handsight.objects.meshes.box_tree import ClosestPointSearch, Winding
from objects.object_shapes import box_mesh, divided, prism, triangles
from oracles import fields as field_oracle
from oracles import meshes as oracle

TINY = 1e-12
# Weights in a sliver are a quotient of numbers that nearly cancel.
CLOSE = {"needle": 1e-10, "flat": 1e-10}


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def bumpy(n=24, size=0.05):
    """A closed ball with dents: rings of vertices, slivers at its poles."""
    rows, around = np.meshgrid(np.arange(1, n), np.arange(n), indexing="ij")
    polar, turn = np.pi * rows / n, 2 * np.pi * around / n
    u = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
    u = np.vstack([u.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    length = 1 + 0.2 * np.sin(3 * u[:, 0] + 1) * np.cos(2 * u[:, 1]) + 0.15 * np.sin(4 * u[:, 2])
    here = np.arange(n)
    there, below, last = (here + 1) % n, n * np.arange(n - 2)[:, None], n * (n - 2)
    quads = [
        (below + here, below + n + here, below + n + there),
        (below + here, below + n + there, below + there),
    ]
    faces = [np.stack(q, axis=-1).reshape(-1, 3) for q in quads]
    faces.append(np.column_stack([np.full(n, n * (n - 1)), here, there]))
    faces.append(np.column_stack([np.full(n, n * (n - 1) + 1), last + there, last + here]))
    return size * length[:, None] * u, np.vstack(faces)


def flat_ones():
    """Triangles that are lines and points, among two that are not."""
    vertices = 0.05 * np.array(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (0, 1, 1), (1, 1e-9, 0), (-1, -1, 1.0)]
    )
    return vertices, np.array(
        [(0, 1, 2), (1, 0, 2), (3, 3, 3), (3, 4, 4), (6, 6, 4), (0, 3, 4), (0, 1, 5), (6, 6, 2), (1, 3, 6)]
    )


SHAPES = {
    "box": box_mesh(),
    "prism": divided(*prism(7), 2),
    "bumpy": bumpy(),
    "needle": (prism(5)[0] * [1, 1e-3, 1], prism(5)[1]),
    "flat": flat_ones(),
    "one": (0.1 * np.eye(3), np.array([(0, 1, 2)])),
    "only a line": (np.array([(0, 0, 0), (0.1, 0, 0), (0.05, 0, 0)]), np.array([(0, 1, 2)])),
}


def shape(name):
    return triangles(*SHAPES[name])


def around(mesh, rng):
    """Points near by, far away, on faces, on edges and at corners."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    near = rng.uniform(low - 0.03, high + 0.03, (300, 3))
    weights = rng.dirichlet(np.ones(3), 200)
    weights[:60, 0] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=200)]]
    on = (weights[:, None] @ corners)[:, 0]
    return np.vstack([near, on, mesh.vertices[:50], rng.normal(size=(50, 3)), 1e3 * rng.normal(size=(20, 3))])


@pytest.mark.parametrize("name", SHAPES)
def test_closest_points_are_those_of_trying_every_triangle(name, rng):
    mesh = shape(name)
    points = around(mesh, rng)
    found, index = ClosestPointSearch(mesh).closest(points)
    np.testing.assert_array_equal(index, np.arange(len(points)))
    expected = oracle.closest_points(points, mesh.corners)[0]
    scale = 1 + np.linalg.norm(points, axis=1)
    assert (np.abs(found.distance - expected) <= CLOSE.get(name, TINY) * scale).all()
    assert (np.abs(np.linalg.norm(points - found.points, axis=1) - found.distance) <= TINY * scale).all()
    # Which of several equally near triangles it is, either may say; the point is where its weights put it.
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=TINY)
    assert found.weights.min() >= 0
    on_face = (found.weights[:, None] @ mesh.corners[found.face])[:, 0]
    np.testing.assert_allclose(on_face, found.points, atol=TINY)
    # Those nearer than a limit are the same ones, and all of them.
    near, index = ClosestPointSearch(mesh).closest(points, within=0.01)
    np.testing.assert_array_equal(index, np.flatnonzero(expected < 0.01))
    np.testing.assert_allclose(near.distance, found.distance[index], rtol=0, atol=CLOSE.get(name, TINY))


@pytest.mark.parametrize("name", ["box", "bumpy"])
def test_closest_points_on_edges_and_at_corners_have_weights_of_exactly_zero(name, rng):
    mesh = shape(name)
    points = around(mesh, rng)[:300]
    found, _ = ClosestPointSearch(mesh).closest(points)
    _, _, face, weights = oracle.closest_points(points, mesh.corners)
    same = found.face == face
    assert same.mean() > 0.4  # a convex edge belongs to two
    np.testing.assert_array_equal((found.weights == 0)[same], (weights == 0)[same])
    np.testing.assert_allclose(found.weights[same], weights[same], atol=1e-9)


@pytest.mark.parametrize("name", ["box", "prism", "bumpy", "needle", "one"])
def test_winding_numbers_of_meshes_are_sums_of_solid_angles(name, rng):
    mesh = shape(name)
    winding = Winding.of_mesh(mesh)
    points = around(mesh, rng)
    # On the surface itself rounding decides between the sides.
    points = points[oracle.closest_points(points, mesh.corners)[0] > 1e-6]
    expected = oracle.winding(points, winding.patches, winding.elements)
    np.testing.assert_allclose(winding.at(points), expected, rtol=0, atol=1e-9)


def test_several_threads_at_once_are_answered_as_one_is(rng):
    mesh = triangles(*divided(*bumpy(), 1))
    search, winding = ClosestPointSearch(mesh), Winding.of_mesh(mesh)
    sets = [rng.uniform(-0.08, 0.08, (5000, 3)) for _ in range(4)]
    model = ObjectModel.from_mesh(mesh.vertices, mesh.faces)
    gate = threading.Barrier(4)

    def answers(points, wait=True):
        if wait:
            gate.wait(timeout=60)
        return search.closest(points)[0].distance, winding.at(points), *model.evaluate(points)

    alone = [answers(points, wait=False) for points in sets]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(answers, sets))
    for one, other in zip(alone, together, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


def test_fields_are_evaluated_by_their_definitions(rng):
    mesh = ObjectModel.from_mesh(*bumpy())
    vertices, faces = bumpy()
    sheet = ObjectModel.from_mesh(vertices, faces[vertices[faces].mean(axis=1)[:, 2] > 0])
    cloud = ObjectModel.from_points(*sheet.sample(1500))
    assert sheet.fine.sheet
    assert cloud.fine.blur > 0
    points = np.vstack([rng.uniform(-0.1, 0.1, (3000, 3)), rng.normal(size=(100, 3))])
    for model in (
        mesh,
        sheet,
        cloud,
        ObjectModel.box((0.06, 0.09, 0.14)),
        ObjectModel.cylinder(0.03, 0.1),
        ObjectModel.sphere(0.04),
    ):
        for fine, field in ((True, model.fine), (False, model.coarse)):
            for found, expected in zip(
                model.evaluate(points, fine=fine), field_oracle.evaluate(field, points), strict=True
            ):
                assert found.dtype == np.float64
                assert found.shape == expected.shape
                np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert [v.shape for v in mesh.evaluate(np.empty((0, 3)))] == [(0,), (0, 3), (0, 3, 3)]
