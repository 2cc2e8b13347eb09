"""The object's origin is within 30 cm of the palm: the row is the residual's derivative, and poses obey it."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight._kernels.evidence import reach_term
from handsight._kernels.math.symmetry import pose_of
from handsight.correction.problem import descents_at
from kept_kernels import kept


@kept
def _reach(descents, equations):
    pose = pose_of(descents[0].pose)
    equations[:] = 0.0
    reach_term.add_reach(pose, ((0.1, 0.2, 0.3), 0.05), equations)
    return reach_term.reach_cost(pose)


def residual(T):
    return max(np.linalg.norm(T[:3, 3]) - 0.3, 0.0) / 0.01


@pytest.mark.parametrize("seed", range(5))
def test_the_row_is_the_derivative_of_the_residual(seed):
    T, equations = se3.random(np.random.default_rng(seed), spread=0.3), np.empty((7, 8))
    assert _reach(descents_at(T[None]), equations) == pytest.approx(residual(T) ** 2)
    center, h = np.array([0.1, 0.2, 0.3]), 1e-6
    gradient = []
    for k in range(6):
        step = h * np.eye(6)[k]
        shift, turn = step[:3], step[3:] / 0.05
        ends = []
        for sign in (1, -1):
            R = se3.rotation_exp(sign * turn)
            p = R @ (T[:3, 3] - center) + center + sign * shift
            ends.append(residual(se3.compose(R @ T[:3, :3], p)))
        gradient.append((ends[0] - ends[1]) / (2 * h))
    np.testing.assert_allclose(equations[6, :6], residual(T) * np.array(gradient), rtol=1e-5, atol=1e-6)


def test_a_pose_that_vision_has_out_of_reach_comes_back():
    model = hs.ObjectModel.sphere(0.03)
    contacts = hs.Contacts([[0.5, 0.0, 0.0]], sigma_point=0.1)
    far = hs.PosePrior.from_sigmas(se3.compose(np.eye(3), np.array([0.5, 0.0, 0.0])), 0.05, 0.3)
    estimate = hs.correct_pose(model, contacts, vision=far)
    assert np.linalg.norm(estimate.T_palm_object[:3, 3]) < 0.32
