"""Corrections by many contacts, of which some are wrong, and of which groups share an error."""

import numpy as np
import pytest
from scipy.stats import chi2

import handsight as hs
from handsight import se3
from handsight.correction import MOST_CONTACTS, Outside, refine_pose, registration
from handsight.correction.conflicts import MOST_CONFLICTS
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.objects import nearest
from testbed.refusals import refused
from testbed.scenes import BOX, MANY, box, can, many_scene

ALONE = MANY._replace(groups=0, sigma_point=1e-3, sigma_normal=0.05)


def off(model, estimate, T):
    """Squared error by the answer's information, and the error's length [m]."""
    T = nearest(model.symmetries, T[None], estimate.T_palm_object, model.radius)[0]
    error = se3.difference(estimate.T_palm_object, T)
    return error @ estimate.information @ error, np.linalg.norm(error[:3])


def test_few_contacts_are_registered_where_the_search_finds_them():
    """A solver of its own for the same problem: the search's. Without contacts near edges, nor such as are nearly wrong,
    which the one counts by their probabilities and the other wholly."""
    compared = 0
    for seed in range(20):
        scene = many_scene(box(), np.random.default_rng(seed), ALONE._replace(contacts=40))
        places = se3.apply(se3.inverse(scene.T_palm_object), scene.contacts.points_palm)
        contacts = scene.contacts.select(on_one_face(places))
        searched = hs.correct_pose(box(), contacts, vision=scene.vision)
        problem = Problem(box(), contacts, scene.vision, NO_OUTSIDE)
        found = registration.registered(problem, searched.T_palm_object)
        if found.squares[:, 0].max() < 10:
            compared += 1
            error = se3.difference(found.row["T_palm_object"], searched.T_palm_object)
            assert error @ searched.information @ error < 0.05
            np.testing.assert_allclose(
                np.diag(found.row["covariance"]), np.diag(searched.covariance), rtol=0.1
            )
    assert compared >= 5


def on_one_face(places):
    """Whether each place (n, 3) on the box is 6 mm from all its edges."""
    return np.sort(np.array(BOX) / 2 - np.abs(places), axis=1)[:, 1] > 0.006


def test_information_is_that_of_the_whole_covariance_of_all_residuals():
    """With residuals r = J x + A e + n, e ~ N(0, S) of each group: Jᵀ (N + A S Aᵀ)⁻¹ J, all at once."""
    model, h = hs.ObjectModel.sphere(0.04), 1e-6
    scene = many_scene(model, np.random.default_rng(3), MANY._replace(contacts=60, groups=3))
    groups, shared = scene.contacts.group, scene.contacts.shared_covariance
    contacts = hs.Contacts(
        scene.contacts.points_palm, sigma_point=1.5e-4, group=groups, shared_covariance=shared
    )
    estimate = hs.correct_pose(model, contacts, vision=scene.vision)
    points, center = contacts.points_palm, estimate.T_palm_object[:3, 3]

    def distances(moved):
        return np.linalg.norm(moved - center, axis=1) - 0.04

    J, A = np.empty((60, 3)), np.zeros((60, 18))
    for k, step in enumerate(h * np.eye(6)):
        if k < 3:
            J[:, k] = (distances(points - step[:3]) - distances(points)) / h
        for g in range(3):
            own = points[groups == g]
            middle = own.mean(axis=0)
            moved = (own - middle) @ se3.rotation_exp(step[3:]).T + middle + step[:3]
            A[groups == g, 6 * g + k] = (distances(moved) - distances(own)) / h
    R = np.diag(contacts.covariance[:, 0, 0]) + A @ np.kron(np.eye(3), shared[0]) @ A.T
    touch = J.T @ np.linalg.solve(R, J)
    prior = np.linalg.inv(scene.vision.covariance)[:3, :3]
    expected = touch + prior
    np.testing.assert_allclose(estimate.information[:3, :3], expected, rtol=0.02, atol=0.02 * touch.max())


def test_groups_survive_selecting_and_joining():
    contacts = many_scene(box(), np.random.default_rng(0), MANY._replace(contacts=12, groups=3)).contacts
    rest = contacts.select(contacts.group > 0)
    assert rest.group.tolist() == [1] * 4 + [2] * 4
    both = contacts.joined(rest)
    assert both.group.tolist() == [0] * 4 + [1] * 4 + [2] * 4 + [4] * 4 + [5] * 4
    assert both.shared_covariance.shape == (6, 6, 6)
    assert contacts.joined(hs.Contacts([[0, 0, 0]])).group[-1] == -1


