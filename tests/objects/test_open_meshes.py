"""The distance to an open mesh is zero on its surface only; a mesh that is closed except for slits has an inside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.objects import ObjectModel, Triangles
from objects.object_shapes import box_mesh, divided, prism
from oracles import meshes as oracle

CELLS = 1.0
"""The largest error of a field [cells]: its spline is a mean over a kernel of variance cell²/3 per axis, which reaches
about one cell, and a distance changes by no more than its place does."""
SOLIDS = {
    "box": box_mesh(),
    "divided box": divided(*box_mesh((0.06, 0.05, 0.04)), 2),
    "prism": divided(*prism(7), 1),
    "can": prism(48, 0.03, 0.08),
}


def turned(vertices, rng):
    return vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + rng.uniform(-0.05, 0.05, 3)


def cut(vertices, faces, rng):
    """One side of a plane through the middle third of the solid."""
    normal = rng.normal(size=3)
    height = vertices[faces].mean(axis=1) @ normal
    return vertices, faces[height > np.quantile(height, rng.uniform(0.3, 0.7))]


def pieces(vertices, faces, rng):
    """Some of the triangles, wherever they are."""
    return vertices, faces[rng.permutation(len(faces))[: max(1, len(faces) // 4)]]


def sheets(vertices, faces, rng):
    """Two or three flat patches, any way round."""
    flat = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * rng.uniform(0.02, 0.04, (1, 3))
    patches = [turned(flat, rng) for _ in range(rng.integers(2, 4))]
    squares = [np.array([(0, 1, 2), (0, 2, 3)]) + 4 * k for k in range(len(patches))]
    return np.vstack(patches), np.vstack(squares)


OPENINGS = {"cut": cut, "pieces": pieces, "sheets": sheets}


def with_vertices_on_edges(vertices, faces, rng, off=0.0):
    """Triangles halved at vertices that their neighbours do not have."""
    vertices, halves = list(vertices), []
    for face in faces:
        a, b, c = np.roll(face, rng.integers(3))
        if rng.random() < 0.4:
            share = rng.uniform(0.2, 0.8)
            halves += [(a, len(vertices), c), (len(vertices), b, c)]
            vertices.append((1 - share) * vertices[a] + share * vertices[b] + off * rng.normal(size=3))
        else:
            halves.append((a, b, c))
    return np.array(vertices), np.array(halves)


def with_its_own_vertices(vertices, faces, rng, off=0.0):
    """Each triangle with three vertices of its own, as in STL, moved by about `off` [m]."""
    corners = vertices[faces] + off * rng.normal(size=(len(faces), 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def with_triangles_of_no_area(vertices, faces, rng):
    vertices, faces = with_vertices_on_edges(vertices, faces, rng)
    few = faces[rng.integers(len(faces), size=4)]
    middles = vertices[few[:, :2]].mean(axis=1)
    on_edges = np.column_stack([few[:, 0], len(vertices) + np.arange(4), few[:, 1]])
    return np.vstack([vertices, middles]), np.vstack([faces, few[:, [0, 1, 1]], on_edges])


SLITS = {
    "vertices on edges": with_vertices_on_edges,
    "vertices on edges twice": lambda v, f, rng: with_vertices_on_edges(*with_vertices_on_edges(v, f, rng), rng),
    "vertices beside edges": lambda v, f, rng: with_vertices_on_edges(v, f, rng, 2e-6),
    "unshared": with_its_own_vertices,
    "rounded": lambda v, f, rng: with_its_own_vertices((v + 0.7).astype(np.float32) - 0.7, f, rng, 1e-7),
    "six digits": lambda v, f, rng: (lambda c, g: (c.round(6), g))(*with_its_own_vertices(v, f, rng, 4e-7)),
    "no area": with_triangles_of_no_area,
    "all of it": lambda v, f, rng: with_its_own_vertices(*with_vertices_on_edges(v, f, rng, 1e-6), rng, 1e-6),
}  # fmt: skip


def around(model, rng, count=1500):
    """Points in a box around the object, and near its surface."""
    near, _ = model.sample(count, seed=1)
    low, high = model.bounds_object
    wide = rng.uniform(low - 0.03, high + 0.03, (count, 3))
    return np.vstack([near, near + 0.006 * rng.normal(size=near.shape), wide])


@pytest.mark.filterwarnings("ignore::handsight.objects.ObjectWarning")
@settings(max_examples=12, deadline=None)
@given(st.sampled_from(sorted(SOLIDS)), st.sampled_from(sorted(OPENINGS)), st.integers(0, 10**6))
def test_the_distance_to_an_open_mesh_is_that_to_its_triangles_and_zero_on_them_only(solid, opening, seed):
    rng = np.random.default_rng(seed)
    vertices, faces = OPENINGS[opening](*SOLIDS[solid], rng)
    vertices = turned(vertices, rng)
    model = ObjectModel.from_mesh(vertices, faces)
    points = around(model, rng)
    expected = oracle.closest_points(points, vertices[faces])[0]
    for fine, field in ((True, model.fine), (False, model.coarse)):
        distance = model.evaluate(points, fine=fine).distance
        band = expected < 4 * field.cell
        assert (np.abs(np.abs(distance) - expected)[band] < CELLS * field.cell).all()
        assert (np.abs(distance)[~band] > field.cell).all()


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(sorted(SOLIDS)), st.sampled_from(sorted(SLITS)), st.integers(0, 10**6))
@pytest.mark.filterwarnings("ignore::handsight.objects.ObjectWarning")
def test_a_mesh_whose_gaps_have_no_area_is_closed_and_has_the_signs_of_the_mesh_without_gaps(
    solid, slit, seed
):
    rng = np.random.default_rng(seed)
    vertices, faces = SOLIDS[solid]
    model = ObjectModel.from_mesh(*SLITS[slit](vertices, faces, rng))
    whole = ObjectModel.from_mesh(vertices, faces)
    assert model.closed
    assert not model.fine.sheet
    points = around(whole, rng)
    expected, found = whole.evaluate(points).distance, model.evaluate(points).distance
    # Where the exact band ends depends on how the surface is cut into triangles.
    near = np.abs(expected) < 2 * whole.fine.cell
    np.testing.assert_allclose(found[near], expected[near], atol=2e-5)
    np.testing.assert_allclose(found, expected, atol=0.1 * whole.coarse.cell)
    clear = np.abs(expected) > 1e-4
    np.testing.assert_array_equal((found < 0)[clear], (expected < 0)[clear])


def test_the_distance_behind_an_open_wall_is_that_to_the_wall():
    """A field that is continuous around the rim is 3 mm at 33 mm behind a wall 36 mm wide."""
    vertices = np.array([(-0.018, -0.05, 0), (0.018, -0.05, 0), (0.018, 0.05, 0), (-0.018, 0.05, 0)])
    model = ObjectModel.from_mesh(vertices, [(0, 1, 2), (0, 2, 3)])
    behind = np.column_stack([np.zeros(50), np.zeros(50), -np.linspace(0, 0.1, 50)])
    np.testing.assert_allclose(model.evaluate(behind).distance, behind[:, 2], atol=0.02 * model.coarse.cell)


@pytest.mark.parametrize("side", [1, -1])
def test_near_its_sheet_an_open_mesh_has_the_field_of_the_closed_one(side, rng):
    """Distance, normal and curvature of a can without lids, three cells from its rims."""
    vertices, faces = prism(96, 0.03, 0.08)
    k = len(vertices) // 2
    lid = (faces >= k).all(axis=1) | (faces < k).all(axis=1)
    tube, can = ObjectModel.from_mesh(vertices, faces[~lid]), ObjectModel.from_mesh(vertices, faces)
    assert not tube.closed
    turn, height = rng.uniform(0, 2 * np.pi, 500), rng.uniform(-0.03, 0.03, 500)
    radius = 0.03 + side * rng.uniform(0, 0.0025, 500)
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    for open_one, whole in zip(tube.evaluate(points), can.evaluate(points), strict=True):
        scale = 1 + np.abs(whole).max()
        np.testing.assert_allclose(open_one / scale, whole / scale, atol=0.03)


def test_a_closed_and_an_open_shell_together_are_open_and_keep_both_surfaces(rng):
    vertices, faces = box_mesh((0.03, 0.03, 0.03))
    flat = np.array([(-0.03, -0.03, 0.05), (0.03, -0.03, 0.05), (0.03, 0.03, 0.05), (-0.03, 0.03, 0.05)])
    both = Triangles(np.vstack([vertices, flat]), np.vstack([faces, [(8, 9, 10), (8, 10, 11)]]))
    model = ObjectModel.from_mesh(both.vertices, both.faces)
    assert not model.closed
    points = around(model, rng)
    expected = oracle.closest_points(points, both.corners)[0]
    off = np.abs(np.abs(model.evaluate(points).distance) - expected)
    assert (off[expected < 4 * model.fine.cell] < CELLS * model.fine.cell).all()
    assert model.evaluate([[0.0, 0, 0]]).distance < -0.01
