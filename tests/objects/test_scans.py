"""Objects built from noisy points: the noise is estimated, and the surface behind it with its own error."""

import warnings

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight.objects import ObjectModel, Triangles, diameter
from handsight.objects.scans.patches import Points, estimated_noise, spacing_of
from handsight.objects.scans.scan import scanned, smoothed
from oracles import fields

CAN, BOX, BALL = (
    ObjectModel.cylinder(0.033, 0.115),
    ObjectModel.box((0.06, 0.09, 0.14)),
    ObjectModel.sphere(0.035),
)
SHAPES = {"can": CAN, "box": BOX, "ball": BALL}


def plane(n, rng):
    """A sheet of 10 by 8 cm."""
    points = np.column_stack([rng.uniform(-0.05, 0.05, n), rng.uniform(-0.04, 0.04, n), np.zeros(n)])
    return points, np.tile([0.0, 0, 1], (n, 1))


def drawn(name, n, seed):
    """Points on a shape and their normals, in a random order."""
    rng = np.random.default_rng([seed, n])
    points, normals = plane(n, rng) if name == "plane" else SHAPES[name].sample(n, seed)
    if name == "ball":  # not on its facets
        normals = points / np.linalg.norm(points, axis=1, keepdims=True)
        points = 0.035 * normals
    side = np.flatnonzero(np.abs(normals[:, 2]) < 0.5) if name == "can" else []
    if len(side):
        normals[side] = points[side] * [1, 1, 0] / np.linalg.norm(points[side, :2], axis=1, keepdims=True)
        points[side, :2] = 0.033 * normals[side, :2]
    order = rng.permutation(n)
    return points[order], normals[order], rng


def as_points(places, normals=None):
    """The points as a scan keeps them."""
    unknown = np.full_like(places, np.nan)
    given = unknown if normals is None else normals
    return Points(places, given, spacing_of(places), diameter(places))


@pytest.mark.parametrize("name", ["plane", "can", "box", "ball"])
@pytest.mark.parametrize("seed", range(4))
def test_noise_is_estimated_from_the_points(name, seed):
    rng = np.random.default_rng([seed, 5])
    n, sigma = int(np.exp(rng.uniform(np.log(2000), np.log(20_000)))), 10 ** rng.uniform(-3.8, -2.7)
    points, _, rng = drawn(name, n, seed)
    _, noise = estimated_noise(as_points(points + sigma * rng.normal(size=points.shape)))
    assert not noise.is_shape
    assert noise.together == 1
    # Edges count as a little noise where points are far apart.
    assert 0.85 * sigma < noise.sigma < 1.35 * sigma


def test_noise_that_neighbours_share_is_distinguished_from_independent_noise():
    points, normals, rng = drawn("can", 6000, 2)
    waves, phases = rng.normal(size=(3, 400)) / 3e-3, rng.uniform(0, 2 * np.pi, 400)
    shared = 8e-4 * np.sqrt(2 / 400) * np.cos(points @ waves + phases).sum(axis=1)
    noisy = points + shared[:, None] * normals + 1e-4 * rng.normal(size=points.shape)
    _, noise = estimated_noise(as_points(noisy))
    assert not noise.is_shape
    assert noise.together > 2
    assert 4e-4 < noise.sigma < 1.2e-3


def off_edges(name, rng):
    """Points and normals of a shape, away from its edges."""
    points, normals = SHAPES[name].sample(4000, int(rng.integers(1000)))
    if name == "can":
        keep = (np.abs(points[:, 2]) < 0.045) & (np.abs(normals[:, 2]) < 0.5)
    elif name == "box":
        keep = ((np.abs(points) / [0.03, 0.045, 0.07]) > 0.75).sum(axis=1) == 1
    else:
        keep = np.ones(len(points), dtype=bool)
    return points[keep], normals[keep]


