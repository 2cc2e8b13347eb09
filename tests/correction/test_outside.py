"""Points of the hand that cannot be inside the object: a link counts as its deepest point, and none is left out."""

import functools

import numpy as np
import pytest

import handsight as hs
from handsight import se3
from handsight._kernels.evidence import outside_term, terms
from handsight._kernels.jit import entry
from handsight._kernels.math.stack import local
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import apply_inverse, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.records import MEASURED, OBJECT_WEIGHT, PRIOR_TERM, TERM
from handsight.correction import Outside, solve
from handsight.correction.outside import NO_OUTSIDE, outside_records
from handsight.correction.problem import Problem, descents_at
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


def hand(thing, rng, count=60, links=6):
    """A cloud around the object, some of it inside, its links in no order."""
    spread = 0.8 * np.ptp(thing.bounds_object, axis=0)
    points = thing.center_object + spread * rng.uniform(-1, 1, (count, 3))
    return Outside(
        points, sigmas=rng.uniform(1e-3, 4e-3, count), links=rng.integers(links, size=count) - 2,
        slacks=rng.uniform(0, 4e-3, count),
    )  # fmt: skip


@entry
def _costs(model, nodes, outside, descents, coarse, costs):
    """Of a walk through poses: what all points cost, each pose by itself, and what those cost that are reachable."""
    contacts, nothing, center = np.empty(0, TERM), local(PRIOR_TERM), (0.0, 0.0, 0.0)
    weight, measured, hand = local(OBJECT_WEIGHT), local(MEASURED), outside.copy()
    measured.nodes = -1
    field = model[0].coarse if coarse else model[0].fine
    evidence = terms.Evidence(model[0], nodes, contacts, hand, measured, weight, nothing, center)
    for k in range(len(descents)):
        pose = pose_of(descents[k].pose)
        costs[k, 1] = outside_term.outside_cost(evidence, field, pose)
        costs[k, 2] = 0
        for i in range(len(hand)):
            costs[k, 2] += hand[i].clearance <= measured.move
        costs[k, 0], total = 0.0, 0.0
        for i in range(len(hand)):  # the points of a link follow each other
            place = apply_inverse(pose, vector(outside[i].point))
            depth = -(field_at(nodes, field, place)[0] + outside[i].slack) / outside[i].sigma
            total += max(depth, 0.0) ** outside_term.POWER
            if i == len(hand) - 1 or outside[i + 1].link != outside[i].link:
                costs[k, 0] += total ** (2 / outside_term.POWER)
                total = 0.0


@pytest.mark.parametrize("name", ["box", "can", "mustard"])
@pytest.mark.parametrize("coarse", [False, True])
def test_points_that_are_skipped_as_far_cost_nothing(name, coarse):
    thing, scene = model(name), grasp(name)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rows = outside_records(thing, scene.contacts, hand(thing, rng, 300))
        rows["point"] = se3.apply(scene.T_palm_object, rows["point"])
        # Steps of a millimetre to a decimetre, and back.
        sizes = 10 ** rng.uniform(-3.5, -1, (60, 1)) * np.repeat([1.0, 5.0], 3)
        Ts = se3.moved(scene.T_palm_object[None].repeat(60, axis=0), sizes * rng.normal(size=(60, 6)))
        costs = np.empty((60, 3))
        _costs(*thing.record[:2], rows, descents_at(Ts), coarse, costs)
        np.testing.assert_allclose(costs[:, 1], costs[:, 0], rtol=1e-12)
        assert costs[:, 0].max() > 1
        assert costs[:, 2].min() < 200


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
