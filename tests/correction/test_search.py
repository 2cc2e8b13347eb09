"""What is looked for: better modes than the one that a start led to, and wrong contacts among many."""

import functools

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight.correction import MOST_CONTACTS, MOST_PLANES, modes, refine_pose
from handsight.correction.correct import solve_single_start
from handsight.correction.kernels.search_options import ACCEPTANCE, SEARCH
from handsight.correction.modes import SAME_MODE
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.correction.solve import solve
from handsight.correction.starts import from_prior
from testbed.refusals import refused
from testbed.scenes import anywhere_on, box, can, off, on_box_faces, on_can_side, random_scene

PROFILE = np.array([[-0.02, 0], [0.08, 0], [0.08, 0.04], [0.02, 0.04], [0.02, 0.14], [-0.02, 0.14]])


@functools.cache
def bracket():
    """An L, 14 cm high and 10 cm wide, of a bar 4 cm thick."""
    ends = [np.insert(PROFILE, 1, y, axis=1) for y in (-0.02, 0.02)]
    faces = []
    for triangle in ([0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]):
        faces += [triangle, [k + 6 for k in triangle[::-1]]]
    for i in range(6):
        j = (i + 1) % 6
        faces += [[i, i + 6, j], [j, i + 6, j + 6]]
    mesh = trimesh.Trimesh(np.vstack(ends), faces)
    mesh.fix_normals()
    return hs.ObjectModel.from_mesh(mesh.vertices, mesh.faces)


def scene_on(model, seed):
    """Three contacts with normals anywhere on it, and vision about as wide as one start may do for."""
    rng = np.random.default_rng(seed)
    return random_scene(anywhere_on(model)(rng, 3), rng, error=(0.028, np.deg2rad(13.5)))


def better_near_the_truth(seed):
    """How much cheaper a descent on the fine field from the truth ends than the answer, and how far off it [m, rad]."""
    scene = scene_on(bracket(), seed)
    answer = hs.correct_pose(bracket(), scene.contacts, vision=scene.vision)
    near = refine_pose(bracket(), scene.contacts, scene.vision, scene.T_palm_object)
    if near is None or answer.outliers or not answer.consistent:
        return 0.0, 0.0, 0.0
    # The likeliest mode by its mean need not be the cheapest.
    gain = min(mode.cost for mode in answer.hypotheses) - near.hypotheses[0].cost
    return gain, *off(answer.T_palm_object_maximum, near.T_palm_object_maximum)[:2]


@pytest.mark.parametrize("seed", [2462, 4079, 5944])
def test_a_start_that_led_to_the_wrong_face_of_an_l_is_not_the_last(seed):
    gain, *_ = better_near_the_truth(seed)
    assert gain < 3


@pytest.mark.slow
def test_on_an_l_few_better_modes_are_missed():
    missed = [
        (shift, turn) for gain, shift, turn in map(better_near_the_truth, range(3000, 4000)) if gain > 3
    ]
    near = sum(shift > 0.005 for shift, _ in missed)
    far = sum(shift > SAME_MODE[0] or turn > SAME_MODE[1] for shift, turn in missed)
    print(
        f"of 1000, a mode that costs less by 3: {near} over 5 mm off, {far} that would be told as another hypothesis"
    )
    # Of 3000 33 and 1 when this was written: a descent from the truth ends where no draw of the prior leads to.
    assert near <= 13
    assert far <= 1


@pytest.mark.parametrize(("make", "touched"), [(can, on_can_side), (box, on_box_faces)])
def test_a_doubted_answer_that_a_few_starts_confirm_is_no_worse_than_that_of_many(make, touched):
    saved, model = [], make()
    for seed in range(200):
        rng = np.random.default_rng(seed)
        scene = random_scene(touched(rng, 5), rng, error=(0.022, np.deg2rad(17)))
        one = solve_single_start(Problem(model, scene.contacts, scene.vision, NO_OUTSIDE))
        if one is None:
            continue
        row, rows = one.answer, int(one.answer["rows"])
        wide = (row["width"] / SEARCH.single_start_width) ** 2
        coarse = modes.chi2_survival(row["coarse_cost"] * wide / ACCEPTANCE.coarse_factor, rows)
        fine = modes.chi2_survival(row["cost"], rows)
        if coarse < ACCEPTANCE.coarse_p or fine < ACCEPTANCE.doubt_plain_p * wide:  # it was doubted
            given = Problem(model, scene.contacts, scene.vision, NO_OUTSIDE)
            everyone = np.ones((1, len(scene.contacts)), dtype=bool)
            many = solve(given, from_prior(scene.vision, 64)[None], everyone)
            saved.append(float(row["posterior_cost"]) - float(many.minima["posterior_cost"][0]))
    assert len(saved) > 5
    assert max(saved) < 3


def test_too_many_contacts_or_planes_are_refused():
    scene = random_scene(box().sample(MOST_CONTACTS + 1), np.random.default_rng(0))
    with refused(hs.HandsightError, "contacts"):
        hs.correct_pose(box(), scene.contacts)
    few = scene.contacts.select(range(3))
    planes = [hs.correction.Plane([0, 0, -1], [0, 0, 1], 1e-3)] * (MOST_PLANES + 1)
    with refused(hs.HandsightError, "outside.planes"):
        hs.correct_pose(box(), few, vision=scene.vision, outside=hs.correction.Outside((), planes))
