"""Laws of resting poses: closed forms, the support polygon of a tetrahedron, and trimesh's quasi-static poses."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight.objects import ObjectModel
from handsight.objects.resting import FREE, resting_poses

SIZE = np.array([0.06, 0.09, 0.14])


def sideways(pose, down):
    """Returns the two standard deviations across a pose's direction near `down` [rad]."""
    spread = pose.near(np.asarray(down, dtype=float))[2]
    return np.sqrt(np.maximum(np.linalg.eigvalsh(spread)[1:], 0))


def hull_of(points):
    """Returns what `resting_poses` reads of a model: a hull, whose fields would take long to build."""
    hull = trimesh.convex.convex_hull(points)
    size = max(np.linalg.norm(a - b) for a in points for b in points)
    return hull, SimpleNamespace(vertices=hull.vertices, closed=False, surface=None, diameter=size)


@pytest.mark.parametrize("kind", ["box", "cloud"])
def test_a_box_rests_on_each_of_its_six_sides_and_likeliest_on_the_largest(kind):
    box = ObjectModel.box(SIZE)
    poses = resting_poses(box if kind == "box" else ObjectModel.from_points(*box.sample(3000)))
    assert len(poses) == 6
    assert sum(pose.probability for pose in poses) == pytest.approx(1)
    for pose in poses:
        axis = np.abs(pose.down[0]).argmax()
        assert np.abs(pose.down[0, axis]) > 0.999
        np.testing.assert_allclose(pose.heights[0], SIZE[axis] / 2, atol=1e-9 if kind == "box" else 2e-3)
        assert (sideways(pose, pose.down[0]) < np.deg2rad(1.0 if kind == "box" else 3.0)).all()
    assert all(np.abs(pose.down[0, 0]) > 0.999 for pose in poses[:2])


def test_a_cylinder_stands_on_its_ends_or_rolls_on_its_side():
    poses = resting_poses(ObjectModel.cylinder(0.033, 0.122))
    side, *ends = sorted(poses, key=lambda pose: abs(pose.down[0, 2]))
    assert len(ends) == 2
    for end in ends:
        np.testing.assert_allclose([abs(end.down[0, 2]), end.heights[0]], [1, 0.061], atol=1e-9)
    for angle in np.linspace(0, 6, 7):  # any direction across the axis can point down; 5° off is brought back
        across = np.array([np.cos(angle), np.sin(angle), 0.0])
        down, height, spread = side.near(np.append(across[:2], np.tan(np.deg2rad(5))))
        np.testing.assert_allclose(down, across, atol=0.01)
        np.testing.assert_allclose(height, 0.033, atol=1e-4)
        along = np.cross(across, [0, 0, 1])
        assert along @ spread @ along > 0.9 * FREE
        assert spread[2, 2] < np.deg2rad(1.0) ** 2


def test_a_ball_rests_on_any_point():
    (pose,) = resting_poses(ObjectModel.sphere(0.04))
    assert (sideways(pose, [0.36, 0.48, 0.8]) ** 2 > 0.9 * FREE).all()


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_tetrahedron_rests_on_the_faces_that_its_centre_of_mass_is_above(seed):
    rng = np.random.default_rng(seed)
    corners = 0.05 * rng.normal(size=(4, 3))
    if abs(np.linalg.det(corners[1:] - corners[0])) < 1e-5:
        return
    center, model = corners.mean(axis=0), hull_of(corners)[1]
    found = np.array([pose.down[0] for pose in resting_poses(model)])
    for k in range(4):
        face = np.delete(corners, k, axis=0)
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        normal *= np.sign(normal @ (face[0] - corners[k])) / np.linalg.norm(normal)
        height = normal @ (face[0] - center)
        # Signed distances of the centre's projection from the sides; the energy rises to the distance of a side.
        ends = [(face[i], face[(i + 1) % 3], face[i - 1]) for i in range(3)]
        inside = []
        for a, b, c in ends:
            out = np.cross(b - a, normal) / np.linalg.norm(b - a)
            inside.append((a - center) @ out * -np.sign((c - a) @ out))
        rise = np.hypot(height, min(inside)) - height if min(inside) > 0 else -1.0
        is_found = bool((found @ normal > 1 - 1e-6).any())
        if rise > 0.004 * model.diameter:
            assert is_found
        elif min(inside) < 0:
            assert not is_found


def test_a_leaning_tower_falls_unless_it_is_heavy_below():
    corners = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.06, 0.06)])
    corners[:, 0] += (
        0.6 * corners[:, 2]
    )  # the middle of the top is beyond the base, as is half of the volume's
    tower = hull_of(corners)[1]

    def stands(poses):
        return any(pose.down[0, 2] < -0.999 for pose in poses)

    assert not stands(resting_poses(tower))
    assert stands(resting_poses(tower, np.array([-0.03, 0.0, -0.05])))
