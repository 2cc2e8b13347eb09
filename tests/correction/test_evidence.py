"""Each residual's Jacobian is its derivative, and each whitening is its covariance."""

import numpy as np
import pytest
from handsight.correction.two_phase import Problem

from handsight import se3
from handsight.correction import sight, two_phase
from scenes import BOX_NORMALS, BOX_POINTS, box, can, can_contacts, grasp

STEP = 1e-6


def problem(model, points, normals, *, seed=3, outside=None):
    contacts, vision, T = grasp(points, normals, seed)
    hand = np.empty((0, 3)) if outside is None else se3.apply(T, outside)
    return Problem(model, contacts, vision, hand), T


def central_differences(term, T):
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = STEP
        forward, _ = term.linearize(se3.moved(T, step)[None])
        backward, _ = term.linearize(se3.moved(T, -step)[None])
        columns.append((forward[0] - backward[0]) / (2 * STEP))
    return np.stack(columns, axis=1)


def terms():
    p, T = problem(box(), BOX_POINTS, BOX_NORMALS, outside=np.array([[0.02, 0.0, 0.0], [0.0, 0.04, 0.06]]))
    q, T_can = problem(can(), *can_contacts())
    used = np.ones((1, 5), dtype=bool)
    near = se3.moved(T, np.array([0.002, -0.001, 0.003, 0.02, -0.03, 0.01]))
    far = se3.moved(T, np.array([0.02, 0.01, -0.03, 0.4, -0.3, 0.5]))
    near_can = se3.moved(T_can, np.array([0.002, -0.001, 0.003, 0.02, -0.03, 0.01]))
    far_can = se3.moved(T_can, np.array([0.02, 0.01, -0.03, 0.4, -0.3, 0.5]))
    coarse_box, coarse_can = p.touch(p.model.coarse, used), q.touch(q.model.coarse, used)
    yield pytest.param(q.touch(q.model.fine, used).frozen(near_can[None]), near_can, id="touch, exact can")
    yield pytest.param(p.touch(p.model.fine, used).frozen(near[None]), near, id="touch, exact box")
    yield pytest.param(coarse_box.frozen(near[None]), near, id="touch, coarse box near")
    yield pytest.param(coarse_box.frozen(far[None]), far, id="touch, coarse box far")
    yield pytest.param(coarse_can.frozen(far_can[None]), far_can, id="touch, coarse can far")
    yield pytest.param(p.sight[0], near, id="vision near")
    yield pytest.param(p.sight[0], far, id="vision far")
    yield pytest.param(q.sight[0], near_can, id="vision of a can near")
    yield pytest.param(q.sight[0], far_can, id="vision of a can far")
    yield pytest.param(q.sight[0], q.vision.T_palm_object, id="vision of a can at its own pose")
    yield pytest.param(p.hand(p.model.coarse)[0], near, id="outside")


@pytest.mark.parametrize(("term", "T"), list(terms()))
def test_the_jacobian_is_the_derivative_of_the_residual(term, T):
    _, jacobian = term.linearize(T[None])
    numeric = central_differences(term, T)
    scale = np.abs(numeric).max()
    assert scale > 0
    np.testing.assert_allclose(jacobian[0], numeric, rtol=1e-4, atol=1e-5 * scale)


def test_the_whitening_is_the_root_of_the_residuals_covariance_under_measured_noise():
    # A can on its side: the curvature carries point noise into the normal.
    p, T = problem(can(), *can_contacts())
    used = np.ones((1, 5), dtype=bool)
    points, normals = can_contacts()
    rng = np.random.default_rng(0)
    squares = []
    for _ in range(400):
        contacts, _, T = grasp(points, normals, rng.integers(1 << 30))
        q = Problem(can(), contacts, None, np.empty((0, 3)))
        residuals, _ = q.touch(q.model.fine, used).linearize(T[None])
        squares.append((residuals**2).sum())
    # 5 contacts, 3 degrees of freedom each: mean 15, its standard error sqrt(30 / 400).
    assert abs(np.mean(squares) - 15) < 4 * np.sqrt(30 / 400)


