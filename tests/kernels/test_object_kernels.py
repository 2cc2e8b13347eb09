"""The kernels that build objects, and look them up, against their twins in plain NumPy (`handsight.objects._plain`)."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from handsight._kernels import warm
from handsight._kernels.linking import linked
from handsight._kernels.nearest_triangle import all_feet
from handsight._kernels.spreading import snapped, spread_out
from handsight._kernels.winding import winding_at
from handsight.objects import ObjectModel, _plain
from handsight.objects.meshes.box_tree import boxes, halves
from handsight.objects.meshes.closest_points import NearestPoint
from handsight.objects.meshes.winding import Winding
from objects.object_shapes import box_mesh, divided, prism, triangles

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
def test_feet_are_those_of_trying_every_triangle(name, rng):
    mesh = shape(name)
    points, corners = around(mesh, rng), mesh.vertices[mesh.faces]
    feet, index = NearestPoint(mesh).feet(points)
    np.testing.assert_array_equal(index, np.arange(len(points)))
    plain = _plain.feet(points, corners)[0]
    scale = 1 + np.linalg.norm(points, axis=1)
    assert (np.abs(feet.distance - plain) <= CLOSE.get(name, TINY) * scale).all()
    assert (np.abs(np.linalg.norm(points - feet.points, axis=1) - feet.distance) <= TINY * scale).all()
    # Which of several equally near triangles it is, either may say; the foot is where its weights put it.
    np.testing.assert_allclose(feet.corners.sum(axis=1), 1, atol=TINY)
    assert feet.corners.min() >= 0
    on_face = (feet.corners[:, None] @ corners[feet.face])[:, 0]
    np.testing.assert_allclose(on_face, feet.points, atol=TINY)


@pytest.mark.parametrize("name", ["box", "bumpy"])
def test_feet_on_edges_and_at_corners_have_weights_of_exactly_zero(name, rng):
    mesh = shape(name)
    points = around(mesh, rng)[:300]
    feet, _ = NearestPoint(mesh).feet(points)
    plain, weights = (_plain.feet(points, mesh.vertices[mesh.faces])[k] for k in (2, 3))
    same = feet.face == plain
    assert same.mean() > 0.4  # a convex edge belongs to two
    np.testing.assert_array_equal((feet.corners == 0)[same], (weights == 0)[same])
    np.testing.assert_allclose(feet.corners[same], weights[same], atol=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_feet_beyond_the_limit_are_left_out(name, rng):
    mesh, within = shape(name), 0.01
    points = around(mesh, rng)
    feet, index = NearestPoint(mesh).feet(points, within)
    plain = _plain.feet(points, mesh.vertices[mesh.faces])[0]
    np.testing.assert_array_equal(index, np.flatnonzero(plain < within))
    np.testing.assert_allclose(feet.distance, plain[index], rtol=0, atol=CLOSE.get(name, TINY))


def test_no_points_have_no_feet():
    feet, index = NearestPoint(shape("box")).feet(np.empty((0, 3)))
    assert len(index) == len(feet.distance) == 0


def test_a_tree_holds_every_thing_once_in_boxes_around_it(rng):
    centers = rng.normal(size=(1001, 3))
    parts = halves(centers, 16)
    np.testing.assert_array_equal(np.sort(parts.order), np.arange(1001))
    sizes = np.diff(parts.starts)
    assert 1 <= sizes.min() <= sizes.max() <= 16
    x = centers[parts.order]
    bounds = boxes(x, x, parts.starts)
    count = len(sizes)
    assert len(bounds) == 2 * count - 1
    for k in range(len(bounds)):
        first = last = k
        while first < count - 1:
            first, last = 2 * first + 1, 2 * last + 2
        own = x[parts.starts[first - count + 1] : parts.starts[last - count + 2]]
        np.testing.assert_array_equal(bounds[k], [*own.min(axis=0), *own.max(axis=0)])


def test_things_in_one_place_are_halved_too():
    parts = halves(np.zeros((100, 3)), 16)
    np.testing.assert_array_equal(np.sort(parts.order), np.arange(100))
    assert np.diff(parts.starts).max() <= 16


@pytest.mark.parametrize("name", ["box", "prism", "bumpy", "needle", "one"])
def test_winding_numbers_of_meshes_are_the_twins(name, rng):
    mesh = shape(name)
    winding = Winding.of_mesh(mesh)
    points = around(mesh, rng)
    # On the surface itself rounding decides between the sides.
    points = points[_plain.feet(points, mesh.vertices[mesh.faces])[0] > 1e-6]
    plain = _plain.winding(points, winding.patches, winding.elements)
    np.testing.assert_allclose(winding.at(points), plain, rtol=0, atol=1e-9)


def test_winding_numbers_of_a_large_mesh_are_the_twins(rng):
    """Where most patches are far."""
    winding = Winding.of_mesh(triangles(*divided(*bumpy(), 2)))
    points = rng.uniform(-0.08, 0.08, (500, 3))
    plain = _plain.winding(points, winding.patches, winding.elements)
    np.testing.assert_allclose(winding.at(points), plain, rtol=0, atol=1e-9)
    assert set(winding.at(points).round(1)) == {0.0, 1.0}


def test_winding_numbers_of_clouds_are_the_twins(rng):
    model = ObjectModel.cylinder(0.03, 0.1)
    points, normals = model.sample(3000)
    winding = Winding(points, normals * model.area / 3000)
    asked = np.vstack([rng.uniform(-0.08, 0.08, (400, 3)), points[:20], [[5.0, 0, 0]]])
    plain = _plain.winding(asked, winding.patches, winding.elements)
    np.testing.assert_allclose(winding.at(asked), plain, rtol=0, atol=1e-9)


def same_partition(a, b):
    """Two labellings name the same sets."""
    pairs = np.unique(np.stack([a, b]), axis=1).shape[1]
    return pairs == len(np.unique(a)) == len(np.unique(b))


@pytest.mark.parametrize("limit", [0.0, 0.8, 1.2, np.inf])
@pytest.mark.parametrize("grid", [(7, 8, 9), (1, 1, 40), (12, 1, 5), (1, 1, 1)])
@pytest.mark.parametrize("part", [1.0, 0.6])
def test_nodes_hang_together_as_the_twin_says(limit, grid, part, rng):
    count = int(np.prod(grid))
    index = np.flatnonzero(rng.random(count) < part)
    distance, free = rng.random(len(index)), rng.random(len(index)) < 0.9
    label = linked(index, grid, distance, free, limit)
    assert same_partition(label, _plain.linked(index, grid, distance, free, limit))
    # Sets are counted in the order of their first nodes.
    first = np.unique(label, return_index=True)[1]
    assert (np.diff(first) > 0).all()


def cost(features, chosen):
    return ((features[:, None] - chosen) ** 2).sum(axis=2).min(axis=1).sum()


@pytest.mark.parametrize("steps", [0, 1, 12])
def test_points_are_spread_as_the_twin_spreads_them(steps, rng):
    features = np.hstack([rng.uniform(-0.05, 0.05, (1500, 3)), 0.01 * rng.normal(size=(1500, 3))])
    chosen, plain = spread_out(features, 60, steps), _plain.spread_out(features, 60, steps)
    np.testing.assert_allclose(chosen, plain, rtol=0, atol=1e-12)


def test_points_of_a_lattice_are_spread_as_well_as_the_twin_spreads_them():
    """Many are equally far: rounding chooses among them."""
    axis = np.linspace(-0.05, 0.05, 12)
    places = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    features = np.hstack([places, np.zeros_like(places)])
    found, plain = (cost(features, way(features, 50, 12)) for way in (spread_out, _plain.spread_out))
    assert found == pytest.approx(plain, rel=0.05)


def test_places_are_snapped_to_the_points_that_the_twin_takes(rng):
    features, middles = rng.normal(size=(500, 6)), rng.normal(size=(200, 6))
    middles[:50] = features[0]  # all ask for the same
    index = snapped(features, middles)
    np.testing.assert_array_equal(index, _plain.snapped(features, middles))
    assert len(set(index)) == 200
    np.testing.assert_array_equal(np.sort(snapped(features, features[::-1].copy())), np.arange(500))


def test_as_many_places_as_points_are_these_points(rng):
    features = rng.normal(size=(20, 6))
    chosen = spread_out(features, 20, 3)
    assert cost(chosen, features) == pytest.approx(0, abs=1e-20)


def test_several_threads_at_once_are_answered_as_one_is(rng):
    mesh = triangles(*divided(*bumpy(), 1))
    nearest, winding = NearestPoint(mesh), Winding.of_mesh(mesh)
    sets = [rng.uniform(-0.08, 0.08, (5000, 3)) for _ in range(4)]
    model = ObjectModel.from_mesh(mesh.vertices, mesh.faces)
    gate = threading.Barrier(4)

    def answers(points, wait=True):
        if wait:
            gate.wait(timeout=60)
        return all_feet(points, np.inf, nearest._tree), winding.at(points), *model.evaluate(points)

    alone = [answers(points, wait=False) for points in sets]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(answers, sets))
    for one, other in zip(alone, together, strict=True):
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            # Of equally near triangles the one tried first is taken, and that is the last point's.
            np.testing.assert_allclose(a[:, 0] if k == 0 else a, b[:, 0] if k == 0 else b, rtol=0, atol=1e-12)


def test_an_object_is_looked_up_as_the_twin_does(rng):
    mesh = ObjectModel.from_mesh(*bumpy())
    points = np.vstack([rng.uniform(-0.1, 0.1, (3000, 3)), rng.normal(size=(100, 3))])
    for model in (mesh, ObjectModel.box((0.06, 0.09, 0.14)), ObjectModel.cylinder(0.03, 0.1)):
        for fine, field in ((True, model.fine), (False, model.coarse)):
            for found, plain in zip(model.evaluate(points, fine=fine), field.evaluate(points), strict=True):
                assert found.dtype == np.float64
                assert found.shape == plain.shape
                np.testing.assert_allclose(found, plain, rtol=1e-9, atol=1e-9)
    assert [v.shape for v in mesh.evaluate(np.empty((0, 3)))] == [(0,), (0, 3), (0, 3, 3)]


def test_winding_and_feet_take_any_layout_of_points(rng):
    mesh = shape("box")
    points = rng.uniform(-0.1, 0.1, (50, 3))
    still = points.copy()
    still.flags.writeable = False
    for same in (np.asfortranarray(points), np.repeat(points, 2, axis=0)[::2], still):
        np.testing.assert_array_equal(
            NearestPoint(mesh).feet(same)[0].distance, NearestPoint(mesh).feet(points)[0].distance
        )
        np.testing.assert_array_equal(Winding.of_mesh(mesh).at(same), Winding.of_mesh(mesh).at(points))


def test_warming_compiles_what_building_an_object_calls(rng):
    from handsight._kernels import field, linking, nearest_triangle, spreading, winding

    told = []
    warm.warm(lambda name, seconds: told.append((name, seconds)))
    assert [name for name, _ in told] == list(warm.GROUPS)
    kernels = (
        nearest_triangle.feet,
        winding.winding,
        linking.linked,
        spreading.spread_out,
        spreading.snapped,
        field.evaluate,
    )
    before = [len(kernel.signatures) for kernel in kernels]
    size = 0.05 + 0.001 * rng.random()  # of its own: nothing is remembered
    model = ObjectModel.from_mesh(*bumpy(size=size))
    model.evaluate(np.zeros((3, 3)))
    ObjectModel.box((size, size, size)).evaluate(np.zeros((3, 3)))
    ObjectModel.from_points(*model.sample(500))
    assert [len(kernel.signatures) for kernel in kernels] == before
    assert (
        winding_at(np.zeros((1, 3)), *(lambda w: (w.patches, w.elements))(Winding.of_mesh(shape("box"))))
        > 0.5
    )