@pytest.mark.parametrize("name", ["can", "box", "ball"])
@pytest.mark.parametrize("sigma", [5e-4, 2e-3])
@pytest.mark.parametrize("given", [True, False])
def test_the_surface_is_more_exact_than_its_points_and_its_error_is_right(name, sigma, given):
    points, normals, rng = drawn(name, 4000, 6)
    noisy = points + sigma * rng.normal(size=points.shape)
    scan = ObjectModel.from_points(noisy, normals if given else None)
    places, facing = off_edges(name, rng)
    distance, gradient, _ = scan.fine.evaluate(places)
    angle2 = (np.cross(gradient, facing) ** 2).sum(axis=1) / 2 / (gradient**2).sum(axis=1)
    expected = fields.variances(scan.field_error, places).mean(axis=0)
    assert np.sqrt((distance**2).mean()) < 0.3 * sigma
    assert 0.7 < np.sqrt(expected[0] / (distance**2).mean()) < 2.5
    assert 0.7 < np.sqrt(expected[1] / angle2.mean()) < 3
    assert (expected[2:] > 0).all()
    assert scan.closed


def test_points_with_normals_and_no_noise_are_used_as_they_are():
    points, normals = BOX.sample(3000)
    geometry = ObjectModel.from_points(points, normals)
    np.testing.assert_array_equal(geometry.surface.vertices, points)
    assert not geometry.field_error.values[..., 2:].any()
    assert (
        scanned(
            points + 3e-4 * BOX.diameter * np.random.default_rng(0).normal(size=(3000, 3)),
            normals,
            BOX.diameter,
        )
        is None
    )


CLEAN = {
    "box of long triangles": lambda: trimesh.creation.box((0.06, 0.09, 0.14)).subdivide_to_size(0.005),
    "ball": lambda: trimesh.creation.icosphere(subdivisions=5, radius=0.035),
    "can of 48 sides": lambda: trimesh.creation.cylinder(0.033, 0.115, sections=48).subdivide_to_size(0.006),
    "capsule": lambda: trimesh.creation.capsule(height=0.08, radius=0.02, count=[60, 60]),
    "waves": lambda: waves(5),
}


def waves(times):
    """A ball with waves."""
    mesh = trimesh.creation.icosphere(subdivisions=times, radius=0.04)
    u = mesh.vertices / 0.04
    mesh.vertices = mesh.vertices * (1 + 0.05 * np.sin(9 * u[:, :1]) * np.cos(7 * u[:, 1:2]))
    return mesh


@pytest.mark.parametrize("name", CLEAN)
@pytest.mark.parametrize("noise", [1.5e-3, 6e-3])
def test_the_noisy_vertices_of_a_mesh_are_moved_to_its_surface(name, noise):
    mesh = CLEAN[name]()
    clean, size = np.asarray(mesh.vertices, dtype=float), diameter(np.asarray(mesh.vertices))
    rng = np.random.default_rng(7)
    noisy = Triangles(clean + noise * size * rng.normal(size=clean.shape), np.asarray(mesh.faces))
    found, roughness = smoothed(noisy, size)
    assert roughness is not None
    np.testing.assert_array_equal(found.faces, noisy.faces)
    before, after = (
        np.abs(trimesh.proximity.signed_distance(mesh, v[:300])) for v in (noisy.vertices, found.vertices)
    )
    assert np.median(after) < 0.6 * np.median(before)


def hostile():
    """Clouds that hardly anybody would call a scan."""
    rng = np.random.default_rng(3)
    ball = BALL.sample(3000)[0]
    sheet, _ = plane(3000, rng)
    yield "a sheet", sheet
    yield "a noisy sheet", sheet + 1e-3 * rng.normal(size=sheet.shape)
    yield "a thick line", np.column_stack([np.linspace(0, 0.2, 1000), *(1e-3 * rng.normal(size=(2, 1000)))])
    yield "a lump", 0.03 * rng.normal(size=(2000, 3))
    yield "twice the same, nearly", np.vstack([ball, ball + 1e-8])
    yield "two balls", np.vstack([ball, ball + np.array([0.5, 0, 0])])
    yield "far away", ball + 1e-3 * rng.normal(size=ball.shape) + [900.0, -500.0, 100.0]
    yield "one dense spot", np.vstack([ball, 1e-5 * rng.normal(size=(9000, 3)) + [0.035, 0, 0]])
    yield "few", ball[:30] + 1e-3 * rng.normal(size=(30, 3))
    yield "a grid", np.stack(np.meshgrid(*[np.linspace(0, 0.05, 12)] * 3), axis=-1).reshape(-1, 3)


