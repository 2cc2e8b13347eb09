"""A plane that the object cannot cross: its cost and derivative, and what it gains on simulated grasps."""

import functools

import numpy as np
import pytest
import trimesh

import handsight as hs
from handsight import se3
from handsight.correction import Outside, Plane, solve
from handsight.correction.outside import NO_OUTSIDE, outside_records
from handsight.correction.problem import Problem
from handsight.errors import InvalidInput
from testbed import scenes
from testbed.refusals import refused

EVERYONE = np.ones((1, 5), dtype=bool)


def corners(size):
    return np.array(np.meshgrid(*([[-s / 2, s / 2] for s in size]), indexing="ij")).reshape(3, -1).T


@functools.cache
def objects():
    """Models, and how far down each reaches along directions (n, 3), from its own formula."""
    ellipsoid = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    ellipsoid.apply_scale([0.03, 0.045, 0.06])
    can = scenes.CAN

    def of_can(up):
        side = np.hypot(up[:, 0], up[:, 1])
        return -can["radius"] * side - can["height"] / 2 * np.abs(up[:, 2])

    return {
        "box": (scenes.box(), lambda up: (up @ corners(scenes.BOX).T).min(axis=1), 1e-9),
        "can": (scenes.can(), of_can, 2e-5),
        "ball": (hs.ObjectModel.sphere(radius=0.04), lambda up: np.full(len(up), -0.04), 2e-6),
        # A grid's field is off its mesh by a part of a cell, and so is the point that it is followed to.
        "ellipsoid": (
            hs.ObjectModel.from_mesh(ellipsoid.vertices, ellipsoid.faces),
            lambda up: -np.linalg.norm(up * [0.03, 0.045, 0.06], axis=1),
            2e-4,
        ),
    }


def grasp(model, seed=0):
    rng = np.random.default_rng(seed)
    return scenes.random_scene(scenes.anywhere_on(model)(rng, 5), rng)


@pytest.mark.parametrize("name", ["box", "can", "ball", "ellipsoid"])
def test_a_plane_costs_how_far_the_object_reaches_below_it(name):
    model, lowest, tolerance = objects()[name]
    scene, rng, sigma = grasp(model), np.random.default_rng(1), 2e-3
    Ts = se3.random(rng, 300, spread=0.05)
    plane = Plane(rng.normal(0, 0.02, 3), rng.normal(size=3), sigma)
    height = (Ts[:, :3, 3] - plane.point_palm) @ plane.normal_palm + lowest(plane.normal_palm @ Ts[:, :3, :3])
    given = (model, scene.contacts, scene.vision)
    with_plane = solve.cost(
        Problem(*given, outside_records(*given[:2], Outside(planes=[plane]))), Ts, EVERYONE
    )
    without = solve.cost(Problem(*given, NO_OUTSIDE), Ts, EVERYONE)
    found = -sigma * np.sqrt((with_plane - without).clip(0))
    assert 100 < (height < -1e-3).sum() < 300
    np.testing.assert_allclose(found, height.clip(max=0), atol=tolerance + 1e-6)


@pytest.mark.parametrize("name", ["box", "can", "ellipsoid"])
def test_pressed_by_a_plane_the_answer_is_where_the_cost_is_least(name):
    """A wrong lever or sign of the plane's row would send the descent elsewhere."""
    model, lowest, _ = objects()[name]
    pressed = 0
    for seed in range(12):
        scene, rng = grasp(model, seed), np.random.default_rng(seed)
        up, T = se3.random(rng)[:3, 0], scene.T_palm_object
        foot = T[:3, 3] + (lowest((up @ T[:3, :3])[None])[0] + 3e-3) * up  # it would reach 3 mm below
        outside = Outside(planes=[Plane(foot, up, 1e-3)])
        vision = hs.PosePrior.from_sigmas(T, 2e-3, 0.1)
        contacts = scene.contacts.select([0])
        estimate = hs.correct_pose(model, contacts, vision=vision, outside=outside)
        found = estimate.T_palm_object_maximum
        steps = np.vstack([np.eye(6), -np.eye(6)]) * np.repeat([2e-4, 4e-3], 3)
        there = np.concatenate([found[None], se3.moved(found, steps)])
        problem = Problem(model, contacts, vision, outside_records(model, contacts, outside))
        costs = solve.cost(problem, there, np.ones((1, 1), dtype=bool))
        height = (found[:3, 3] - foot) @ up + lowest((up @ found[:3, :3])[None])[0]
        pressed += height < -1e-4
        # A grid's lowest point is a little off, and its lever with it.
        assert costs[0] < costs[1:].min() + (2e-2 if name == "ellipsoid" else 1e-3)
    assert pressed > 6


def test_a_table_keeps_an_object_that_fingers_let_slide_from_sinking_into_it():
    # Fingers on two faces across let the box slide up and down; vision says it is deep in the table it stands on.
    model, errors = scenes.box(), {True: [], False: []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        T = se3.random(rng, spread=0.1)
        scene = scenes.touched(T, scenes.across_box(rng), scenes.NOISE, rng)
        up, foot = T[:3, 2], T[:3, 3] - scenes.BOX[2] / 2 * T[:3, 2]
        sunk = se3.compose(T[:3, :3], T[:3, 3] - 0.02 * up)
        vision = hs.PosePrior.from_sigmas(sunk, 0.02, 0.1)
        for known in (True, False):
            outside = Outside(planes=[Plane(foot, up, 1e-3)]) if known else None
            estimate = hs.correct_pose(model, scene, vision=vision, outside=outside)
            assert estimate.converged
            errors[known].append((estimate.T_palm_object_maximum[:3, 3] - T[:3, 3]) @ up)
    rms = {known: float(np.sqrt(np.mean(np.square(e)))) for known, e in errors.items()}
    assert rms[True] < 0.003 < 0.015 < rms[False]


def test_a_plane_below_the_object_changes_nothing():
    scene = grasp(scenes.box(), 3)
    below = scene.T_palm_object[:3, 3] - [0, 0, 0.3]
    free = hs.correct_pose(scenes.box(), scene.contacts, vision=scene.vision)
    outside = Outside(planes=[Plane(below, [0, 0, 1], 1e-3)])
    with_plane = hs.correct_pose(scenes.box(), scene.contacts, vision=scene.vision, outside=outside)
    np.testing.assert_allclose(with_plane.T_palm_object, free.T_palm_object, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"point_palm": [0, 0], "normal_palm": [0, 0, 1], "sigma": 1e-3}, "plane.point_palm"),
        ({"point_palm": [0, 0, 0], "normal_palm": [0, 0, 0], "sigma": 1e-3}, "plane.normal_palm"),
        ({"point_palm": [0, 0, 0], "normal_palm": [0, 0, 1], "sigma": 0}, "plane.sigma"),
    ],
)
def test_a_wrong_plane_is_refused(given, field):
    with refused(InvalidInput, field):
        Plane(**given)


def test_planes_are_a_list():
    for planes in (Plane([0, 0, 0], [0, 0, 1], 1e-3), [[0, 0, 1]], 5):
        with refused(InvalidInput, "outside.planes"):
            Outside(planes=planes)
