import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from handsight import se3
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel, Symmetries, about, nearest, propose_symmetries
from objects.object_shapes import prism
from testbed.refusals import refused

RADIUS = 0.07
OFF_AXIS = ((0.02, -0.03, 0.1), (1.0, 2.0, 2.0))
off_point, off_axis = np.array(OFF_AXIS[0]), np.array(OFF_AXIS[1]) / 3
across = np.cross(off_axis, [1, 0, 0]) / np.linalg.norm(np.cross(off_axis, [1, 0, 0]))
GROUPS = {
    "none": Symmetries(),
    "box": ObjectModel.box((0.06, 0.09, 0.14)).symmetries,
    "cube": ObjectModel.box((0.06, 0.06, 0.06)).symmetries,
    "can": ObjectModel.cylinder(0.03, 0.1).symmetries,
    "cone": Symmetries([((0, 0, 0), (0, 0, 2))]),
    "can, origin elsewhere": Symmetries([OFF_AXIS], about(off_point, np.pi * across)[None]),
    "ball": ObjectModel.sphere(0.04).symmetries,
    "ball, origin elsewhere": Symmetries([((0.1, 0, 0.02), (1, 0, 0)), ((0.1, 0, 0.02), (1, 1, 0))]),
}
each_group = pytest.mark.parametrize("symmetries", GROUPS.values(), ids=GROUPS.keys())


def distance(T, T_reference):
    delta = se3.difference(T, T_reference)
    return np.sqrt((delta[..., :3] ** 2).sum(axis=-1) + RADIUS**2 * (delta[..., 3:] ** 2).sum(axis=-1))


def equivalents(symmetries, T, rng, n=400):
    """T @ S for many S of the group."""
    S = symmetries.rotations[rng.integers(len(symmetries.rotations), size=n)]
    for point, axis in symmetries.axes * 2:
        S = S @ about(point, rng.uniform(-np.pi, np.pi, (n, 1)) * axis)
    return T @ S


@pytest.mark.parametrize(
    ("name", "rotations", "axes"),
    [("none", 1, 0), ("box", 4, 0), ("cube", 24, 0), ("can", 2, 1), ("cone", 1, 1), ("ball", 1, 3)],
)
def test_shapes_declare_their_own_symmetries(name, rotations, axes):
    assert (len(GROUPS[name].rotations), len(GROUPS[name].axes)) == (rotations, axes)


@each_group
def test_discrete_rotations_are_a_group_with_the_identity_first(symmetries):
    S = symmetries.rotations
    np.testing.assert_array_equal(S[0], np.eye(4))
    products = (S[:, None] @ S).reshape(-1, 1, 4, 4)
    assert (np.abs(products - S).max(axis=(-1, -2)).min(axis=1) < 1e-9).all()


@pytest.mark.parametrize("name", ["box", "cube", "can", "ball"])
def test_symmetries_leave_the_surface_where_it_is(name, rng):
    models = {
        "box": ObjectModel.box((0.06, 0.09, 0.14)),
        "cube": ObjectModel.box((0.06, 0.06, 0.06)),
        "can": ObjectModel.cylinder(0.03, 0.1),
        "ball": ObjectModel.sphere(0.04),
    }
    points = rng.uniform(-0.1, 0.1, (50, 3))
    for S in equivalents(GROUPS[name], np.eye(4), rng, 30):
        moved = models[name].fine.evaluate(se3.apply(S, points)).distance
        np.testing.assert_allclose(moved, models[name].fine.evaluate(points).distance, atol=1e-12)


@each_group
def test_the_nearest_equivalent_is_no_farther_than_any_other(symmetries, rng):
    for _ in range(25):
        T, T_reference = se3.random(rng, 2, spread=0.05)
        best = nearest(symmetries, T, T_reference, RADIUS)
        others = distance(equivalents(symmetries, T, rng), T_reference)
        assert distance(best, T_reference) <= others.min() + 1e-9


