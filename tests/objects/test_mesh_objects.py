import numpy as np
import pytest

from handsight.errors import InvalidObject
from handsight.objects import ObjectModel, ObjectWarning
from handsight.objects.meshes.mesh_geometry import holes_of
from objects.object_shapes import BOX_FACES, box_mesh, holed_box, moebius, prism, triangles
from testbed.refusals import refused

SIZE = np.array([0.06, 0.09, 0.14])


def test_signs_are_right_around_a_sharp_wedge(rng):
    vertices, faces = prism(3, radius=0.03)
    vertices[:, 0] *= 4
    model = ObjectModel.from_mesh(vertices, faces)
    outward = np.cross([0, 0, 1], np.roll(vertices[:3], -1, axis=0) - vertices[:3])
    outward /= -np.linalg.norm(outward, axis=1, keepdims=True)
    points = rng.uniform(-0.13, 0.13, (20_000, 3)) * [1, 0.5, 0.5]
    height = np.max([(points - v) @ n for v, n in zip(vertices[:3], outward, strict=True)], axis=0)
    height = np.maximum(height, np.abs(points[:, 2]) - 0.05)
    clear = np.abs(height) > 1.5 * model.fine.cell
    np.testing.assert_array_equal(model.evaluate(points).distance[clear] < 0, height[clear] < 0)


def test_a_box_with_a_small_hole_is_closed_and_has_the_right_signs(rng):
    vertices, faces = holed_box(SIZE)
    mesh = triangles(vertices, faces)
    (middle,), (extent,) = holes_of(mesh, mesh.edges.counts == 1)
    model = ObjectModel.from_mesh(vertices, faces)
    assert model.closed
    points = rng.uniform(-0.6, 0.6, (20_000, 3)) * SIZE
    outward = (np.abs(points) - SIZE / 2).max(axis=1)
    clear = np.abs(outward) > 1.2 * model.fine.cell
    # In the hole itself the sign is a guess to about half its width.
    clear &= np.linalg.norm(points - middle, axis=1) > 0.7 * extent
    np.testing.assert_array_equal(model.evaluate(points).distance[clear] < 0, outward[clear] < 0)


def open_can():
    """A prism of 48 sides without its upper cap."""
    vertices, faces = prism(48, 0.03, 0.08)
    return vertices, faces[~(faces >= 48).all(axis=1)]


def test_a_can_without_its_lid_is_open_and_negative_behind_its_wall(rng):
    vertices, faces = open_can()
    model = ObjectModel.from_mesh(vertices, faces)
    assert not model.closed
    angle = rng.uniform(0, 2 * np.pi, 300)
    wall = np.stack([np.cos(angle), np.sin(angle), np.zeros(300)], axis=1)
    for depth in (-0.008, -0.004, 0.004, 0.008):
        points = (0.03 + depth) * wall + [0, 0, -0.005]
        distance, gradient, _ = model.evaluate(points)
        np.testing.assert_allclose(distance, depth, atol=4e-4)
        along = (gradient * wall).sum(axis=1) / np.linalg.norm(gradient, axis=1)
        assert (along > 0.98).all()
    # Around the rim nothing jumps.
    path = np.stack([np.linspace(0.02, 0.04, 2000), np.zeros(2000), np.full(2000, 0.041)], axis=1)
    assert np.abs(np.diff(model.evaluate(path).distance)).max() < 5 * 1e-5


def test_a_hollow_object_is_solid_between_its_walls():
    outer, faces = box_mesh((0.1, 0.1, 0.1))
    inner, _ = box_mesh((0.05, 0.05, 0.05))
    model = ObjectModel.from_mesh(np.vstack([outer, inner]), np.vstack([faces, faces[:, ::-1] + 8]))
    assert model.closed
    center, wall, outside = model.evaluate([[0.0, 0, 0], [0.029, 0, 0], [0.07, 0, 0]]).distance
    assert center > 0.02
    assert wall == pytest.approx(-0.004, abs=1e-4)
    assert outside > 0.019


