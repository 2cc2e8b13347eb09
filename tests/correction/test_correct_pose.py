"""What must hold of every correction, whatever the numbers."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import handsight as hs
from handsight import se3
from handsight.correction import refine_pose
from handsight.objects.symmetry import nearest
from testbed.refusals import refused
from testbed.scenes import BOX_NORMALS, BOX_POINTS, NOISE, box, can, can_contacts, grasp, off

SIGMA_POINT, SIGMA_NORMAL = NOISE

few = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
seeds = st.integers(0, 10_000)


@few
@given(seeds)
def test_moving_the_palm_frame_moves_the_answer_with_it(seed):
    contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed)
    T_new_palm = se3.random(np.random.default_rng(seed + 1), spread=0.5)
    R = T_new_palm[:3, :3]
    moved_vision = hs.PosePrior(
        T_new_palm @ vision.T_palm_object, se3.rotate_covariance(R, vision.covariance)
    )
    here = hs.correct_pose(box(), contacts, vision=vision)
    there = hs.correct_pose(box(), contacts.moved(T_new_palm), vision=moved_vision)
    shift, turn = off(there.T_palm_object, T_new_palm @ here.T_palm_object)
    assert shift < 1e-5
    assert turn < 1e-4
    expected = se3.rotate_covariance(R, here.covariance)
    np.testing.assert_allclose(there.covariance, expected, atol=1e-2 * np.abs(expected).max())


@few
@given(seeds, st.permutations(range(5)))
def test_permuting_the_contacts_changes_nothing(seed, order):
    contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed)
    plain = hs.correct_pose(box(), contacts, vision=vision)
    other = hs.correct_pose(box(), contacts.select(list(order)), vision=vision)
    shift, turn = off(other.T_palm_object, plain.T_palm_object)
    assert shift < 1e-6
    assert turn < 1e-5
    np.testing.assert_allclose(other.residuals.distance, plain.residuals.distance[list(order)], atol=1e-6)


@few
@given(seeds, st.sampled_from([0.3, 2.0, 7.0]))
def test_scaling_everything_scales_the_translation(seed, k):
    contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed)
    plain = hs.correct_pose(box(), contacts, vision=vision)
    units = np.array([k, k, k, 1, 1, 1])
    T = vision.T_palm_object.copy()
    T[:3, 3] *= k
    large = hs.correct_pose(
        hs.ObjectModel.box(k * np.array([0.060, 0.090, 0.140])),
        hs.Contacts(
            k * contacts.points_palm,
            contacts.normals_palm,
            sigma_point=k * SIGMA_POINT,
            sigma_normal=SIGMA_NORMAL,
        ),
        vision=hs.PosePrior(T, vision.covariance * units[:, None] * units),
    )
    np.testing.assert_allclose(large.T_palm_object[:3, 3], k * plain.T_palm_object[:3, 3], atol=k * 2e-5)
    assert off(large.T_palm_object, plain.T_palm_object)[1] < 1e-4


@few
@given(seeds)
def test_a_perfect_prior_with_consistent_contacts_does_not_move(seed):
    contacts, _, T = grasp(BOX_POINTS, BOX_NORMALS, seed)
    sigma = 1e-5
    estimate = hs.correct_pose(box(), contacts, vision=hs.PosePrior(T, sigma**2 * np.eye(6)))
    shift, turn = off(estimate.T_palm_object, T)
    assert shift < 4 * sigma
    assert turn < 4 * sigma
    assert np.linalg.eigvalsh(sigma**2 * np.eye(6) - estimate.covariance).min() > -1e-3 * sigma**2


@few
@given(seeds)
def test_noise_free_contacts_on_three_faces_give_the_exact_pose(seed):
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, seed, noise=0.0)
    sharp = hs.Contacts(contacts.points_palm, contacts.normals_palm, sigma_point=1e-5, sigma_normal=1e-3)
    estimate = hs.correct_pose(box(), sharp, vision=vision)
    shift, turn = off(nearest(box().symmetries, estimate.T_palm_object, T, box().radius), T)
    assert estimate.converged
    assert shift < 2e-5
    assert turn < 1e-3
    assert len(estimate.unobservable) == 0


@few
@given(seeds)
def test_a_declared_symmetry_never_yields_the_same_mode_twice(seed):
    contacts, _, _ = grasp(BOX_POINTS[:3], BOX_NORMALS[:3], seed)
    estimate = hs.correct_pose(box(), contacts)
    modes = estimate.hypotheses
    assert sum(h.weight for h in modes) == pytest.approx(1)
    for i, a in enumerate(modes):
        for b in modes[:i]:
            same = nearest(box().symmetries, a.T_palm_object, b.T_palm_object, box().radius)
            shift, turn = off(same, b.T_palm_object)
            assert shift > 0.0149 or turn > np.deg2rad(19.9)


def test_the_can_leaves_its_slide_and_its_spin_open():
    contacts, vision, T = grasp(*can_contacts(), seed=2)
    estimate = hs.correct_pose(can(), contacts, vision=vision)
    axis = estimate.T_palm_object[:3, :3] @ np.array([0, 0, 1.0])
    slide, spin = np.r_[axis, 0, 0, 0], np.r_[0, 0, 0, axis]
    assert estimate.unobservable.shape == (2, 6)
    projector = estimate.unobservable.T @ estimate.unobservable
    np.testing.assert_allclose(projector @ slide, slide, atol=0.1)
    np.testing.assert_allclose(projector @ spin, spin, atol=0.1)
    assert estimate.covariance is None
    scale = np.repeat([1.0, 1 / can().radius], 3)
    assert abs(spin @ (estimate.information * scale[:, None] * scale) @ spin) < 1e-6 * np.trace(
        estimate.information
    )


def test_an_origin_far_from_the_object_opens_no_direction():
    contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed=2)
    away = np.array([1.0, 0.0, 0.0])
    far = hs.ObjectModel.from_mesh(box().vertices + away, box().faces)
    T_vision = vision.T_palm_object @ se3.compose(np.eye(3), -away)
    # The same uncertainty of the box's middle, told of an origin a metre off.
    arm = np.eye(6)
    arm[:3, 3:] = se3.skew(vision.T_palm_object[:3, :3] @ away)
    prior = hs.PosePrior(T_vision, arm @ vision.covariance @ arm.T)
    estimate = hs.correct_pose(far, contacts, vision=prior)
    near = hs.correct_pose(box(), contacts, vision=vision)
    assert len(estimate.unobservable) == len(near.unobservable) == 0
    middle = se3.apply(estimate.T_palm_object, away[None])[0]
    assert np.linalg.norm(middle - near.T_palm_object[:3, 3]) < 1e-3


def test_along_an_open_direction_the_answer_is_the_prior_s():
    contacts, vision, _ = grasp(BOX_POINTS[:2], BOX_NORMALS[:2], seed=4, noise=0.0)
    estimate = hs.correct_pose(box(), contacts, vision=vision)
    # Of the directions that are open together, those that hardly turn.
    turning, mixed = np.linalg.svd(estimate.unobservable[:, 3:] @ estimate.unobservable[:, 3:].T)[1:]
    slides = mixed[turning < 0.2**2] @ estimate.unobservable
    assert len(slides) >= 1
    moved = estimate.T_palm_object[:3, 3] - vision.T_palm_object[:3, 3]
    for direction in slides[:, :3]:
        assert abs(direction @ moved) < 0.004


def test_contacts_that_fit_nowhere_are_called_inconsistent():
    rng = np.random.default_rng(0)
    points = 0.3 * rng.normal(size=(6, 3))
    contacts = hs.Contacts(points, sigma_point=1e-3)
    estimate = hs.correct_pose(box(), contacts, vision=hs.PosePrior.from_sigmas(np.eye(4), 0.03, 0.2))
    assert not estimate.consistent


def test_points_of_the_hand_keep_the_object_outside_of_it():
    # Three contacts on one face leave the slide to vision, which puts the box through a finger.
    points = np.array([[0.03, 0.01, 0.03], [0.03, -0.02, -0.04], [0.03, 0.0, 0.0]])
    contacts = hs.Contacts(points, np.tile([1.0, 0, 0], (3, 1)), sigma_point=1e-3, sigma_normal=0.05)
    grid = np.stack(np.meshgrid(np.linspace(-0.02, 0.02, 5), np.linspace(-0.03, 0.03, 5)), -1).reshape(-1, 2)
    finger = np.column_stack([grid[:, 0], np.full(25, 0.045), grid[:, 1]])
    T_vision = se3.compose(np.eye(3), np.array([0.0, 0.02, 0.0]))
    vision = hs.PosePrior.from_sigmas(T_vision, 0.02, 0.1)
    deepest = []
    for outside in (None, finger):
        estimate = hs.correct_pose(box(), contacts, vision=vision, outside=outside)
        inside = se3.apply(se3.inverse(estimate.T_palm_object_maximum), finger)
        deepest.append(-box().fine.evaluate(inside).distance.min())
    assert deepest[0] > 0.015
    assert deepest[1] < 0.004


@pytest.mark.parametrize("seed", range(4))
def test_refine_pose_finds_what_a_search_finds(seed):
    contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed)
    found = hs.correct_pose(box(), contacts, vision=vision)
    near = se3.moved(found.T_palm_object, np.array([1e-3, -1e-3, 5e-4, 0.01, 0.01, -0.01]))
    followed = refine_pose(box(), contacts, vision, near)
    shift, turn = off(followed.T_palm_object, found.T_palm_object)
    assert shift < 1e-6
    assert turn < 1e-5
    np.testing.assert_allclose(followed.covariance, found.covariance, atol=1e-4 * found.covariance.max())


def test_refine_pose_returns_none_where_the_evidence_does_not_fit():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, seed=3)
    turned = se3.moved(T, np.array([0, 0, 0, 0, 0, np.pi / 2]))
    assert refine_pose(box(), contacts, vision, turned) is None


def test_contacts_without_normals_are_used_by_their_points():
    contacts, vision, T = grasp(BOX_POINTS, BOX_NORMALS, seed=9, noise=0.0, error=(0.005, np.deg2rad(4)))
    bare = hs.Contacts(contacts.points_palm, sigma_point=1e-4)
    estimate = hs.correct_pose(box(), bare, vision=vision)
    assert np.isnan(estimate.residuals.normal).all()
    assert np.abs(estimate.residuals.distance).max() < 2e-4


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"method": "magic"}, "method"),
        ({"outside": [[0, 0, np.nan]]}, "outside"),
        ({"outside": [[0, 0]]}, "outside"),
        ({"vision": np.eye(4)}, "vision"),
        ({"method": "paper-lm"}, "vision"),
    ],
)
def test_each_wrong_input_is_named(arguments, field):
    contacts, _, _ = grasp(BOX_POINTS, BOX_NORMALS, seed=1)
    with refused(hs.HandsightError, field):
        hs.correct_pose(box(), contacts, **arguments)


def test_a_prior_that_is_no_pose_or_no_covariance_is_refused():
    with refused(hs.HandsightError, "vision.T_palm_object"):
        hs.PosePrior(np.diag([1.0, 2, 1, 1]), np.eye(6))
    with refused(hs.HandsightError, "vision.covariance"):
        hs.PosePrior(np.eye(4), -np.eye(6))
    with refused(hs.HandsightError, "sigma_position"):
        hs.PosePrior.from_sigmas(np.eye(4), 0, 0.1)
