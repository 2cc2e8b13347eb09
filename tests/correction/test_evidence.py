"""What contacts and points of the hand say as evidence, judged by plain residuals (`oracles.correction`)."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import solve
from handsight.correction.outside import NO_OUTSIDE, OUTSIDE
from handsight.correction.problem import Problem, descents_at
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


def test_a_wall_has_a_cost_and_no_information():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, 3)
    hand = np.zeros(1, OUTSIDE)
    hand["point"], hand["sigma"] = se3.apply(T, np.array([[0.02, 0.0, 0.0]])), 0.002
    free = summary(Problem(box(), contacts, vision, NO_OUTSIDE), T)
    walled = summary(Problem(box(), contacts, vision, hand), T)
    assert walled["chi2"] == pytest.approx(free["chi2"] + 25)
    np.testing.assert_array_equal(walled["information"], free["information"])
