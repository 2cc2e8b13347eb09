"""What the bumps of a scan add to the information of contacts is spurious."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight._compiled import records
from handsight._compiled.jit import entry
from handsight._compiled.stack import local
from handsight._compiled.symmetry import pose_of
from handsight.correction.kernels import batch, density, spurious_information, terms
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, descents_at
from handsight.objects import Symmetries
from oracles import correction as oracle
from testbed import scenes

MEASURED, PRIOR_TERM, TERM, UNCERTAINTY = (
    records.MEASURED,
    records.PRIOR_TERM,
    records.TERM,
    records.UNCERTAINTY,
)


@functools.cache
def scan(sigma, n=3000):
    """A can as a scanner has it."""
    can = hs.ObjectModel.cylinder(0.033, 0.115)
    points, normals = can.sample(n, 5)
    return hs.ObjectModel.from_points(
        points + sigma * np.random.default_rng(2).normal(size=points.shape), normals
    )


def problem(model, seed, *, bare=False):
    """A grasp of the can, its contacts on its true side."""
    rng = np.random.default_rng(seed)
    scene = scenes.random_scene(scenes.on_can_side(rng), rng)
    contacts = scene.contacts
    if bare:
        felt = [None if i % 2 else normal for i, normal in enumerate(contacts.normals_palm)]
        contacts = hs.Contacts(contacts.points_palm, felt, sigma_point=5e-4, sigma_normal=0.035)
    return Problem(model, contacts, scene.vision, NO_OUTSIDE), scene.T_palm_object


@entry
def _information(model, nodes, contacts, constraints, outside, descents, by_touch, total):
    """Information of touch alone and of all, at a pose, and the sum of the contacts' own equations."""
    prior, measured, rows = local(PRIOR_TERM), local(MEASURED), np.empty(len(contacts), TERM)
    center = batch.load_evidence(model[0], contacts, constraints[0], rows, prior, measured)
    evidence = terms.Evidence(model[0], nodes, rows, outside, measured, constraints[0], prior, center)
    u = local(UNCERTAINTY)
    density.information(evidence, pose_of(descents[0].pose), total, u)
    by_touch[:] = u.by_touch
    whole = np.zeros((6, 6))
    for k in range(len(rows)):
        for i in range(6):
            for j in range(6):
                whole[i, j] += rows[k].equations[i, j]
    return whole


def information(given, T):
    """(6, 6) each: of touch, of all, and of touch with its spurious information."""
    by_touch, total = np.empty((6, 6)), np.empty((6, 6))
    record = given.model.record[:2]
    arrays = given.contacts.record, given.constraints, given.outside, descents_at(T[None])
    whole = _information(*record, *arrays, by_touch, total)
    return by_touch, total, whole


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("sigma", [2e-3])
def test_spurious_information_is_subtracted_and_never_more(sigma, bare):
    for seed in range(5):
        given, T = problem(scan(sigma), seed, bare=bare)
        by_touch, total, whole = information(given, T)
        scale = np.repeat([1.0, 1 / given.model.radius], 3)
        whole = np.tril(whole) + np.tril(whole, -1).T
        left = scale[:, None] * (whole - oracle.spurious_information(given, T)) * scale
        values, vectors = np.linalg.eigh(left)
        expected = vectors @ np.diag(np.maximum(values, 0)) @ vectors.T
        np.testing.assert_allclose(
            scale[:, None] * by_touch * scale, expected, rtol=0, atol=2e-6 * np.abs(expected).max()
        )
        assert np.linalg.eigvalsh(scale[:, None] * by_touch * scale).min() > -1e-9 * np.abs(expected).max()
        # Less is known, in every direction, than the equations say.
        assert np.linalg.eigvalsh(expected - left).min() > -1e-9 * np.abs(expected).max()
        assert np.linalg.eigvalsh(total).min() > 0


@entry
def _cost_deviation(model, nodes, contacts, constraints, outside, descents):
    prior, measured, rows = local(PRIOR_TERM), local(MEASURED), np.empty(len(contacts), TERM)
    center = batch.load_evidence(model[0], contacts, constraints[0], rows, prior, measured)
    evidence = terms.Evidence(model[0], nodes, rows, outside, measured, constraints[0], prior, center)
    return spurious_information.cost_deviation(evidence, pose_of(descents[0].pose))


@pytest.mark.parametrize("bare", [False, True])
@pytest.mark.parametrize("sigma", [5e-4, 2e-3])
def test_costs_vary_from_bump_to_bump_as_with_drawn_bumps(sigma, bare):
    for seed in range(3):
        given, T = problem(scan(sigma), seed, bare=bare)
        record = given.model.record[:2]
        said = _cost_deviation(
            *record, given.contacts.record, given.constraints, given.outside, descents_at(T[None])
        )
        assert said == pytest.approx(oracle.cost_deviation(given, T), rel=0.1)


@pytest.mark.parametrize("sigma", [5e-4, 1e-3])
def test_the_spin_of_a_scanned_can_is_open(sigma):
    axis_named = []
    for seed in range(12):
        given, T = problem(scan(sigma, 4000).with_symmetries(Symmetries()), seed)
        estimate = hs.correct_pose(given.model, given.contacts, vision=given.vision)
        axis = estimate.T_palm_object[:3, 2]
        lever = np.cross(-estimate.T_palm_object[:3, :3] @ given.model.center_object, axis)
        spin = np.concatenate([lever, axis * given.model.radius])
        spin /= np.linalg.norm(spin)
        named = estimate.unobservable @ spin if len(estimate.unobservable) else np.zeros(1)
        axis_named.append(np.linalg.norm(named) > 0.9)
    # Of twelve; without the subtraction it is none or one.
    assert np.mean(axis_named) > 0.7
