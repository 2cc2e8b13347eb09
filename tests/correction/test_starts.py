"""Where descents begin, and that what is shared between sets of contacts is what each would work out for itself."""

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight._compiled.threads import alone
from handsight.correction import starts
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem, poses_of
from testbed.scenes import BOX_NORMALS, BOX_POINTS, NOISE, box, grasp, off, random_scene


def problem(seed=0, *, blind=False, normals=True, n=5):
    scene = random_scene(box().sample(n, seed=seed), np.random.default_rng(seed))
    felt = scene.contacts.normals_palm if normals else None
    contacts = hs.Contacts(scene.contacts.points_palm, felt, *(NOISE if normals else NOISE[:1]))
    return Problem(box(), contacts, None if blind else scene.vision, NO_OUTSIDE)


@pytest.mark.parametrize("normals", [True, False])
def test_starts_without_vision_have_a_contact_on_the_surface(normals):
    given = problem(1, blind=True, normals=normals)
    Ts = poses_of(starts.blind(given, np.ones(5, dtype=bool), prune=True).descents[::31])
    felt = given.contacts.normals_palm
    for T in Ts:
        place, normal = given.model.points_object, given.model.normals_object
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        gap = np.linalg.norm(se3.apply(T, place)[:, None] - given.contacts.points_palm, axis=-1)
        sample, contact = np.unravel_index(gap.argmin(), gap.shape)
        assert gap.min() < 1e-9
        if normals:
            np.testing.assert_allclose(T[:3, :3] @ normal[sample], felt[contact], atol=1e-6)


@pytest.mark.parametrize("blind", [True, False])
def test_the_answer_is_the_same_on_any_number_of_threads(blind):
    given = problem(4, blind=blind)
    many = hs.correct_pose(box(), given.contacts, vision=given.vision)
    with alone():
        one = hs.correct_pose(box(), given.contacts, vision=given.vision)
    np.testing.assert_array_equal(one.T_palm_object, many.T_palm_object)
    assert [h.weight for h in one.hypotheses] == [h.weight for h in many.hypotheses]


def test_without_a_wrong_contact_the_answer_is_that_of_the_others():
    for wrong in range(5):
        contacts, vision, _ = grasp(BOX_POINTS, BOX_NORMALS, seed=40 + wrong)
        points = contacts.points_palm.copy()
        points[wrong] += 0.05 * contacts.normals_palm[wrong]
        spoiled = hs.Contacts(points, contacts.normals_palm, *NOISE)
        answer = hs.correct_pose(box(), spoiled, vision=vision)
        if answer.outliers != (wrong,):
            continue  # alone on its face it may be right, and vision wrong
        rest = hs.correct_pose(box(), spoiled.select([i for i in range(5) if i != wrong]), vision=vision)
        shift, turn = off(answer.T_palm_object, rest.T_palm_object)
        assert shift < 2e-5
        assert turn < 2e-4
        np.testing.assert_allclose(answer.information, rest.information, rtol=0.02, atol=1e3)
