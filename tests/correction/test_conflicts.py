"""Who contradicts whom: vision, a finger, the weight and the hand's points, each against the rest."""

import json

import numpy as np
import pytest

import handsight as hs
from batch.box_problem import BOX, changed
from handsight import se3
from handsight.batch.problems import Reader, answer_text
from handsight.correction import Outside, Plane, WeightEvidence, refine_pose
from handsight.gaussian_pose import GaussianPose
from testbed.scenes import ERROR, NOISE, box, can, on_box_faces, on_can_side, random_scene, region, touched

SIGMA = np.repeat([3.3e-4, np.deg2rad(1)], 3)
"""Of a narrow prior, per axis: .33 mm and 1°."""
PRECISE = (2e-4, float(np.deg2rad(1)))
"""Of a contact against it, per axis."""


def narrow(seed, n, sigmas_off, noise=1.0):
    """Contacts on three faces of the box, a prior off by so many of its sigmas along a contact's normal, and the truth."""
    rng = np.random.default_rng([seed, n])
    T, surface = se3.random(rng, spread=0.1), on_box_faces(rng, n)
    contacts = touched(T, surface, PRECISE, rng)
    error = noise * SIGMA * rng.normal(size=6)
    error[:3] += sigmas_off * SIGMA[0] * (T[:3, :3] @ surface[1][0])
    return contacts, hs.PosePrior(se3.moved(T, error), np.diag(SIGMA**2)), T


def named(estimate):
    """The evidence that is named, and whether it is still in use."""
    return {c.evidence for c in estimate.conflicts if not c.excluded}


@pytest.mark.parametrize("n", [10, 20, 40])
@pytest.mark.parametrize("sigmas_off", [8, 10])
def test_a_prior_that_many_contacts_contradict_is_named(n, sigmas_off):
    """And no contact is blamed, but for one in 1000 by chance."""
    left_out = 0
    for seed in range(12):
        contacts, vision, _ = narrow(seed, n, sigmas_off)
        found = hs.correct_pose(box(), contacts, vision=vision)
        assert not found.consistent
        left_out += len(found.outliers)
        (conflict,) = [each for each in found.conflicts if not each.excluded]
        assert conflict.evidence == "vision"
        assert conflict.against == "contacts"
        assert conflict.p_value < 1e-4
        assert conflict.freedom == 6
    assert left_out <= 1


def test_the_offset_of_a_prior_is_what_it_is_off():
    contacts, vision, T = narrow(0, 40, 15, noise=0.0)
    (conflict,) = hs.correct_pose(box(), contacts, vision=vision).conflicts
    off = conflict.offset - se3.difference(T, vision.T_palm_object)
    assert np.linalg.norm(off[:3]) < 4e-4
    assert np.linalg.norm(off[3:]) < 0.01
    assert 12 < np.sqrt(conflict.chi2) < 18
    assert str(conflict).startswith("vision contradicts contacts by 1")


def test_the_fall_of_chi2_is_that_of_the_innovation_where_all_is_linear():
    """On a box's faces: rᵀ (R + P)⁻¹ r of vision's pose and that of the contacts, found with hardly any prior."""
    contacts, vision, T = narrow(3, 20, 12)
    (conflict,) = hs.correct_pose(box(), contacts, vision=vision).conflicts
    blind = hs.correct_pose(box(), contacts, vision=hs.PosePrior.from_sigmas(T, 0.1, 0.5))
    innovation = se3.difference(blind.T_palm_object, vision.T_palm_object)
    square = innovation @ np.linalg.solve(vision.covariance + blind.covariance, innovation)
    assert conflict.chi2 == pytest.approx(square, rel=0.05)


def test_a_prior_that_is_contradicted_hardly_moves_the_answer():
    """Five contacts on a box, and vision 12 sigma off: the answer is within what contacts alone would give."""
    off, inside, count = [], 0, 0
    for seed in range(20):
        rng = np.random.default_rng([5, seed])
        T, surface = se3.random(rng, spread=0.1), on_box_faces(rng, 6)
        contacts = touched(T, surface, (1e-3, NOISE[1]), rng)
        error = SIGMA * rng.normal(size=6)
        error[:3] += 30 * SIGMA[0] * (T[:3, :3] @ surface[1][0])
        found = hs.correct_pose(box(), contacts, vision=hs.PosePrior(se3.moved(T, error), np.diag(SIGMA**2)))
        if named(found) != {"vision"}:
            continue
        along = T[:3, :3] @ surface[1][0]
        off.append(abs((found.T_palm_object[:3, 3] - T[:3, 3]) @ along))
        inside += region(box(), found, T)["in 95%"]
        count += 1
        assert not found.consistent
        assert found.covariance[0, 0] > SIGMA[0] ** 2
    assert count > 10
    assert np.median(off) < 1.5e-3
    assert inside > 0.7 * count


