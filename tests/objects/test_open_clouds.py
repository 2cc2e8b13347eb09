"""The distance to an open cloud is zero on its surface only, as exactly as its points show the surface."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from handsight.objects import ObjectModel

SOLIDS = {
    "ball": ObjectModel.sphere(0.05),
    "can": ObjectModel.cylinder(0.033, 0.115),
    "box": ObjectModel.box((0.06, 0.09, 0.14)),
}
DENSE = 30_000


def turned(points, normals, rng):
    T = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T *= np.sign(np.linalg.det(T))
    return points @ T.T + 0.02, normals @ T.T


def cut(name, rng):
    """Part of a solid, on one side of a plane through its middle third: points, normals, distances from the cut [m].

    There are thousands of points in a random order; half the time the normals point inwards.
    """
    points, normals = SOLIDS[name].sample(DENSE, seed=int(rng.integers(10**6)))
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    height = points @ way
    inwards = height - np.quantile(height, rng.uniform(0.3, 0.65))
    order = rng.permutation(np.flatnonzero(inwards > 0))
    return points[order], rng.choice([-1.0, 1.0]) * normals[order], inwards[order]


def patch(_, rng):
    """A flat piece."""
    sides = rng.uniform(0.02, 0.06, 2)
    across = rng.uniform(-1, 1, (DENSE, 2)) * sides
    flat = np.column_stack([across, np.zeros(DENSE)])
    return flat, np.tile([0.0, 0.0, 1.0], (DENSE, 1)), (sides - np.abs(across)).min(axis=1)


def tube(_, rng):
    """A can's side, all around or less, without lids."""
    arc, radius, height = rng.uniform(2, 2 * np.pi), rng.uniform(0.02, 0.05), rng.uniform(0.06, 0.12)
    turn, z = rng.uniform(0, arc, DENSE), rng.uniform(-height / 2, height / 2, DENSE)
    normals = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(DENSE)])
    to_rim = np.minimum(height / 2 - np.abs(z), radius * np.minimum(turn, arc - turn))
    return radius * normals + z[:, None] * [0, 0, 1], normals, to_rim


SURFACES = dict.fromkeys(SOLIDS, cut) | {"patch": patch, "tube": tube}
SMOOTH = ("ball", "patch", "tube")


def opened(name, count, seed):
    """An open cloud's model; its dense surface, with normals and distances from the rim; and the radius of the largest
    gap between its points [m], within which no cloud can show where the surface is."""
    rng = np.random.default_rng(seed)
    points, normals, inwards = SURFACES[name](name, rng)
    points, normals = turned(points, normals, rng)
    model = ObjectModel.from_points(points[:count], normals[:count])
    unknown = cKDTree(points[:count]).query(points)[0].max()
    return model, (points, normals, inwards), unknown, rng


@settings(max_examples=8, deadline=None)
@given(st.sampled_from(sorted(SURFACES)), st.integers(400, 2500), st.integers(0, 10**6))
def test_the_distance_to_an_open_cloud_is_that_to_its_surface_and_zero_on_it_only(name, count, seed):
    model, (surface, normals, inwards), unknown, rng = opened(name, count, seed)
    assert not model.closed
    near = surface[rng.integers(len(surface), size=2000)]
    low, high = model.bounds_object
    wide = rng.uniform(low - 0.04, high + 0.04, (2000, 3))
    points = np.vstack([near + 0.006 * rng.normal(size=near.shape), wide])
    expected = cKDTree(surface).query(points)[0]
    for fine, field in ((True, model.fine), (False, model.coarse)):
        distance = np.abs(model.evaluate(points, fine=fine).distance)
        # The gap between the points, how far the surface goes on past the last of them, and the error of a grid.
        reach = unknown + field.blur + field.cell
        assert (distance > expected - reach).all()
        assert (distance < expected + reach)[expected < 0.03].all()
    if name in SMOOTH:
        within = inwards > 2 * unknown
        on, out = surface[within][:2000], normals[within][:2000]
        for side in (-1.0, 1.0):
            assert (side * model.evaluate(on + side * unknown * out).distance > 0).all()


def test_near_its_points_an_open_cloud_has_the_field_of_the_closed_one(rng):
    """Distance and normal of a ball, five spacings and more from where a quarter of it is missing."""
    points, normals = SOLIDS["ball"].sample(1500)
    kept = points[:, 2] < 0.025
    whole, most = (
        ObjectModel.from_points(points, normals),
        ObjectModel.from_points(points[kept], normals[kept]),
    )
    assert (whole.closed, most.closed) == (True, False)
    assert (whole.fine.sheet, whole.fine.blur) == (False, 0.0)
    far = points[:, 2] < 0.01
    near = points[far] + rng.uniform(-0.003, 0.003, (far.sum(), 1)) * normals[far]
    (d, g, _), (expected, gradient, _) = most.evaluate(near), whole.evaluate(near)
    np.testing.assert_allclose(d, expected, atol=0.1 * whole.fine.cell)
    assert np.median(np.linalg.norm(g - gradient, axis=1)) < np.deg2rad(1)


def test_an_open_cloud_is_the_same_when_it_comes_from_the_cache(rng):
    surface, normals, _ = patch("", rng)
    first, again = (ObjectModel.from_points(surface[:600], normals[:600]) for _ in range(2))
    assert first.fine.sheet
    assert (again.fine.sheet, again.fine.blur) == (True, first.fine.blur)
