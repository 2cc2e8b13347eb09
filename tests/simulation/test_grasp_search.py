"""The search for a grasp: postures against the simulator's own kinematics, failures told, files, and what is held."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from handsight.errors import InvalidFile, NotWritten
from handsight.simulation import Scenario, find_grasp, grasp_search, read_grasp, simulate, write_grasp
from handsight.simulation.grasp_fit import TIP_CLEARANCE, HandFit
from handsight.simulation.grasped_body import body_of
from handsight.simulation.scene import convex_hull, mujoco_module, scene
from handsight.simulation.world import World
from testbed.refusals import refused
from testbed.touches import forces_object


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "block.stl"
    mesh = trimesh.creation.box((0.045, 0.06, 0.13))
    mesh.apply_translation([0.01, -0.02, 0.03])
    mesh.export(path)
    return str(path)


@pytest.fixture(scope="module")
def fitted(block):
    """The first grip of the block that the hand can have: its fingers, and its grasp."""
    fit = HandFit(scene(block), body_of(convex_hull(block)[0]), 0)
    grasp, name = next((grasp, name) for grasp, _, name in fit.grasps() if grasp)
    return name.replace(" against ", ", ").split(", "), grasp


def distances(world, among):
    """By geom of the hand: how far from the object [m], as the simulator measures it."""
    mujoco, model = mujoco_module(), world.scene.model
    held = model.geom("object").id
    names = [model.geom(i).name for i in range(model.ngeom) if model.geom(i).contype[0] and i != held]
    return {
        name: mujoco.mj_geomDistance(model, world.data, model.geom(name).id, held, 0.1, None)
        for name in names
        if among(name)
    }


def test_the_open_hand_is_clear_of_the_object_and_its_tips_are_ready(block, fitted, monkeypatch):
    fingers, grasp = fitted
    monkeypatch.setattr("handsight.simulation.world.perturbed", lambda grasp, rng: grasp)
    world = World(Scenario(object=block), grasp)
    tips = distances(world, lambda name: name.endswith("_tip"))
    for finger in fingers:
        # Beside the planes of the faces, by which a tip opens, it is farther away.
        assert TIP_CLEARANCE / 2 < tips[f"{finger}_tip"] < 2 * TIP_CLEARANCE
    assert min(distances(world, lambda name: name.startswith("robot0:C_")).values()) > 0.001
    lowest = {name: d for name, d in distances(world, lambda name: True).items() if d < 0}
    assert not lowest


def test_the_closed_hand_presses_with_each_finger_about_as_hard_as_it_should(block, fitted, monkeypatch):
    (pressing, *fingers), grasp = fitted
    monkeypatch.setattr("handsight.simulation.world.perturbed", lambda grasp, rng: grasp)
    world = World(Scenario(object=block), grasp)
    while world.time < 1.9:
        world.step()
    touched = {touch.finger: touch for touch in world.tip_contacts() if touch.other == "object"}
    assert set(touched) == {pressing, *fingers}
    forces = {finger: np.linalg.norm(touch.force_palm) for finger, touch in touched.items()}
    assert min(forces.values()) > 0.4
    assert forces[pressing] == pytest.approx(6.0, rel=0.25)
    assert sum(forces[finger] for finger in fingers) == pytest.approx(forces[pressing], rel=0.35)


def test_the_search_is_the_same_for_the_same_seed_and_names_the_hold(block):
    told = []
    first, again = (find_grasp(Scenario(object=block, seed=3), told.append) for _ in range(2))
    assert first.succeeded
    assert first.grasp.closed == again.grasp.closed
    assert first.trials == again.trials >= 1
    assert first.hold.startswith("th against ff, mf")
    assert told[0] == 0.0
    assert max(told) <= 1.0


def test_a_grasp_is_the_same_from_its_file(block, fitted, tmp_path):
    _, grasp = fitted
    path = tmp_path / "block.grasp.json"
    write_grasp(
        grasp_search.GraspSearchResult(grasp, True, 2, "thumb against ff, mf", "out of reach: 3"), block, path
    )
    again = read_grasp(path)
    for name in ("T_palm_middle", "R_world_palm"):
        np.testing.assert_allclose(getattr(again, name), getattr(grasp, name), atol=1e-12)
    assert (again.opening, again.closed, again.height) == (grasp.opening, grasp.closed, grasp.height)


def test_a_grasp_that_cannot_be_written_leaves_the_file_as_it_was(fitted, block, tmp_path):
    resource = pytest.importorskip("resource")
    path, before = tmp_path / "block.grasp.json", resource.getrlimit(resource.RLIMIT_FSIZE)
    path.write_text("the last one")
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with refused(NotWritten, "block.grasp.json"):
            write_grasp(grasp_search.GraspSearchResult(fitted[1], True, 1, "", ""), block, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [each.read_text() for each in tmp_path.iterdir()] == ["the last one"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"height"', '"heigth"', "unknown field"),
        ('"closed": {', '"closed": {"x": "y", ', "Expected `float`, got `str`"),
        ('"position_palm": [', '"position_palm": [7.0, ', "Expected `array` of length 3"),
        ('"quaternion_xyzw_world": [', '"quaternion_xyzw_world": [1e999, ', ""),
        ("{", "", ""),
    ],
)
def test_a_wrong_grasp_file_is_rejected_with_the_reason(old, new, message, fitted, block, tmp_path):
    path = tmp_path / "spoilt.grasp.json"
    write_grasp(grasp_search.GraspSearchResult(fitted[1], True, 1, "", ""), block, path)
    path.write_text(path.read_text().replace(old, new, 1))
    with refused(InvalidFile, "spoilt.grasp.json"):
        read_grasp(path)


def test_a_grasp_file_with_joints_of_another_hand_is_rejected(fitted, block, tmp_path):
    path = tmp_path / "other.grasp.json"
    other = replace(fitted[1], closed={"thumb": 0.3})
    write_grasp(grasp_search.GraspSearchResult(other, True, 1, "", ""), block, path)
    with refused(InvalidFile, "closed"):
        read_grasp(path)


MESHES = Path(os.environ.get("HANDSIGHT_DATA", Path(__file__).parents[3] / "shared" / "data")) / "ycb_meshes"


@pytest.mark.slow
@pytest.mark.skipif(not MESHES.is_dir(), reason="the YCB meshes are not here: set HANDSIGHT_DATA")
@pytest.mark.parametrize(
    ("name", "seed"), [("008_pudding_box", 1), ("011_banana", 1), ("040_large_marker", 1)]
)
def test_flat_bent_and_thin_objects_stay_in_the_hand_through_lift_and_turn(name, seed):
    scenario = Scenario(object=str(MESHES / f"{name}.ply"), seed=seed, motion="manipulate", rate=5.0)
    found = find_grasp(scenario)
    assert found.succeeded, found.failures
    run = [sample for sample in simulate(scenario, grasp=found.grasp) if sample.phase != "close"]
    assert not run[-1].dropped
    lifted = run[-1].T_world_object[2, 3] - run[0].T_world_object[2, 3]
    assert lifted > 0.1
    felt = [set(forces_object(sample)) for sample in run]
    assert np.mean(["th" in fingers and len(fingers) >= 3 for fingers in felt]) > 0.9
    assert max(force for sample in run for force in forces_object(sample).values()) < 15
