"""The laws of rigid transforms, near their singular places too, with SciPy as the independent truth."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from handsight import se3
from handsight.errors import InvalidInput, InvalidTransform
from testbed.refusals import refused

ANGLES = (0.0, 1e-300, 1e-12, 1e-9, 1.01e-9, 1e-6, 9.99e-3, 1e-2, 0.5, 2.0, 2.68, 2.7, 3.0)
NEAR_PI = tuple(np.pi - e for e in (1e-3, 1e-6, 1e-9, 1e-12, 0.0))
AXES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1], [1, 1, 0], [0, -1, 1], [1, 2, -3.0]]
)
AXES /= np.linalg.norm(AXES, axis=1, keepdims=True)
ROTATION_VECTORS = np.array([angle * axis for angle in ANGLES + NEAR_PI for axis in AXES])
"""Near 0, on both sides of every change of formula, near π and exactly π about each axis."""


def transforms(seed=0, size=200):
    """Random transforms and, in the first rows, the near-singular rotations."""
    T = se3.random(np.random.default_rng(seed), size + len(ROTATION_VECTORS))
    T[: len(ROTATION_VECTORS), :3, :3] = Rotation.from_rotvec(ROTATION_VECTORS).as_matrix()
    return T


# Against SciPy


def test_rotation_exp_agrees_with_scipy():
    expected = Rotation.from_rotvec(ROTATION_VECTORS).as_matrix()
    np.testing.assert_allclose(se3.rotation_exp(ROTATION_VECTORS), expected, rtol=0, atol=4e-16 * 4)


def test_rotation_log_agrees_with_scipy():
    R = Rotation.random(300, rng=1).as_matrix()
    np.testing.assert_allclose(se3.rotation_log(R), Rotation.from_matrix(R).as_rotvec(), atol=1e-13)


def test_inverse_and_apply_agree_with_scipy():
    T = transforms()
    np.testing.assert_allclose(se3.inverse(T), RigidTransform.from_matrix(T).inv().as_matrix(), atol=1e-14)
    points = np.random.default_rng(3).normal(size=(7, 3))
    for one in T[::20]:
        expected = RigidTransform.from_matrix(one).apply(points)
        np.testing.assert_allclose(se3.apply(one, points), expected, atol=1e-14)


def test_quaternions_agree_with_scipy():
    T = transforms()
    q = se3.quaternion_from_rotation(T[:, :3, :3])
    expected = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    expected *= np.sign((q * expected).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(q, expected, atol=1e-15 * 4)
    # The largest is positive (up to rounding, where two are as large).
    np.testing.assert_allclose(q.max(axis=1), np.abs(q).max(axis=1), rtol=1e-12)
    random = np.random.default_rng(4).normal(size=(100, 4))
    np.testing.assert_allclose(
        se3.rotation_from_quaternion(random), Rotation.from_quat(random).as_matrix(), atol=1e-14
    )


# Laws


def test_log_undoes_exp_near_zero_to_full_relative_precision():
    small = ROTATION_VECTORS[np.linalg.norm(ROTATION_VECTORS, axis=1) < 1e-2]
    np.testing.assert_allclose(se3.rotation_log(se3.rotation_exp(small)), small, rtol=1e-13, atol=1e-16)


def test_exp_undoes_log_everywhere_and_the_angle_is_at_most_pi():
    R = transforms()[:, :3, :3]
    w = se3.rotation_log(R)
    assert np.linalg.norm(w, axis=1).max() <= np.pi + 1e-15
    np.testing.assert_allclose(se3.rotation_exp(w), R, rtol=0, atol=2e-15)


@pytest.mark.parametrize("axis", AXES, ids=str)
def test_a_half_turn_keeps_its_axis_up_to_sign(axis):
    R = 2 * np.outer(axis, axis) - np.eye(3)
    w = se3.rotation_log(R)
    np.testing.assert_allclose(np.linalg.norm(w), np.pi, rtol=1e-15)
    np.testing.assert_allclose(np.abs(w @ axis), np.pi, rtol=1e-14)


def test_moved_and_difference_undo_each_other():
    T, T_reference = transforms(9), transforms(10)[::-1]
    delta = se3.difference(T, T_reference)
    np.testing.assert_allclose(se3.moved(T_reference, delta), T, atol=1e-14)
    small = 0.5 * np.random.default_rng(11).normal(size=(len(T), 6))
    np.testing.assert_allclose(se3.difference(se3.moved(T, small), T), small, atol=1e-12)


def test_a_perturbation_moves_along_the_outer_frame_and_turns_about_the_origin_of_the_pose():
    T = se3.random(np.random.default_rng(12))
    quarter = np.array([1.0, 2, 3, 0, 0, np.pi / 2])
    moved = se3.moved(T, quarter)
    np.testing.assert_allclose(moved[:3, 3], T[:3, 3] + [1, 2, 3])
    np.testing.assert_allclose(moved[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]] @ T[:3, :3], atol=1e-15)


def test_the_covariance_of_a_perturbation_turns_with_its_frame():
    rng = np.random.default_rng(13)
    A = rng.normal(size=(6, 6))
    covariance_b = A @ A.T
    T_a_b = se3.random(rng)
    R = T_a_b[:3, :3]
    samples_b = rng.multivariate_normal(np.zeros(6), covariance_b, 5)
    samples_a = np.hstack([samples_b[:, :3] @ R.T, samples_b[:, 3:] @ R.T])
    turned = se3.rotate_covariance(R, covariance_b)
    np.testing.assert_allclose(
        np.einsum("ni,ij,nj->n", samples_a, np.linalg.inv(turned), samples_a),
        np.einsum("ni,ij,nj->n", samples_b, np.linalg.inv(covariance_b), samples_b),
        rtol=1e-8,
    )


# Stacks


@pytest.mark.parametrize(
    "function",
    [
        se3.inverse,
        lambda T: se3.quaternion_from_rotation(T[..., :3, :3]),
        lambda T: se3.rotation_log(T[..., :3, :3]),
        lambda T: se3.rotation_exp(se3.rotation_log(T[..., :3, :3])),
        lambda T: se3.skew(T[..., :3, 3]),
        lambda T: se3.rotation_from_quaternion(T[..., 0, :]),
        lambda T: se3.apply(T, np.array([[1.0, 2, 3], [4, 5, 6]])),
        lambda T: se3.moved(T, T[..., 0, [0, 1, 2, 0, 1, 2]]),
        lambda T: se3.difference(T, np.eye(4)),
    ],
)  # fmt: skip
def test_a_stack_agrees_with_its_singles(function):
    T = transforms(14, 10)
    singles = np.stack([function(one) for one in T])
    np.testing.assert_allclose(function(T), singles, rtol=1e-12, atol=1e-13)
    square = function(T[:6].reshape(2, 3, 4, 4))
    np.testing.assert_allclose(square.reshape(6, *square.shape[2:]), singles[:6], rtol=1e-12, atol=1e-13)
    assert function(T[:0]).shape == (0, *singles.shape[1:])


# Random transforms, poses of files


def test_a_pose_of_a_file_may_have_a_quaternion_of_any_length():
    T = se3.from_position_quaternion([1, 2, 3], [0, 0, 2, 2])
    np.testing.assert_allclose(T, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-15)


@pytest.mark.parametrize(
    ("position", "quaternion", "field"),
    [
        ([0, 0, 0], [0, 0, 0, 0], "quaternion_xyzw"),
        ([0, 0, 0], [0, 0, 1], "quaternion_xyzw"),
        ([0, np.inf, 0], [0, 0, 0, 1], "position"),
    ],
)
def test_a_wrong_pose_is_named(position, quaternion, field):
    with refused(InvalidInput, field):
        se3.from_position_quaternion(position, quaternion)


# check


def spoilt(row, column, value):
    T = np.eye(4)
    T[row, column] = value
    return T


@pytest.mark.parametrize(
    "T",
    [
        "pose",
        [[1, 2], [3]],
        np.eye(3),
        np.eye(4)[None],
        spoilt(0, 3, np.nan),
        spoilt(0, 0, np.inf),
        spoilt(0, 0, 1.001),
        spoilt(0, 0, -1),
        spoilt(3, 0, 0.1),
    ],
)
def test_what_is_not_a_rigid_transform_is_refused_and_named(T):
    with refused(InvalidTransform, "T_a_b"):
        se3.check(T, "T_a_b")


def test_a_rigid_transform_passes_as_a_copy_of_its_own():
    T = se3.random(np.random.default_rng(16))
    checked = se3.check(T, "T")
    np.testing.assert_array_equal(checked, T)
    checked[0, 3] = 9
    assert T[0, 3] != 9
    rounded = T.astype(np.float32)  # float32's rounding is no reason to refuse
    assert se3.check(rounded, "T").dtype == np.float64
    assert se3.check(np.eye(4, dtype=int).tolist(), "T").dtype == np.float64


def test_a_point_s_jacobian_is_how_it_moves_with_its_body():
    rng = np.random.default_rng(3)
    arm, small = rng.normal(size=3), 1e-6 * rng.normal(size=6)
    moved = small[:3] + se3.rotation_exp(small[3:]) @ arm - arm
    J = se3.point_jacobian(arm)
    np.testing.assert_allclose(J @ small, [*moved, *small[3:]], atol=1e-11)
    np.testing.assert_allclose(se3.point_jacobian(-arm) @ J, np.eye(6), atol=1e-12)


def test_rounded_numbers_are_the_nearest_transform_and_others_are_refused():
    T = se3.random(np.random.default_rng(0))
    for digits, near in ((T.astype(np.float32), 1e-6), (np.round(T, 4), 2e-4)):
        found = se3.rounded(digits, "T")
        np.testing.assert_allclose(found, T, atol=near)
        np.testing.assert_allclose(found[:3, :3].T @ found[:3, :3], np.eye(3), atol=1e-12)
    for wrong in (np.diag([1.0, 1, 1.01, 1]), np.diag([1.0, 1, -1, 1]), np.full((4, 4), np.nan), np.eye(3)):
        with refused(InvalidTransform, "T"):
            se3.rounded(wrong, "T")
