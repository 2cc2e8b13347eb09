"""What an object weighs, and where; what presses on it unfelt; how a weighing tilts it."""

import numpy as np
import pytest

from handsight.simulation import Nuisances, Scenario
from handsight.simulation.loaded import Loaded, center_of_mass
from handsight.simulation.motion import WEIGH_LEGS, palm_poses
from simulation.simulated import only


@pytest.mark.parametrize("name", ["can", "box"])
def test_an_object_weighs_what_is_asked_and_its_centre_is_off(name):
    usual = Loaded.of(Scenario(object=name))
    heavy = Loaded.of(Scenario(object=name, nuisances=only(object_mass=0.3, object_off_center=0.02)))
    assert heavy.scene.model.body("object").mass == pytest.approx(0.3)
    np.testing.assert_allclose(center_of_mass(usual.scene), 0, atol=1e-12)
    assert np.linalg.norm(center_of_mass(heavy.scene)) == pytest.approx(0.02)
    inertia = heavy.scene.model.body("object").inertia, usual.scene.model.body("object").inertia
    np.testing.assert_allclose(inertia[0], 2 * inertia[1], rtol=1e-6)


def test_a_centre_of_mass_stays_well_within_the_object():
    size = np.array([0.06, 0.09, 0.14])
    for seed in range(5):
        far = Loaded.of(Scenario(object="box", seed=seed, nuisances=only(object_off_center=1.0)))
        assert (np.abs(center_of_mass(far.scene)) <= size / 3 + 1e-12).all()


def test_nothing_presses_unless_asked_and_the_draws_of_others_stay():
    assert not Loaded.of(Scenario(nuisances=Nuisances())).force_palm.any()
    one, two = (Loaded.of(Scenario(nuisances=only(unsensed_force=f))) for f in (0.2, 0.4))
    assert np.linalg.norm(one.force_palm) == pytest.approx(0.2)
    np.testing.assert_allclose(two.force_palm, 2 * one.force_palm)
    np.testing.assert_array_equal(one.point_object, two.point_object)


def test_a_weighing_has_five_orientations_20_degrees_apart():
    ends = np.cumsum(WEIGH_LEGS[:, 0])
    Ts = palm_poses(WEIGH_LEGS, ends - 0.3, np.eye(4), np.array([0.0, 0.0, 0.07]))
    down = -Ts[[2, 4, 6, 8, 10], 2, :3]
    angles = np.rad2deg(np.arccos(np.clip(down @ down.T, -1, 1)))
    np.testing.assert_allclose(angles[0, 1:], 20, atol=1e-6)
    assert (angles[np.triu_indices(5, 1)] > 19.9).all()