def test_a_contact_left_out_adds_nothing():
    p, T = problem(box(), BOX_POINTS, BOX_NORMALS)
    used = np.array([[True, True, False, True, True]])
    residuals, jacobian = p.touch(p.model.fine, used).linearize(T[None])
    rows = residuals.reshape(5, 4), jacobian.reshape(5, 4, 6)
    assert not rows[0][2].any()
    assert not rows[1][2].any()
    assert rows[1][1].any()


def test_a_contact_adds_a_positive_semidefinite_matrix_at_a_fixed_pose():
    p, T = problem(box(), BOX_POINTS, BOX_NORMALS)
    everyone = np.ones((1, 5), dtype=bool)
    whole, by_touch, _, _ = two_phase.posterior(p, T[None], everyone)
    for i in range(5):
        fewer = everyone.copy()
        fewer[0, i] = False
        less, _, _, _ = two_phase.posterior(p, T[None], fewer)
        gain = (whole - less)[0] / np.trace(whole[0])
        assert np.linalg.eigvalsh(gain).min() > -1e-12
        assert np.linalg.eigvalsh(gain).max() > 1e-9


def test_vision_says_nothing_about_a_spin_of_the_can():
    q, T = problem(can(), *can_contacts())
    vision = q.sight[0]
    axis = T[:3, :3] @ np.array([0, 0, 1.0])
    residuals, jacobian = vision.linearize(T[None])
    spun = se3.moved(T, np.r_[0, 0, 0, 1.3 * axis])
    np.testing.assert_allclose(vision.linearize(spun[None])[0], residuals, atol=1e-9)
    np.testing.assert_allclose(jacobian[0] @ np.r_[0, 0, 0, axis], 0, atol=1e-7 * np.abs(jacobian).max())


def test_vision_of_an_axis_away_from_the_origin_does_not_fix_where_a_spin_carries_the_origin():
    point, direction = np.array([0.03, -0.02, 0.0]), np.array([0.0, 0, 1])
    from handsight.objects import Symmetries

    rng = np.random.default_rng(1)
    T_vision, T = se3.random(rng, spread=0.1), se3.random(rng, spread=0.1)
    term = sight.vision(T_vision, np.diag([50.0] * 3 + [5.0] * 3), Symmetries(axes=((point, direction),)))
    turn = se3.compose(se3.rotation_exp(0.8 * direction), np.zeros(3))
    about = se3.compose(np.eye(3), point) @ turn @ se3.compose(np.eye(3), -point)
    before, after = (term.linearize(pose[None])[0] for pose in (T, T @ about))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_a_hand_point_outside_costs_nothing_and_one_inside_costs_its_depth():
    p, T = problem(box(), BOX_POINTS, BOX_NORMALS, outside=np.array([[0.0, 0, 0.2], [0.0, 0.0, 0.0]]))
    term = p.hand(p.model.fine)[0]
    residuals, jacobian = term.linearize(T[None])
    assert residuals[0, 0] == 0
    assert not jacobian[0, 0].any()
    assert residuals[0, 1] == pytest.approx(-0.030 / term.sigma)


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 0.3, 2.0, 3.1])
def test_a_swing_carries_one_axis_to_the_other(angle):
    rng = np.random.default_rng(5)
    start = rng.normal(size=3)
    start /= np.linalg.norm(start)
    across = np.cross(start, rng.normal(size=3))
    end = se3.rotation_exp(angle * across / np.linalg.norm(across)) @ start
    turn, derivative = sight.swing(start, end[None])
    np.testing.assert_allclose(se3.rotation_exp(turn[0]) @ start, end, atol=1e-9)
    np.testing.assert_allclose(derivative[0] @ end, 0, atol=1e-9)


def test_the_cost_is_that_of_the_full_linearisation():
    outside = np.array([[0.02, 0.0, 0.0], [0.0, 0.04, 0.06]])
    p, T = problem(box(), BOX_POINTS, BOX_NORMALS, outside=outside)
    rng = np.random.default_rng(0)
    poses = se3.moved(np.repeat(T[None], 20, axis=0), 0.02 * rng.normal(size=(20, 6)))
    for used in (np.ones((1, 5), dtype=bool), np.array([[True, False, True, True, True]])):
        whole = two_phase.posterior(p, poses, used)[3]
        np.testing.assert_allclose(two_phase.cost(p, poses, used), whole, rtol=1e-9)