@each_group
def test_the_nearest_equivalent_of_a_pose_is_equivalent_to_it(symmetries, rng):
    """Its own nearest to T is T itself: the way back is in the group."""
    Ts = se3.random(rng, 40, spread=0.05)
    T_reference = se3.random(rng, spread=0.05)
    best = nearest(symmetries, Ts, T_reference, RADIUS)
    assert best.shape == Ts.shape
    np.testing.assert_allclose(distance(nearest(symmetries, best, Ts, RADIUS), Ts), 0, atol=2e-8)
    np.testing.assert_allclose(
        best[:, :3, :3] @ best[:, :3, :3].swapaxes(1, 2), np.broadcast_to(np.eye(3), (40, 3, 3)), atol=1e-12
    )


@settings(max_examples=40)
@given(st.integers(0, 2**31))
def test_the_best_spin_is_the_minimum_along_the_axis(seed):
    rng = np.random.default_rng(seed)
    symmetries = Symmetries([OFF_AXIS])
    T, T_reference = se3.random(rng, 2, spread=0.1)

    def cost(angles):
        return distance(T @ about(off_point, angles[:, None] * off_axis), T_reference) ** 2

    angles = np.linspace(-np.pi, np.pi, 721)
    best = angles[cost(angles).argmin()]
    bounds = best - 0.01, best + 0.01
    least = minimize_scalar(
        lambda a: cost(np.array([a]))[0], bounds=bounds, method="bounded", options={"xatol": 1e-9}
    ).fun
    assert distance(nearest(symmetries, T, T_reference, RADIUS), T_reference) ** 2 <= least + 1e-12


def test_two_crossing_axes_make_a_ball():
    ball = GROUPS["ball, origin elsewhere"]
    assert ball.round
    assert len(ball.axes) == 3
    np.testing.assert_allclose([point for point, _ in ball.axes], [[0.1, 0, 0.02]] * 3, atol=1e-12)


@pytest.mark.parametrize(
    ("axes", "rotations", "field"),
    [
        ([((0, 0, 0), (0, 0, 0))], None, "axes[0].direction"),
        ([((0, 0, np.nan), (0, 0, 1))], None, "axes[0].point"),
        ([((0, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 0, 1))], None, "axes"),
        ([((0, 0, 0), (0, 0, 1)), ((1, 0, 0), (0, 1, 0))], None, "axes"),
        ([], [about(np.zeros(3), np.array([0, 0, 1.0]))], "rotations"),
        ([((0, 0, 0), (0, 0, 1))], [about(np.zeros(3), np.array([np.pi / 2, 0, 0]))], "rotations"),
    ],
)
def test_motions_that_are_no_symmetry_group_are_refused(axes, rotations, field):
    with refused(InvalidInput, field):
        Symmetries(axes, rotations)


def proposed(model, tolerance=None):
    found = propose_symmetries(model, tolerance)
    return len(found.rotations), len(found.axes)


def moved_mesh(vertices, faces, seed=3):
    T = se3.random(np.random.default_rng(seed), spread=0.03)
    return ObjectModel.from_mesh(se3.apply(T, np.asarray(vertices)), faces)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (lambda: ObjectModel.cylinder(0.033, 0.115), (2, 1)),
        (lambda: ObjectModel.sphere(0.04), (1, 3)),
        (lambda: ObjectModel.box((0.06, 0.09, 0.14)), (4, 0)),
        (lambda: ObjectModel.box((0.06, 0.06, 0.06)), (24, 0)),
        (lambda: ObjectModel.box((0.04, 0.04, 0.15)), (8, 0)),
        (lambda: moved_mesh(*prism(3)), (6, 0)),
        (lambda: moved_mesh(*prism(5)), (10, 0)),
        (lambda: moved_mesh(*prism(8)), (16, 0)),
        (lambda: moved_mesh(*prism(64)), (2, 1)),
    ],
    ids=["can", "ball", "box", "cube", "square bar", "triangle", "pentagon", "octagon", "facets of a can"],
)
def test_symmetries_are_found_in_the_shape(model, expected):
    assert proposed(model()) == expected


def test_proposed_symmetries_keep_the_samples_on_the_surface():
    model = moved_mesh(*prism(3))
    for S in propose_symmetries(model).rotations:
        moved = model.evaluate(se3.apply(S, model.points_object)).distance
        assert np.sqrt((moved**2).mean()) < 0.01 * model.diameter


def test_a_shape_without_symmetry_gets_none_proposed():
    vertices, faces = prism(3)
    vertices[4] += (0.02, -0.01, 0.015)
    assert proposed(ObjectModel.from_mesh(vertices, faces)) == (1, 0)
