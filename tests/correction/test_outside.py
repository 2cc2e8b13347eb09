"""Points of the hand that cannot be inside the object: a link counts as its deepest point, and none is left out."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight.correction import Outside, solve
from handsight.correction.outside import NO_OUTSIDE, outside_records
from handsight.correction.problem import Problem
from handsight.errors import InvalidInput
from objects.object_shapes import data_file
from testbed import scenes
from testbed.refusals import refused

EVERYONE = np.ones((1, 5), dtype=bool)


@functools.cache
def model(name):
    if name == "mustard":
        return hs.ObjectModel.from_file(data_file("ycb_meshes/006_mustard_bottle.ply"))
    return {"box": scenes.box, "can": scenes.can}[name]()


def grasp(name, seed=0):
    rng = np.random.default_rng(seed)
    return scenes.random_scene(scenes.anywhere_on(model(name))(rng, 5), rng)


def test_many_points_of_a_link_count_as_one_and_points_by_themselves_as_many():
    thing, scene = model("box"), grasp("box")
    place = se3.apply(scene.T_palm_object, np.array([[0.025, 0.0, 0.0]]))  # 5 mm deep
    free = solve.cost(
        Problem(thing, scene.contacts, scene.vision, NO_OUTSIDE), scene.T_palm_object[None], EVERYONE
    )

    def cost(**given):
        rows = outside_records(thing, scene.contacts, Outside(place.repeat(50, axis=0), sigmas=1e-3, **given))
        problem = Problem(thing, scene.contacts, scene.vision, rows)
        return float((solve.cost(problem, scene.T_palm_object[None], EVERYONE) - free)[0])

    assert cost() == pytest.approx(50 * 25)
    assert 25 <= cost(links=np.zeros(50, dtype=int)) <= 2.7 * 25
    assert cost(links=np.arange(50), slacks=0.003) == pytest.approx(50 * 4)
    assert cost(slacks=0.006) == pytest.approx(0, abs=1e-9)


def test_an_answer_is_that_of_all_points_however_many_are_far():
    thing = model("box")
    for seed in range(10):
        scene, rng = grasp("box", seed), np.random.default_rng(seed)
        near = scenes.behind_contacts(scene, 20, seed)
        far = scene.T_palm_object[:3, 3] + rng.uniform(0.2, 0.5, (300, 3))
        alone, among = (
            hs.correct_pose(thing, scene.contacts, vision=scene.vision, outside=points)
            for points in (near, np.concatenate([far[:150], near, far[150:]]))
        )
        np.testing.assert_array_equal(among.T_palm_object, alone.T_palm_object)
        np.testing.assert_array_equal(among.information, alone.information)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"points_palm": [[0, 0, np.nan]]}, "outside"),
        ({"points_palm": np.full((4, 3), 2e3)}, "outside"),
        ({"points_palm": np.zeros((10_001, 3))}, "outside"),
        ({"sigmas": 0.0}, "outside.sigmas"),
        ({"sigmas": [1.0, 2.0, 3.0]}, "outside.sigmas"),
        ({"slacks": [-1e-3, 0.0]}, "outside.slacks"),
        ({"links": [0.5, 1]}, "outside.links"),
        ({"links": [1]}, "outside.links"),
    ],
)
def test_wrong_points_of_a_hand_are_refused(given, field):
    with refused(InvalidInput, field):
        Outside(**{"points_palm": np.zeros((2, 3)), **given})


def gripped_beside_a_link(rng):
    """Of a box that is gripped by its sides and leaves a slide open: model, contacts, vision, points of a link 4 mm
    beside the box."""
    half = rng.uniform(0.015, 0.075, 3)
    points, normals = scenes.opposed(rng, half[1], flat=True)
    points = np.where(np.abs(points) <= half, points, 0.9 * np.sign(points) * half)
    link = np.column_stack([np.full(40, -half[0] - 0.004), *rng.uniform(-0.05, 0.05, (2, 40))])
    T, sigmas = se3.random(rng, spread=0.1), np.repeat([0.064, np.deg2rad(6)], 3)
    wrong = (sigmas * rng.normal(size=6)).reshape(2, 3) @ T[:3, :3].T
    vision = hs.PosePrior(se3.moved(T, wrong.ravel()), se3.rotate_covariance(T[:3, :3], np.diag(sigmas**2)))
    contacts = scenes.touched(T, (points, normals), (1.6e-3, np.deg2rad(4)), rng)
    return hs.ObjectModel.box(2 * half), contacts, vision, se3.apply(T, link)


def test_points_of_a_link_beside_the_object_do_not_make_right_contacts_wrong():
    """Amid the object they push it to the wrong side, and no start from vision's pose would come past them."""
    called_wrong = []
    for seed in range(100):
        thing, contacts, vision, link = gripped_beside_a_link(np.random.default_rng([200, seed]))
        estimate = hs.correct_pose(thing, contacts, vision=vision, outside=link)
        called_wrong += [seed] if estimate.outliers or not estimate.consistent else []
    assert len(called_wrong) <= 1, called_wrong  # a draw of contacts or of vision may really be improbable