def test_overlapping_pieces_are_one_solid():
    vertices, faces = box_mesh((0.05, 0.05, 0.1))
    both = np.vstack([vertices, vertices[:, [2, 1, 0]] * [1, 1, 1]])
    model = ObjectModel.from_mesh(both, np.vstack([faces, faces[:, ::-1] + 8]))
    assert model.closed
    assert (model.evaluate([[0.0, 0, 0], [0.04, 0, 0], [0, 0, 0.04]]).distance < -0.005).all()
    assert (model.evaluate([[0.04, 0, 0.04], [0, 0.04, 0]]).distance > 0.01).all()


def like_the_box(model, rng):
    points = rng.uniform(-0.07, 0.07, (500, 3))
    box = ObjectModel.from_mesh(*box_mesh(SIZE))
    # The nodes at the end of the exact band depend on how the surface is cut into triangles.
    found, expected = model.evaluate(points).distance, box.evaluate(points).distance
    np.testing.assert_allclose(found, expected, atol=3e-4)
    assert (np.abs(found - expected) < 1e-6).mean() > 0.9


def test_an_inside_out_mesh_is_turned(rng):
    vertices, faces = box_mesh(SIZE)
    with pytest.warns(ObjectWarning):
        like_the_box(ObjectModel.from_mesh(vertices, faces[:, ::-1]), rng)


def test_triangles_that_disagree_are_turned(rng):
    vertices, faces = box_mesh(SIZE)
    mixed = faces.copy()
    mixed[[2, 5, 9]] = mixed[[2, 5, 9], ::-1]
    with pytest.warns(ObjectWarning):
        like_the_box(ObjectModel.from_mesh(vertices, mixed), rng)


def test_repeated_and_flat_triangles_are_dropped(rng):
    vertices, faces = box_mesh(SIZE)
    more = np.vstack([faces, faces[:2], [(0, 0, 1), (3, 5, 3)]])
    with pytest.warns(ObjectWarning) as caught:
        like_the_box(ObjectModel.from_mesh(vertices, more), rng)
    messages = [str(w.message) for w in caught]
    assert messages == ["2 triangles without area were dropped", "2 repeated triangles were dropped"]


def test_a_small_loose_piece_is_left_in_and_mentioned():
    vertices, faces = box_mesh(SIZE)
    crumb = vertices * 0.03 + [0.06, 0, 0]
    with pytest.warns(ObjectWarning):
        model = ObjectModel.from_mesh(np.vstack([vertices, crumb]), np.vstack([faces, faces + 8]))
    assert len(model.faces) == 24


def test_a_one_sided_surface_is_open_and_warned_of():
    with pytest.warns(ObjectWarning):
        assert not ObjectModel.from_mesh(*moebius(60)).closed


@pytest.mark.parametrize(
    ("vertices", "faces", "field"),
    [
        (np.zeros((0, 3)), BOX_FACES, "vertices"),
        (np.zeros((8, 2)), BOX_FACES, "vertices"),
        (box_mesh()[0], [], "faces"),
        (box_mesh()[0], [(0, 1, 2, 3)], "faces"),
        (box_mesh()[0], [(0.0, 1.0, 2.0)], "faces"),
        (box_mesh()[0], [(0, 1, 8)], "faces"),
        (box_mesh()[0], [(0, 1, -1)], "faces"),
        (box_mesh()[0], [(0, 1, 1), (2, 2, 2)], "faces"),
        (np.full((8, 3), 0.1), BOX_FACES, "vertices"),
        (np.full((8, 3), np.nan), BOX_FACES, "vertices[0]"),
        (1e200 * box_mesh()[0], BOX_FACES, "vertices"),
        ("box", BOX_FACES, "mesh"),
    ],
)
def test_arrays_that_are_no_surface_are_refused(vertices, faces, field):
    with refused(InvalidObject, field):
        ObjectModel.from_mesh(vertices, faces)