def test_all_functions_that_correct_name_the_same():
    contacts, vision, T = narrow(1, 20, 10)
    single = hs.correct_pose(box(), contacts, vision=vision)
    (batched,) = hs.correct_poses(box(), [(contacts, vision)])
    assert not batched.consistent
    assert [str(c) for c in batched.conflicts] == [str(c) for c in single.conflicts]
    assert refine_pose(box(), contacts, vision, T) is None


@pytest.mark.parametrize("wide", [False, True])
def test_honest_evidence_is_called_inconsistent_no_more_often_than_its_level(wide):
    """Over all tests together one in a thousand; 14 of 5 000 have a probability of 2e-4 then."""
    error, alarms, total = (ERROR if wide else (1e-3, np.deg2rad(1.5))), 0, 0
    for model, surface in ((box(), on_box_faces), (can(), on_can_side)):
        for n, count in ((3, 1000), (6, 1000), (40, 500)):
            rng = np.random.default_rng([n, count])
            scenes = [random_scene(surface(rng, n), rng, error=error) for _ in range(count)]
            for found in hs.correct_poses(model, [(s.contacts, s.vision) for s in scenes]):
                alarms += not found.consistent
                total += 1
                assert found.consistent or found.conflicts or not found.outliers
    assert alarms < 14
    assert total == 5000


def all_evidence(wrong, seed=0):
    """Arguments of a correction of the box by vision, six contacts, and the weight, one of them wrong."""
    rng = np.random.default_rng(seed)
    T = se3.random(rng, spread=0.1)
    contacts = touched(T, on_box_faces(rng, 6), NOISE, rng)
    if wrong == "finger":
        points = contacts.points_palm.copy()
        points[2] += 0.006 * contacts.normals_palm[2]
        contacts = hs.Contacts(points, contacts.normals_palm, sigma_point=NOISE[0], sigma_normal=NOISE[1])
    sigma = np.repeat([2e-3, np.deg2rad(2)], 3)
    off = 10 * sigma[0] * T[:3, :3] @ np.ones(3) / np.sqrt(3)
    T_vision = se3.moved(T, sigma * rng.normal(size=6) + np.r_[off * (wrong == "vision"), np.zeros(3)])
    center = T[:3, 3] + 1e-3 * rng.normal(size=3) + (0.5 * off if wrong == "weight" else 0)
    return {
        "contacts": contacts,
        "vision": hs.PosePrior(T_vision, np.diag(sigma**2)),
        "weight": WeightEvidence(np.zeros(3), center, 1e-6 * np.eye(3)),
    }


@pytest.mark.parametrize("wrong", ["", "vision", "finger", "weight"])
def test_who_contradicts_whom_is_right(wrong):
    for seed in range(5):
        found = hs.correct_pose(box(), **all_evidence(wrong, seed))
        who = {c.evidence: c for c in found.conflicts}
        assert set(who) == ({"contact 2" if wrong == "finger" else wrong} if wrong else set())
        if wrong == "weight":
            assert found.weight_fits is False
            assert who["weight"].excluded
        elif wrong == "finger":
            assert found.outliers == (2,)
            assert who["contact 2"].excluded
            assert who["contact 2"].offset[0] == pytest.approx(0.006, abs=0.002)
            assert "and is left out" in str(who["contact 2"])
        else:
            assert found.weight_fits is True
        assert found.consistent == (wrong != "vision")


def test_an_answer_as_json_has_its_conflicts():
    right = json.loads(answer_text(Reader("."), json.dumps(BOX).encode()))
    assert right["conflicts"] == []
    off = changed("vision", {**BOX["vision"], "sigma_position": 0.001, "sigma_rotation_deg": 0.5})
    (conflict, *_) = json.loads(answer_text(Reader("."), json.dumps(off).encode()))["conflicts"]
    assert conflict["evidence"] == "vision"
    assert conflict["message"].startswith("vision contradicts contacts by ")
    assert set(conflict) == {"evidence", "against", "chi2", "freedom", "p_value", "excluded", "message"}


@pytest.mark.parametrize("far", [0.005, 0.05])
@pytest.mark.parametrize("negated", [False, True])
def test_normals_that_all_point_inwards_are_told(far, negated):
    """As of a sensor that reports the direction of its own force."""
    model = hs.ObjectModel.box((0.06, 0.09, 0.14))
    told = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points, normals = model.sample(5, seed=seed)
        signs = -1.0 if negated else 1.0
        contacts = hs.Contacts(points + 5e-4 * rng.normal(size=points.shape), signs * normals, 5e-4, 0.05)
        T = se3.moved(np.eye(4), np.concatenate([far * rng.normal(size=3), 0.1 * rng.normal(size=3)]))
        estimate = hs.correct_pose(model, contacts, vision=hs.PosePrior.from_sigmas(T, far, 0.1))
        told += any(conflict.evidence == "normals" for conflict in estimate.conflicts)
        assert not any(c.evidence == "normals" and estimate.consistent for c in estimate.conflicts)
    assert told >= 8 if negated else told == 0