@pytest.mark.parametrize(
    ("name", "points"), list(hostile()), ids=lambda given: given if isinstance(given, str) else ""
)
def test_any_cloud_is_an_object_with_finite_fields(name, points):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hs.objects.ObjectWarning)
        geometry = ObjectModel.from_points(points, None)
    assert np.isfinite(geometry.coarse.values).all()
    assert np.isfinite(geometry.fine.values).all()
    assert np.isfinite(geometry.field_error.values).all()
    assert (geometry.field_error.values >= 0).all()


def test_of_a_million_points_twenty_thousand_are_used():
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(1_000_000, 3))
    points = 0.05 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    scan = scanned(points + 5e-4 * rng.normal(size=points.shape), None, 0.1)
    assert len(scan.surface.patches) == 4000
    assert scan.noise.sigma == pytest.approx(5e-4, rel=0.15)


@pytest.mark.parametrize("width", [4e-3, 5e-3])
def test_the_error_of_normals_includes_detail_that_is_finer_than_the_points(width):
    """A ball with dents that are hardly wider than the spacing of its points."""
    rng = np.random.default_rng(1)
    waves, phases = rng.normal(size=(3, 400)) / width, rng.uniform(0, 2 * np.pi, 400)
    height = 2e-4 * np.sqrt(2 / 400)

    def dented(way):
        return (0.035 + height * np.cos(0.035 * way @ waves + phases).sum(axis=1))[:, None] * way

    way, places = (
        given / np.linalg.norm(given, axis=1, keepdims=True) for given in rng.normal(size=(2, 2600, 3))
    )
    scan = ObjectModel.from_points(dented(way), None)
    slope = -height * np.sin(0.035 * places @ waves + phases) @ waves.T
    facing = places - slope + (slope * places).sum(axis=1, keepdims=True) * places
    gradient = scan.fine.evaluate(dented(places)).gradient
    sine2 = (np.cross(gradient, facing) ** 2).sum(axis=1) / (
        (gradient**2).sum(axis=1) * (facing**2).sum(axis=1)
    )
    expected = fields.variances(scan.field_error, dented(places))[:, 1]
    assert 0.7 < np.sqrt(expected.mean() / (sine2.mean() / 2)) < 3


def without_a_base(sigma, seed):
    """A noisy scan of a can without points on its base, and places on the base."""
    points, normals, rng = drawn("can", 4000, seed)
    visible = normals[:, 2] > -0.5
    noisy = points + sigma * rng.normal(size=points.shape)
    return ObjectModel.from_points(noisy[visible], normals[visible]), points[~visible]


@pytest.mark.parametrize("seed", range(3))
def test_the_error_of_a_scan_is_large_where_it_has_no_points(seed):
    scan, base = without_a_base(1e-3, seed)
    assert not scan.closed
    far = base[np.linalg.norm(base[:, :2], axis=1) < 0.025]
    variances = fields.variances(scan.field_error, far)
    off = scan.fine.evaluate(far).distance
    assert (np.abs(off) < 2.5 * np.sqrt(variances[:, 0])).mean() > 0.95
    assert (variances[:, 1] > 0.5**2).mean() > 0.9
    # Where there are points all around, the error is that of a scan of the complete can.
    points, normals, rng = drawn("can", 4000, seed)
    closed = ObjectModel.from_points(points + 1e-3 * rng.normal(size=points.shape), normals)
    assert closed.closed
    side, _ = off_edges("can", rng)
    side = side[side[:, 2] > 0]
    here, there = (np.median(fields.variances(given.field_error, side), axis=0) for given in (scan, closed))
    np.testing.assert_allclose(here, there, rtol=0.5)