@pytest.mark.parametrize("n", [100, 1000, 10_000])
def test_however_many_contacts_a_group_has_they_tell_no_more_than_its_place(n):
    scene = many_scene(
        box(), np.random.default_rng(1), MANY._replace(contacts=n, groups=1, shared=(1e-3, 0.01))
    )
    one = hs.Contacts(
        *(np.asarray(x) for x in box_contacts(n)),
        1e-4,
        0.01,
        group=np.zeros(n),
        shared_covariance=scene.contacts.shared_covariance[0],
    )
    estimate = hs.correct_pose(box(), one, vision=hs.PosePrior.from_sigmas(np.eye(4), 0.1, 0.3))
    assert (np.linalg.eigvalsh(estimate.covariance - 0.9 * one.shared_covariance[0]) > 0).all()
    assert (np.sqrt(np.diag(estimate.covariance)) < 1.3 * np.repeat([1e-3, 0.01], 3)).all()


def box_contacts(n):
    """Points and normals all over the box, without error."""
    points, normals = box().sample(n)
    return points[:n], normals[:n]


@pytest.mark.parametrize("model", [box, can])
def test_regions_hold_the_truth_and_wrong_contacts_are_found(model):
    inside, found, false = [], [], []
    for seed in range(40):
        scene = many_scene(
            model(), np.random.default_rng(seed), MANY._replace(contacts=300, groups=10, wrong=0.05)
        )
        estimate = hs.correct_pose(model(), scene.contacts, vision=scene.vision)
        square, _ = off(model(), estimate, scene.T_palm_object)
        called = np.isin(np.arange(300), estimate.outliers)
        inside.append(square < chi2.ppf(0.95, 6 - len(model().symmetries.axes)))
        found.append(called[scene.wrong].mean())
        false.append(called[~scene.wrong].mean())
    assert np.mean(inside) >= 0.85  # 0.95 less three deviations of forty draws
    assert np.mean(found) > 0.85
    assert np.mean(false) < 0.01


def test_a_group_out_of_place_is_named_and_left_out():
    rng, named = np.random.default_rng(5), 0
    for _ in range(5):
        scene = many_scene(can(), rng, MANY._replace(groups=8))
        points = scene.contacts.points_palm.copy()
        points[scene.contacts.group == 2] += [0.006, 0.006, 0.0]
        contacts = hs.Contacts(
            points,
            scene.contacts.normals_palm,
            1.5e-4,
            0.03,
            group=scene.contacts.group,
            shared_covariance=scene.contacts.shared_covariance,
        )
        estimate = hs.correct_pose(can(), contacts, vision=scene.vision)
        left_out = [str(conflict) for conflict in estimate.conflicts if conflict.evidence == "group 2"]
        named += any("is left out" in sentence for sentence in left_out)
    assert named >= 4


def test_vision_far_off_is_named_and_does_not_drag_the_pose():
    scene = many_scene(box(), np.random.default_rng(2), ALONE)
    T = scene.T_palm_object.copy()
    T[:3, 3] += [0.03, 0, 0]
    estimate = hs.correct_pose(box(), scene.contacts, vision=hs.PosePrior.from_sigmas(T, 2e-3, 0.02))
    assert not estimate.consistent
    assert estimate.conflicts[0].evidence == "vision"
    assert off(box(), estimate, scene.T_palm_object)[1] < 5e-4


def test_another_object_does_not_fit():
    scene = many_scene(can(), np.random.default_rng(4), ALONE)
    assert hs.correct_pose(can(), scene.contacts, vision=scene.vision).consistent
    assert not hs.correct_pose(box(), scene.contacts, vision=scene.vision).consistent


def test_three_hundred_probings_are_enough_without_vision():
    for seed in range(3):
        scene = many_scene(box(), np.random.default_rng(seed), ALONE._replace(contacts=329, wrong=0.05))
        estimate = hs.correct_pose(box(), scene.contacts)
        assert estimate.consistent
        assert off(box(), estimate, scene.T_palm_object)[1] < 1e-3


def test_as_many_contacts_as_may_be_are_corrected():
    scene = many_scene(box(), np.random.default_rng(6), MANY._replace(contacts=MOST_CONTACTS, groups=20))
    estimate = hs.correct_pose(box(), scene.contacts, vision=scene.vision)
    assert estimate.converged
    assert estimate.consistent
    assert off(box(), estimate, scene.T_palm_object)[0] < chi2.ppf(0.999, 6)


