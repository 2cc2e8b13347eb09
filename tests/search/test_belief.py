"""The posterior after touches, and the choice of the next one."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import pose_distances
from handsight.errors import InvalidInput
from handsight.rig import Table
from handsight.search import Belief, Touch, best_sweep, candidates, expected_information, resting
from handsight.search.belief import KEPT, contact_log_likelihoods, free_log_likelihood
from handsight.search.sweep_choice import MAX_POSES
from testbed.refusals import refused
from testbed.scenes import SWEEP_RADIUS, box, can, level_sweep, search_area, swept_touch

HEIGHTS = (0.09, 0.11)


def truth(model, seed):
    here = search_area()
    return here.poses(model, here.draw(1, np.random.default_rng(1000 + seed)))[0]


def errors(belief, T):
    shift, turn = pose_distances(belief.model, T[None], belief.pose.T_a_b)
    return float(shift[0]), float(turn[0])


MODELS = {"can": can(), "box": box()}


@functools.cache
def searched(name, seed, touches):
    """The belief after that many of the best sweeps of an object that stands still, and the truth."""
    model = MODELS[name]
    T = truth(model, seed)
    if not touches:
        return Belief(model, search_area(), seed), T
    belief, _ = searched(name, seed, touches - 1)
    rng = np.random.default_rng((seed, touches))
    return belief.after(swept_touch(model, T, best_sweep(belief, HEIGHTS, SWEEP_RADIUS), rng)), T


def test_the_information_of_a_sweep_is_zero_if_no_pose_meets_it_and_bounded_by_the_number_of_poses():
    belief = Belief(can(), search_area())
    far, high = level_sweep((1.0, -0.3), (0, 1.0)), level_sweep((-0.3, 0.0), (1.0, 0.0), height=0.2)
    sweeps = [far, high, *candidates(belief, HEIGHTS, np.random.default_rng(0))]
    told = expected_information(belief, sweeps, SWEEP_RADIUS)
    assert (told[:2] == 0).all()
    assert (told >= 0).all()
    assert told.max() <= np.log(MAX_POSES) + 1e-12
    assert (told[2:] > 0).mean() > 0.9


def test_a_sweep_with_a_certain_outcome_has_little_information():
    """Once the can is known, only the width of the bins of the outcome is left."""
    belief, T = searched("can", 0, 5)
    before = expected_information(
        Belief(can(), search_area()), [level_sweep((-0.4, T[1, 3]), (1.0, 0.0), 0.8)], SWEEP_RADIUS
    )
    after = expected_information(belief, [level_sweep((-0.4, T[1, 3]), (1.0, 0.0), 0.8)], SWEEP_RADIUS)
    assert belief.modes[0].is_certain
    assert after[0] < 0.6 * before[0]


@pytest.mark.parametrize(("name", "touches"), [("can", 4), ("box", 5)])
def test_the_most_informative_touches_find_the_object(name, touches):
    found = [errors(*searched(name, seed, touches)) for seed in range(3)]
    assert sum(shift < 0.008 and turn < np.deg2rad(8) for shift, turn in found) >= 2


def test_a_belief_after_touches_contains_the_truth():
    """Whatever was met: some of the particles are near the truth."""
    for seed in range(3):
        for touches in (1, 2, 3):
            belief, T = searched("can", seed, touches)
            shift, _ = pose_distances(can(), belief.Ts_world_object, T)
            assert shift.min() < 0.02
            assert sum(mode.probability for mode in belief.modes) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_covariance_is_as_large_as_the_error():
    """Mean NEES, in the plane, of cans whose likeliest mode is certain."""
    squared = []
    for seed in range(6):
        belief, T = searched("can", seed, 4)
        if belief.modes[0].is_certain:
            off = (T - belief.pose.T_a_b)[:2, 3]
            squared.append(off @ np.linalg.solve(belief.pose.covariance[:2, :2], off) / 2)
    assert len(squared) >= 4
    assert 0.2 < np.mean(squared) < 2.0


def test_the_object_is_not_where_a_sweep_met_nothing():
    """After a miss no pose is left that the tip would have met."""
    belief = Belief(box(), search_area())
    sweep = level_sweep((-0.3, 0.0), (1.0, 0.0), 0.6)
    free = sweep.start_world + np.arange(0, 0.6, 0.005)[:, None] * sweep.direction_world
    left = belief.after(Touch(free, SWEEP_RADIUS, 1e-3, None)).Ts_world_object
    inside = se3.apply(se3.inverse(left), free).reshape(-1, 3)
    distance = box().evaluate(inside).distance.reshape(KEPT, -1).min(axis=1)
    assert distance.min() > SWEEP_RADIUS - 4e-3


def test_a_contact_at_an_edge_is_likely_at_the_true_pose():
    """Where a ball touches an edge its normal is neither face's, and the true pose explains it all the same."""
    T = np.eye(4)
    T[2, 3] = 0.07
    diagonal = np.array([1.0, 1.0]) / np.sqrt(2)
    touch = swept_touch(
        box(), T, level_sweep(np.array([-0.03, -0.045]) - 0.2 * diagonal, diagonal), np.random.default_rng(0)
    )
    turned = T @ se3.compose(se3.rotation_exp(np.array([0, 0, np.deg2rad(45)])), np.zeros(3))
    table = Table(height=0.0)
    true, wrong = contact_log_likelihoods(box(), [touch], table, np.array([T, turned]))[:, 0]
    assert true > wrong + 3
    assert free_log_likelihood(box(), [touch], T[None])[0] > -0.5


def test_a_box_that_lies_on_another_side_is_found():
    """The search is only given that the box may stand on any of its sides."""
    Rs = resting(box())
    here = search_area(Rs=Rs)
    lying = int(np.argmin(here.center_heights(box())))
    T = here.poses(box(), np.array([[0.02, -0.03, 0.5, lying]]))[0]
    belief, rng = Belief(box(), here), np.random.default_rng(0)
    for _ in range(8):
        belief = belief.after(
            swept_touch(box(), T, best_sweep(belief, (0.03, 0.075, 0.12), SWEEP_RADIUS), rng)
        )
    shift, turn = errors(belief, T)
    assert shift < 0.01
    assert turn < np.deg2rad(8)


def test_invalid_arguments_are_named():
    belief = Belief(can(), search_area())
    for call, field in (
        (lambda: Belief("can", search_area()), "belief"),
        (lambda: Belief(can(), search_area(), -1), "belief.seed"),
        (lambda: belief.after("x"), "touch"),
        (lambda: best_sweep(belief, [], SWEEP_RADIUS), "heights"),
        (lambda: best_sweep(belief, [-0.1], SWEEP_RADIUS), "heights"),
        (lambda: best_sweep(belief, [0.1], 0.0), "radius"),
    ):
        with refused(InvalidInput, field):
            call()
    away = hs.Contacts(np.array([[2.0, 0, 0.1]]), np.array([[1.0, 0, 0]]))
    after = belief.after(Touch(np.empty((0, 3)), SWEEP_RADIUS, 1e-3, away))
    assert after.touches[0].contact_world is None  # it is of something else
