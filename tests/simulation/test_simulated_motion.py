from dataclasses import replace

import numpy as np
import pytest
import trimesh

from handsight import se3
from handsight.simulation import Nuisances, Scenario, model_of, simulate
from handsight.simulation.motion import CAN
from simulation.simulated import NONE, only, samples
from testbed.touches import forces_object


@pytest.fixture(scope="module")
def bottle(tmp_path_factory):
    """A mesh in metres whose origin is in its foot's middle, as scanned objects have it."""
    mesh = trimesh.creation.cylinder(radius=0.032, height=0.14, sections=24)
    mesh.apply_translation([0.01, -0.02, 0.07])
    path = tmp_path_factory.mktemp("mesh") / "bottle.stl"
    mesh.export(path)
    return str(path)


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "rod.stl"
    trimesh.creation.cylinder(radius=0.004, height=0.05, sections=12).export(path)
    return str(path)


def test_the_same_scenario_gives_the_same_samples_and_another_seed_others():
    usual = samples(nuisances=Nuisances())
    for a, b in zip(simulate(Scenario(rate=10.0)), usual, strict=True):
        np.testing.assert_array_equal(a.T_palm_object, b.T_palm_object)
        np.testing.assert_array_equal(a.configuration, b.configuration)
        assert a.observation.joint_positions == b.observation.joint_positions
        np.testing.assert_array_equal(a.observation.wrenches["ff"], b.observation.wrenches["ff"])
        np.testing.assert_array_equal(
            a.observation.vision.T_frame_object, b.observation.vision.T_frame_object
        )
    first, other = samples(seed=0)[-1], samples(seed=1)[-1]
    shift = se3.difference(first.T_palm_object, other.T_palm_object)
    assert 1e-4 < np.linalg.norm(shift[:3]) < 0.03


@pytest.mark.parametrize(("kind", "height"), [("can", 0.122), ("box", 0.140)])
def test_the_table_carries_the_object_until_it_is_lifted(kind, height):
    for sample in samples(kind):
        assert sample.T_world_object[2, 3] == pytest.approx(height / 2, abs=1e-3)
        assert sample.T_world_object[2, 2] > np.cos(np.deg2rad(1.5))


def test_the_true_table_is_a_little_off_the_table_of_the_rig():
    """By what it is told, over seeds; the grasp itself stays as it is."""
    heights, tilts = [], []
    for seed in range(12):
        off = only(table_height=0.003, table_tilt=0.02)
        exact, moved = (next(simulate(Scenario(seed=seed, rate=10.0, nuisances=n))) for n in (NONE, off))
        np.testing.assert_array_equal(moved.T_palm_object, exact.T_palm_object)
        T = moved.T_world_object @ se3.inverse(exact.T_world_object)
        np.testing.assert_allclose(
            T @ exact.observation.T_world_palm, moved.observation.T_world_palm, atol=1e-12
        )
        heights.append(T[2, 3])
        tilts.extend(se3.rotation_log(T[:3, :3])[:2])
    assert 0.0015 < np.std(heights) < 0.0055  # of 12 draws
    assert 0.012 < np.std(tilts) < 0.029  # of 24


@pytest.mark.parametrize("kind", ["can", "box"])
def test_a_manipulation_moves_the_object_over_the_table_lifts_it_and_turns_it(kind):
    run = samples(kind, motion="manipulate")
    assert [s.phase for s in run] == sorted((s.phase for s in run), key=["close", "hold", "move"].index)
    T = np.array([s.observation.T_world_palm for s in run])
    heading = np.unwrap(np.arctan2(T[:, 1, 2], T[:, 0, 2]))
    assert np.ptp(heading) > np.deg2rad(60)
    heights = np.array([s.T_world_object[2, 3] for s in run])
    assert heights[-1] > heights[0] + 0.1
    on_table = heights < heights[0] + 0.003
    assert np.ptp([s.T_world_object[1, 3] for s in np.array(run, dtype=object)[on_table]]) > 0.1
    assert not any(s.dropped for s in run)
    for sample in run[::5]:
        np.testing.assert_allclose(
            sample.observation.T_world_palm @ sample.T_palm_object, sample.T_world_object, atol=1e-12
        )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["can", "box"])
def test_most_grasps_hold_through_a_manipulation(kind):
    dropped = [samples(kind, seed, "manipulate", 2.0)[-1].dropped for seed in range(1, 4)]
    assert sum(dropped) <= 1


def test_a_mesh_stands_on_the_table_and_is_grasped_until_the_tips_touch_it(bottle):
    run = samples(bottle)
    np.testing.assert_allclose(run[0].T_world_object[2, 3], 0.0, atol=1e-3)
    model = model_of(Scenario(object=bottle))
    np.testing.assert_allclose(
        model.bounds_object[1] - model.bounds_object[0], [0.064, 0.064, 0.14], atol=2e-3
    )
    forces = forces_object(run[-1])
    assert len(forces) >= 4
    assert min(forces.values()) > 0.5
    for touch in run[-1].contacts_truth:
        if touch.other == "object":
            points_object = se3.apply(se3.inverse(run[-1].T_palm_object), touch.point_palm[None])
            assert abs(model.evaluate(points_object).distance[0]) < 2e-3


@pytest.fixture(scope="module")
def slipping(rod):
    """What becomes of a thin rod that is grasped as a can."""
    scenario = Scenario(object=rod, motion="manipulate", rate=2.0, nuisances=Nuisances.none())
    above_table = CAN.T_palm_middle.copy()
    above_table[0, 3] = 0.025 - 0.047  # or the palm's edge is in the table
    return list(simulate(scenario, grasp=replace(CAN, T_palm_middle=above_table, height=0.025)))


def test_an_object_that_slips_out_of_the_hand_counts_as_dropped(slipping):
    run = slipping
    assert run[-1].dropped
    assert not run[0].dropped
    assert not forces_object(run[-1])


def test_tips_that_touch_push_each_other_as_hard(slipping):
    pushed = 0
    for sample in slipping:
        between = [t for t in sample.contacts_truth if t.other.endswith("_tip")]
        assert {t.finger + "_tip" for t in between} == {t.other for t in between}
        if between:
            np.testing.assert_allclose(sum(t.force_palm for t in between), 0, atol=1e-9)
            pushed += 1
    assert pushed > 5
