"""What an object weighs, and where; what presses on it unfelt; how a weighing tilts it."""

import numpy as np
import pytest

from handsight.simulation import Nuisances, Scenario
from handsight.simulation.motion import LEGS, palm_poses
from handsight.simulation.scenario import FINGERS
from handsight.simulation.simulate import tip_biases
from handsight.simulation.world import Payload
from simulation.simulated import only


def center_of_mass(scene):
    return scene.model.body("object").ipos


@pytest.mark.parametrize("name", ["can", "box"])
def test_an_object_has_the_scenarios_mass_and_centre_of_mass(name):
    usual = Payload.of(Scenario(object=name))
    heavy = Payload.of(Scenario(object=name, nuisances=only(object_mass=0.3, object_off_center=0.02)))
    assert heavy.scene.model.body("object").mass == pytest.approx(0.3)
    np.testing.assert_allclose(center_of_mass(usual.scene), 0, atol=1e-12)
    assert np.linalg.norm(center_of_mass(heavy.scene)) == pytest.approx(0.02)
    inertia = heavy.scene.model.body("object").inertia, usual.scene.model.body("object").inertia
    np.testing.assert_allclose(inertia[0], 2 * inertia[1], rtol=1e-6)


def test_a_centre_of_mass_stays_well_within_the_object():
    size = np.array([0.06, 0.09, 0.14])
    for seed in range(5):
        far = Payload.of(Scenario(object="box", seed=seed, nuisances=only(object_off_center=1.0)))
        assert (np.abs(center_of_mass(far.scene)) <= size / 3 + 1e-12).all()


def test_unsensed_forces_are_off_by_default_and_change_no_other_draws():
    assert not Payload.of(Scenario(nuisances=Nuisances())).force_palm.any()
    one, two = (Payload.of(Scenario(nuisances=only(unsensed_force=f))) for f in (0.2, 0.4))
    assert np.linalg.norm(one.force_palm) == pytest.approx(0.2)
    np.testing.assert_allclose(two.force_palm, 2 * one.force_palm)
    np.testing.assert_array_equal(one.point_object, two.point_object)


def test_a_weighing_has_five_orientations_20_degrees_apart():
    ends = np.cumsum(LEGS["weigh"][:, 0])
    Ts = palm_poses(LEGS["weigh"], ends - 0.3, np.eye(4), np.array([0.0, 0.0, 0.07]))
    down = -Ts[[2, 4, 6, 8, 10], 2, :3]
    angles = np.rad2deg(np.arccos(np.clip(down @ down.T, -1, 1)))
    np.testing.assert_allclose(angles[0, 1:], 20, atol=1e-6)
    assert (angles[np.triu_indices(5, 1)] > 19.9).all()


def test_a_support_presses_upwards_on_the_objects_underside():
    import mujoco

    loaded = Payload.of(Scenario(object="box", seed=4, nuisances=only(support_force=0.5)))
    data = mujoco.MjData(loaded.scene.model)
    data.joint("object").qpos[:] = [0.1, 0.2, 0.3, np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]  # z to -y
    mujoco.mj_forward(loaded.scene.model, data)
    loaded.press(data)
    force, torque = data.body("object").xfrc_applied.reshape(2, 3)
    x, y, z = loaded.base_object
    assert z == pytest.approx(-0.07)
    np.testing.assert_allclose(force, [0, 0, 0.5])
    np.testing.assert_allclose(torque, np.cross([x, -z, y], force), atol=1e-12)


def test_one_gripping_tip_is_biased():
    found = [tip_biases(Scenario(nuisances=only(tip_bias=0.1), seed=seed)) for seed in range(8)]
    sizes = np.linalg.norm(found, axis=2)
    np.testing.assert_allclose(np.sort(sizes)[:, -1], 0.1)
    assert (np.sort(sizes)[:, :-1] == 0).all()
    assert {FINGERS[k] for k in sizes.argmax(axis=1)} <= {"ff", "mf", "th"}
    assert not tip_biases(Scenario(nuisances=only())).any()
