"""The uncertainty of an answer: information, open directions, regions, fit."""

import numpy as np
import pytest
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight._kernels import records
from handsight._kernels.evidence import prior_term, terms
from handsight._kernels.math.simd import local
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.posterior import uncertainty
from handsight._kernels.posterior.options import CALIBRATION
from handsight._kernels.records import MEASURED, OUTSIDE, PRIOR_TERM, TERM, UNCERTAINTY
from handsight.correction import modes
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import descents_at
from kept_kernels import kept
from scenes import BOX_NORMALS, BOX_POINTS, box, can, can_contacts, grasp

RADIUS = 0.09
SCALE = np.array([1.0] * 3 + [1 / RADIUS] * 3)


def covariance(deviations, seed=0):
    """A (6, 6) covariance with these deviations [m] along random axes of (δp, radius δθ)."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))[0]
    return (axes * np.square(deviations)) @ axes.T * SCALE[:, None] * SCALE


@kept
def _second_order(model, values, vectors, answers):
    u = local(UNCERTAINTY)
    u.values[:], u.vectors[:] = values, vectors
    return uncertainty.second_order_information(model[0], 0.0, answers[0], u)


@kept
def _calibrated(model, nodes, constraints, outside, descents, values, vectors):
    prior = local(PRIOR_TERM)
    prior_term.vision_prior(model[0], constraints[0].prior, prior, local(UNCERTAINTY))
    contacts, measured, hand = np.empty(0, TERM), local(MEASURED), outside.copy()
    measured.nodes = -1
    evidence = terms.Evidence(
        model[0], nodes, contacts, hand, measured, constraints[0], prior, (0.0, 0.0, 0.0)
    )
    pose, rises = pose_of(descents[0].pose), np.empty(6)
    uncertainty.calibrated_information(evidence, pose, CALIBRATION.stride, values, vectors, rises)


def along_palm_axes(information):
    """An information along the object's own axes, as it is along the palm's; whether all of it is known."""
    model, answers = np.zeros(1, records.MODEL), np.zeros(1, records.ANSWER)
    model["radius"] = RADIUS
    complete = _second_order(model, *np.linalg.eigh(modes.in_metres(information, RADIUS)), answers)
    return answers[0]["information"], complete


def secant(values, prior, T, outside=NO_OUTSIDE):
    """Information [1/m²] along x, y, z and the turns about them, calibrated by the cost of a prior and a wall."""
    thing = box()
    vision = hs.PosePrior(T, np.diag(1 / (prior * np.repeat([1.0, thing.radius**2], 3))))
    values = np.array(values, dtype=np.float64)
    _calibrated(*thing.record[:2], vision.record, outside, descents_at(T[None]), values, np.eye(6))
    return values


def test_a_slide_with_an_uncertain_turn_is_as_wide_along_the_palm_as_its_draws():
    sigma = covariance([0.03, 0.01, 0.002, 0.001, 0.004, 0.002])
    widened = np.linalg.inv(along_palm_axes(np.linalg.inv(sigma))[0])
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(6), sigma, 400_000)
    # The second order: δp = s + δθ × s.
    draws[:, :3] += np.cross(draws[:, 3:], draws[:, :3])
    measured = np.cov(draws.T)
    deviation = np.sqrt(np.diagonal(measured))
    np.testing.assert_allclose(
        widened / np.outer(deviation, deviation), measured / np.outer(deviation, deviation), atol=0.015
    )
    assert np.linalg.eigvalsh(widened - sigma).min() > -1e-12


def test_an_unknown_direction_stays_unknown_along_the_palm():
    information = np.linalg.inv(covariance([0.03, 0.01, 0.002, 0.001, 0.004, 0.002]))
    axis = np.array([0, 0, 0, 0.6, 0, 0.8])
    information -= np.outer(information @ axis, axis @ information) / (axis @ information @ axis)
    carried, complete = along_palm_axes(information)
    assert np.abs(carried @ axis).max() < 1e-9 * np.trace(carried)
    assert not complete


def test_more_information_stays_more_along_the_palm():
    rng = np.random.default_rng(3)
    less = np.linalg.inv(covariance([0.03, 0.01, 0.002, 0.001, 0.004, 0.002]))
    row = rng.normal(size=6) * 100
    more = along_palm_axes(less + np.outer(row, row))[0] - along_palm_axes(less)[0]
    assert np.linalg.eigvalsh(modes.in_metres(more, RADIUS)).min() > -1e-6


SHARP, OPEN = (
    np.array([1e8, 1e6, 1e6, 1e6, 1e6, 1e6]),
    np.array([6.25e4, 1e6, 1e6, 1e6, 1e6, 1e6]),
)
"""Deviations along x of 0.1 mm and of 4 mm."""


def test_a_gaussians_information_is_its_own_secant():
    T = se3.random(np.random.default_rng(0), spread=0.1)
    np.testing.assert_allclose(secant(OPEN, OPEN, T), OPEN, rtol=1e-6)


def test_a_bump_at_the_mode_is_not_information():
    np.testing.assert_allclose(secant(SHARP, OPEN, np.eye(4)), OPEN, rtol=1e-6)


def test_a_wall_on_one_side_of_the_mode_counts_by_half():
    wall = np.zeros(1, OUTSIDE)
    wall["point"], wall["sigma"] = (0.030, 0.001, 0.002), 1e-4
    values = secant(SHARP, OPEN, np.eye(4), wall)
    # One side rises as the slope at the mode says, the other hardly: least factor, counted with it.
    assert values[0] == pytest.approx((1 + CALIBRATION.min_factor) / 2 * 1e8)
    assert values[1] == pytest.approx(1e6)


def test_the_cost_is_evaluated_one_and_a_half_deviations_away():
    # Walls on both sides that stand 0.03 mm off: what they cost depends on how far away the cost is read.
    walls = np.zeros(2, OUTSIDE)
    walls["point"], walls["sigma"] = [(0.03003, 0.001, 0.002), (-0.03003, 0.001, 0.002)], 1e-4
    values = secant(SHARP, OPEN, np.eye(4), walls)
    assert values[0] == pytest.approx(((1.5 - 0.3) / 1.5) ** 2 * 1e8, rel=2e-3)


def test_without_vision_a_slide_has_a_probability_but_no_covariance():
    contacts, _, _ = grasp(*can_contacts(), seed=3)
    estimate = hs.correct_pose(can(), contacts)
    assert estimate.covariance is None
    assert all(h.covariance is None for h in estimate.hypotheses)
    assert sum(h.weight for h in estimate.hypotheses) == pytest.approx(1)
    assert np.abs(estimate.residuals.distance).max() < 0.003


def regions(model, points_normals, count):
    """Share of truths inside the 50 % and the 95 % region, over generated problems with true sigmas."""
    from scipy.special import chdtri

    from handsight.objects.symmetry import nearest

    inside = []
    for seed in range(count):
        contacts, vision, T = grasp(*points_normals(seed), seed)
        estimate = hs.correct_pose(model, contacts, vision=vision)
        truth = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
        delta = se3.difference(truth, estimate.T_palm_object)
        squared = delta @ estimate.information @ delta
        freedom = 6 - len(model.symmetries.axes)
        inside.append([squared < chdtri(freedom, 0.5), squared < chdtri(freedom, 0.05)])
    return np.mean(inside, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("thing", ["can", "box"])
def test_the_truth_is_in_a_region_as_often_as_its_level(thing):
    count = 200
    if thing == "can":
        half, most = regions(can(), lambda _: can_contacts(), count)
    else:
        half, most = regions(box(), lambda _: (BOX_POINTS, BOX_NORMALS), count)
    # Four standard errors of a share of 200.
    assert abs(half - 0.5) < 4 * np.sqrt(0.25 / count)
    assert abs(most - 0.95) < 4 * np.sqrt(0.95 * 0.05 / count)


@pytest.mark.slow
@pytest.mark.parametrize("error", [(0.020, np.deg2rad(15)), (0.085, np.deg2rad(30))], ids=["near", "far"])
def test_the_can_and_the_box_are_found_from_near_and_from_far(error):
    found = []
    for seed in range(60):
        for model, points, normals in ((can(), *can_contacts()), (box(), BOX_POINTS, BOX_NORMALS)):
            contacts, vision, T = grasp(points, normals, seed, error=error)
            estimate = hs.correct_pose(model, contacts, vision=vision)
            from handsight.objects.symmetry import nearest

            truth = nearest(model.symmetries, T, estimate.T_palm_object, model.radius)
            delta = se3.difference(estimate.T_palm_object, truth) * np.repeat([1.0, model.radius], 3)
            delta -= estimate.unobservable.T @ (estimate.unobservable @ delta)
            turn = np.linalg.norm(delta[3:]) / model.radius
            found.append(np.linalg.norm(delta[:3]) < 0.005 and turn < np.deg2rad(8))
    assert np.mean(found) >= 0.97


def test_whichever_contact_is_wrong_is_an_outlier():
    for wrong in range(5):
        contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, seed=20 + wrong)
        normals = contacts.normals_palm.copy()
        normals[wrong] = np.cross(normals[wrong], T[:3, 0] + 0.3 * T[:3, 1] + 0.2 * T[:3, 2])
        spoiled = hs.Contacts(contacts.points_palm, normals, sigma_point=5e-4, sigma_normal=np.deg2rad(2))
        assert hs.correct_pose(box(), spoiled, vision=vision).outliers == (wrong,)


@pytest.mark.parametrize("alarm", [0.5, 0.1, 0.05, 0.01, 1e-3, 1e-6])
def test_a_quantile_of_chi_square_is_scipys(alarm):
    for freedom in (*range(1, 40), 101, 300, 768, 5000, 60_000):
        assert modes.chi2_limit(freedom, alarm) == pytest.approx(chdtri(freedom, alarm), rel=1e-10)
