"""What contacts and points of the hand say as evidence, judged by plain residuals (`oracles.correction`)."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import solve
from handsight.correction.outside import NO_OUTSIDE, OUTSIDE
from handsight.correction.problem import Problem, descents_at
from oracles import correction as oracle
from testbed.scenes import BOX_NORMALS, BOX_POINTS, box, can, can_contacts, grasp

EVERYONE = np.ones((1, 5), dtype=bool)


def summary(problem, T, used=EVERYONE):
    """The ANSWER at a pose, first order."""
    return solve.summaries(problem, descents_at(T[None]), used, first_order=True)[0]


def test_contacts_are_whitened_by_their_covariance():
    # On a can's side the curvature carries point noise into the normal.
    squares = []
    for seed in range(400):
        contacts, _, T = grasp(*can_contacts(), seed)
        squares.append(summary(Problem(can(), contacts, None, NO_OUTSIDE), T)["chi2"])
    # 5 contacts, 3 degrees of freedom each: mean 15, its standard error sqrt(30 / 400).
    assert abs(np.mean(squares) - 15) < 4 * np.sqrt(30 / 400)


def test_a_contact_that_is_not_used_has_no_information():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, 3)
    fewer = np.array([[True, True, False, True, True]])
    rest = hs.Contacts(
        contacts.points_palm[fewer[0]],
        contacts.normals_palm[fewer[0]],
        covariance=contacts.covariance[fewer[0]],
    )
    left = summary(Problem(box(), contacts, vision, NO_OUTSIDE), T, fewer)
    alone = summary(Problem(box(), rest, vision, NO_OUTSIDE), T, np.ones((1, 4), dtype=bool))
    assert left["chi2"] == pytest.approx(alone["chi2"], rel=1e-12)
    assert left["rows"] == alone["rows"] == 12
    np.testing.assert_allclose(left["information"], alone["information"], rtol=1e-9, atol=1e-6)


def test_a_contact_adds_a_positive_semidefinite_matrix_at_a_fixed_pose():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, 3)
    problem = Problem(box(), contacts, vision, NO_OUTSIDE)
    whole = summary(problem, T)["information"]
    for i in range(5):
        fewer = EVERYONE.copy()
        fewer[0, i] = False
        gain = (whole - summary(problem, T, fewer)["information"]) / np.trace(whole)
        assert np.linalg.eigvalsh(gain).min() > -1e-12
        assert np.linalg.eigvalsh(gain).max() > 1e-9


def test_a_hand_point_outside_costs_nothing_and_one_inside_by_its_depth():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, 3)
    hand = np.zeros(1, OUTSIDE)
    hand["sigma"] = 0.002
    free = solve.cost(Problem(box(), contacts, vision, NO_OUTSIDE), T[None], EVERYONE)[0]
    for place, depth in (((0, 0, 0.2), 0.0), ((0.031, 0, 0), 0.0), ((0, 0, 0), 0.030), ((0.02, 0, 0), 0.010)):
        hand["point"] = se3.apply(T, np.array([place], dtype=float))
        problem = Problem(box(), contacts, vision, hand)
        cost = solve.cost(problem, T[None], EVERYONE)[0] - free
        assert cost == pytest.approx((depth / 0.002) ** 2, abs=1e-9)
        assert oracle.of_outside(problem, T)[0] == pytest.approx(depth / 0.002, abs=1e-9)


def test_a_wall_has_a_cost_and_no_information():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, 3)
    hand = np.zeros(1, OUTSIDE)
    hand["point"], hand["sigma"] = se3.apply(T, np.array([[0.02, 0.0, 0.0]])), 0.002
    free = summary(Problem(box(), contacts, vision, NO_OUTSIDE), T)
    walled = summary(Problem(box(), contacts, vision, hand), T)
    assert walled["chi2"] == pytest.approx(free["chi2"] + 25)
    np.testing.assert_array_equal(walled["information"], free["information"])
