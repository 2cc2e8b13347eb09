"""The joints' constant errors are learnt from grips, and only as well as the grips measure them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

import handsight as hs
from handsight import se3
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.errors import InvalidInput
from handsight.tracking import FingertipSensors, JointOffsets, Tracker
from handsight.tracking.joint_offsets import CREEP
from oracles import correction as oracle
from testbed import scenes
from testbed.refusals import refused

SEEDS = st.integers(0, 2**32 - 1)
SIGMA, READING = np.deg2rad(1.0), np.deg2rad(0.1)
MODELS = {"can": scenes.can(), "box": scenes.box()}
VISION = np.array([0.02] * 3 + [0.2] * 3)


def no_knowledge(joints, sigma=SIGMA):
    names = tuple(f"joint {i}" for i in range(joints))
    prior = sigma**2 * np.eye(joints)
    return JointOffsets(names, np.zeros(joints), prior, prior, (READING**2 + 1e-18) * np.eye(joints))


def grip(rng, known, read_too_much, name="can"):
    """A grip by five fingers whose joints (two each, then some common ones) read too much: model, truth and what
    `after` takes, the contacts corrected by what is known."""
    model, joints = MODELS[name], len(known.joints)
    scene = scenes.random_scene((scenes.on_can_side if name == "can" else scenes.on_box_faces)(rng), rng)
    n = len(scene.contacts)
    K = 0.06 * rng.normal(size=(n, 6, joints))
    K[:, 3:] *= 10
    normals = scene.contacts.normals_palm
    tangent = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    K[:, 3:] = tangent @ K[:, 3:]
    wrong = K @ (read_too_much - known.mean)
    points = scene.contacts.points_palm + wrong[:, :3]
    by_error = K @ known.root
    covariance = scene.contacts.covariance + K @ known.covariance @ K.swapaxes(1, 2)
    contacts = hs.Contacts(points, normals + wrong[:, 3:], covariance=covariance)
    T_seen = se3.moved(scene.T_palm_object, VISION * rng.normal(size=6))
    return model, scene.T_palm_object, contacts, by_error, hs.PosePrior(T_seen, np.diag(VISION**2))


@settings(max_examples=20)
@given(SEEDS)
def test_pose_and_offsets_are_those_of_a_joint_least_squares_fit(seed):
    """Against SciPy's solver on residuals in plain NumPy, where errors are so small that all is linear."""
    rng = np.random.default_rng(seed)
    known = no_knowledge(7, 1e-4)
    model, T, contacts, by_error, prior = grip(rng, known, 1e-4 * rng.normal(size=7), "box")
    prior = hs.PosePrior(se3.moved(T, 1e-3 * VISION), prior.covariance)
    after = known.after(model, contacts, by_error, T, prior)
    K = by_error @ np.linalg.inv(known.root)
    alone = contacts.covariance - K @ known.covariance @ K.swapaxes(1, 2)
    given_alone = hs.Contacts.trusted(contacts.points_palm, contacts.normals_palm, alone)
    problem = Problem(model, given_alone, None, NO_OUTSIDE)
    roots = np.linalg.inv(np.linalg.cholesky(oracle.covariance(problem, T)))
    by_prior = np.linalg.inv(np.linalg.cholesky(prior.covariance))

    def residuals(z):
        pose = se3.moved(T, z[:6])
        change = -K @ z[6:]
        distance, _, facing, _ = oracle.surface(problem, contacts.points_palm + change[:, :3], pose)
        error = np.concatenate([distance[:, None], facing - contacts.normals_palm - change[:, 3:]], axis=1)
        seen = by_prior @ se3.difference(pose, prior.T_palm_object)
        return np.concatenate([(roots @ error[..., None]).ravel(), seen, z[6:] / 1e-4])

    found = least_squares(residuals, np.zeros(13), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
    covariance = np.linalg.inv(found.jac.T @ found.jac)[6:, 6:]
    np.testing.assert_allclose(after.mean, found.x[6:], atol=5e-6)
    np.testing.assert_allclose(
        after.covariance, covariance + (CREEP * 1e-4) ** 2 * np.eye(7), atol=0.03 * 1e-8
    )


def test_errors_of_offsets_after_many_grips_fit_their_covariance():
    """χ² of what is left, over many hands: as many as there are joints; and less is left than there was."""
    squared, left = [], []
    for hand in range(40):
        rng = np.random.default_rng(hand)
        known = no_knowledge(8)
        truth = SIGMA * rng.normal(size=8)
        for k in range(6):
            model, T, contacts, by_error, prior = grip(rng, known, truth, ("can", "box")[k % 2])
            estimate = hs.correct_pose(model, contacts, vision=prior)
            if estimate.consistent and not estimate.outliers:
                known = known.after(model, contacts, by_error, estimate.T_palm_object, prior)
        off = known.mean - truth
        squared.append(off @ np.linalg.solve(known.covariance, off))
        left.append(np.sqrt(np.mean(off**2)) / SIGMA)
    mean, spread = np.mean(squared), np.std(squared) / np.sqrt(len(squared))
    assert mean < 8 + 3 * spread
    assert np.mean(left) < 0.5


def test_offsets_that_one_grip_does_not_measure_stay_as_uncertain_as_before():
    """A joint that moves no contact, and one that moves all of them as moving the object would."""
    rng = np.random.default_rng(3)
    known = no_knowledge(3)
    model, T, contacts, by_error, prior = grip(rng, known, np.zeros(3))
    K = by_error @ np.linalg.inv(known.root)
    K[:, :, 0] = 0.0
    K[:, :, 1] = [0.1, 0, 0, 0, 0, 0]
    blind = hs.PosePrior(prior.T_palm_object, 1e6 * prior.covariance)
    after = known.after(model, contacts, K @ known.root, T, blind)
    sigma = np.sqrt(after.covariance.diagonal() - (CREEP * SIGMA) ** 2)
    np.testing.assert_allclose(sigma[:2], SIGMA, rtol=1e-3)
    assert sigma[2] < 0.7 * SIGMA
    np.testing.assert_allclose(after.mean[:2], 0, atol=1e-3 * SIGMA)


def test_a_hand_whose_joints_are_exact_has_nothing_to_learn():
    known = no_knowledge(4, 0.0)
    model, T, contacts, by_error, prior = grip(np.random.default_rng(5), known, np.zeros(4))
    after = known.after(model, contacts, by_error, T, prior)
    assert not after.mean.any()
    assert not after.covariance.any()


@given(SEEDS)
def test_joint_positions_are_corrected_by_the_known_offsets(seed):
    rng = np.random.default_rng(seed)
    known = replace(no_knowledge(3), mean=rng.normal(size=3))
    given_positions = {"joint 2": 0.5, "wrist": 1.0, "joint 0": -0.25}
    corrected = known.corrected(given_positions)
    assert list(corrected) == list(given_positions)
    assert corrected["wrist"] == 1.0
    assert corrected["joint 2"] == pytest.approx(0.5 - known.mean[2])
    assert corrected["joint 0"] == pytest.approx(-0.25 - known.mean[0])
    np.testing.assert_allclose(known.root @ known.root.T, known.covariance + READING**2 * np.eye(3))


def test_a_tracker_learns_offsets_from_its_grip_and_the_next_tracker_starts_with_them(can):
    tracker = Tracker(can.rig, MODELS["can"])
    assert not tracker.joint_offsets.mean.any()
    for observation in can.held:
        tracker.update(observation)
    learnt = tracker.joint_offsets
    before = JointOffsets.of(can.rig)
    assert np.trace(learnt.covariance) < 0.95 * np.trace(before.covariance)
    last = can.held[-1]
    plain, corrected = (FingertipSensors(can.rig).contacts(last, known).contacts for known in (None, learnt))
    moved = np.linalg.norm(plain.points_palm - corrected.points_palm, axis=1)
    assert 1e-5 < moved.max() < 5e-3
    assert np.trace(corrected.covariance.sum(axis=0)) < np.trace(plain.covariance.sum(axis=0))
    after = Tracker(can.rig, MODELS["can"], joint_offsets=learnt)
    after.update(last)
    np.testing.assert_array_equal(after.fingertips.contacts.points_palm, corrected.points_palm)


def test_offsets_of_another_hand_are_refused(can):
    with refused(InvalidInput, "joint_offsets"):
        Tracker(can.rig, MODELS["can"], joint_offsets=no_knowledge(2))
    with refused(InvalidInput, "joint_offsets"):
        Tracker(can.rig, MODELS["can"], joint_offsets=0.5)