def two_wrong(rng, n, first, second):
    """Contacts on three faces of the box, of which 1 and 4 are off along their normals [m], and the truth."""
    T = se3.random(rng, spread=0.1)
    contacts = touched(T, on_box_faces(rng, n), NOISE, rng)
    points = contacts.points_palm.copy()
    points[1] += first * contacts.normals_palm[1]
    points[4] += second * contacts.normals_palm[4]
    return hs.Contacts(points, contacts.normals_palm, *NOISE), T


def test_each_contact_that_is_left_out_has_its_own_chi2():
    """Two of eight, one of them twice as far off as the other."""
    compared = 0
    for seed in range(10):
        contacts, T = two_wrong(np.random.default_rng([5, seed]), 8, 0.012, 0.024)
        estimate = hs.correct_pose(box(), contacts, vision=hs.PosePrior.from_sigmas(T, 2e-3, 0.03))
        squares = {c.evidence: c.chi2 for c in estimate.conflicts if c.excluded}
        if set(squares) == {"contact 1", "contact 4"}:
            compared += 1
            assert squares["contact 4"] > 2 * squares["contact 1"]
    assert compared >= 5


@pytest.mark.parametrize("kind", ["planes", "links", "points"])
def test_what_honestly_touches_the_object_raises_no_alarm(kind):
    """Planes on all sides, ten links and fifty points by themselves, each beyond the surface or before it by its noise."""
    alarms = 0
    for seed in range(100):
        rng = np.random.default_rng([6, seed])
        T, sigma = se3.random(rng, spread=0.1), np.repeat([2e-3, 0.03], 3)
        contacts = touched(T, on_box_faces(rng, 6), (1e-3, 0.05), rng)
        vision = hs.PosePrior(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2))
        if kind == "planes":
            directions = np.concatenate([np.eye(3), -np.eye(3)])
            surface = directions * box().bounds_object[1]
        else:
            surface, directions = box().sample(10 if kind == "links" else 50, seed=seed)
        normals = -directions @ T[:3, :3].T
        points = se3.apply(T, surface) + 1e-3 * rng.normal(size=(len(surface), 1)) * normals
        if kind == "planes":
            planes = [Plane(point, normal, 1e-3) for point, normal in zip(points, normals, strict=True)]
            outside = Outside((), planes=planes)
        else:
            outside = Outside(points, sigmas=1e-3)
        alarms += not hs.correct_pose(box(), contacts, vision=vision, outside=outside).consistent
    assert alarms <= 2  # one in a thousand; three of a hundred have a probability of 2e-4


def test_a_second_smaller_wrong_contact_is_found_too():
    found, innocent = 0, 0
    for seed in range(40):
        rng = np.random.default_rng([7, seed])
        contacts, T = two_wrong(rng, 9, 0.03, 0.012)
        T_vision = se3.moved(T, np.repeat([3e-3, 0.03], 3) * rng.normal(size=6))
        vision = hs.PosePrior.from_sigmas(T_vision, 3e-3, 0.03)
        estimate = hs.correct_pose(box(), contacts, vision=vision)
        found += {1, 4} <= set(estimate.outliers)
        innocent += len(set(estimate.outliers) - {1, 4})
    assert found >= 34
    assert innocent <= 4


def test_a_pose_is_gaussian_about_the_middle_of_the_object_wherever_its_origin_is():
    """A mesh and the same one with its origin 350 mm beside it: the same problem has the same answer."""
    vertices, faces = box().vertices, box().faces
    near = hs.ObjectModel.from_mesh(vertices, faces)
    off = np.array([0.35, 0.0, 0.0])
    far = hs.ObjectModel.from_mesh(vertices + off, faces)
    T_near_far = se3.compose(np.eye(3), -off)
    for seed in range(8):
        rng = np.random.default_rng([8, seed])
        T = se3.random(rng, spread=0.1)
        contacts = touched(T, on_box_faces(rng, 8), NOISE, rng)
        sigma = np.repeat([0.01, np.deg2rad(15)], 3)
        vision = GaussianPose(se3.moved(T, sigma * rng.normal(size=6)), np.diag(sigma**2))
        one = hs.correct_pose(near, contacts, vision=vision)
        other = hs.correct_pose(far, contacts, vision=vision.at_point(-off))
        step = se3.difference(other.T_palm_object @ se3.inverse(T_near_far), one.T_palm_object)
        assert step @ one.information @ step < 1
        assert one.consistent == other.consistent