def test_another_palm_frame_changes_nothing():
    scene, T = many_scene(box(), np.random.default_rng(7)), se3.random(np.random.default_rng(8), 1)[0]
    vision = hs.PosePrior(
        T @ scene.vision.T_palm_object, se3.rotate_covariance(T[:3, :3], scene.vision.covariance)
    )
    one = hs.correct_pose(box(), scene.contacts, vision=scene.vision)
    other = hs.correct_pose(box(), scene.contacts.moved(T), vision=vision)
    error = se3.difference(other.T_palm_object, T @ one.T_palm_object)
    assert error @ other.information @ error < 0.05


def test_a_pose_that_was_right_a_moment_ago_is_refined():
    scene = many_scene(box(), np.random.default_rng(9))
    whole = hs.correct_pose(box(), scene.contacts, vision=scene.vision)
    refined = refine_pose(box(), scene.contacts, scene.vision, whole.T_palm_object_maximum)
    error = se3.difference(refined.T_palm_object, whole.T_palm_object)
    assert error @ whole.information @ error < 0.05


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"group": [0, 0]}, "group, shared_covariance"),
        ({"shared_covariance": np.eye(6)}, "group, shared_covariance"),
        ({"group": [0], "shared_covariance": np.eye(6)}, 'group'),
        ({"group": [0, 0.5], "shared_covariance": np.eye(6)}, 'group'),
        ({"group": [0, 2], "shared_covariance": np.eye(6)}, 'group'),
        ({"group": [0, np.nan], "shared_covariance": np.eye(6)}, "group"),
        ({"group": [0, 1], "shared_covariance": [np.eye(6)]}, 'shared_covariance'),
        ({"group": [0, 1], "shared_covariance": -np.eye(6)}, 'shared_covariance'),
    ],
)  # fmt: skip
def test_wrong_groups_are_refused(given, field):
    with refused(hs.InvalidInput, field):
        hs.Contacts([[0, 0, 0], [0.01, 0, 0]], **given)


def precise_scene(seed, contacts):
    """Contacts anywhere on the box, of one error for each."""
    return many_scene(box(), np.random.default_rng(seed), ALONE._replace(contacts=contacts))


@pytest.mark.parametrize("n", [6, 60, 200])
def test_points_of_the_hand_inside_are_named_however_many_contacts_there_are(n):
    for seed in range(5):
        scene = precise_scene(seed, n)
        inside = se3.apply(scene.T_palm_object, np.array([[BOX[0] / 2 - 0.01, 0.0, 0.0]]))
        outside = Outside(inside, sigmas=1e-3)
        estimate = hs.correct_pose(box(), scene.contacts, vision=scene.vision, outside=outside)
        assert not estimate.consistent
        assert "outside" in {conflict.evidence for conflict in estimate.conflicts}


def test_contacts_that_are_rejected_are_in_conflicts_the_worst_first():
    scene = many_scene(box(), np.random.default_rng(1), ALONE._replace(contacts=200, wrong=0.05))
    estimate = hs.correct_pose(box(), scene.contacts, vision=scene.vision)
    left_out = [conflict for conflict in estimate.conflicts if conflict.excluded]
    numbers = {int(conflict.evidence.removeprefix("contact ")) for conflict in left_out}
    assert numbers
    assert numbers <= set(estimate.outliers)
    assert len(numbers) == min(len(estimate.outliers), MOST_CONFLICTS)
    squares = [conflict.chi2 for conflict in left_out]
    assert squares == sorted(squares, reverse=True)


def test_another_order_of_many_contacts_changes_nothing():
    """Of three hundred in four patches, some of them wrong."""
    patches = MANY._replace(contacts=300, groups=4, wrong=0.05, shared=(1e-7, 1e-7))
    for seed in range(8):
        scene = many_scene(can(), np.random.default_rng([3, seed]), patches)
        contacts = hs.Contacts(scene.contacts.points_palm, scene.contacts.normals_palm, 1e-3, 0.05)
        order = np.random.default_rng(seed).permutation(300)
        one = hs.correct_pose(can(), contacts, vision=scene.vision)
        other = hs.correct_pose(can(), contacts.select(order), vision=scene.vision)
        step = se3.difference(one.T_palm_object, other.T_palm_object)
        assert step @ one.information @ step < 0.05
        assert sorted(order[list(other.outliers)]) == list(one.outliers)
