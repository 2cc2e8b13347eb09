"""The simulated skin: springs that hold what presses on them, where the body is."""

import numpy as np
import pytest

from handsight import se3
from handsight.contact.taxels import grid_places
from handsight.errors import InvalidInput
from handsight.simulation import Scenario
from handsight.simulation.taxels import PALM_SKIN
from testbed.refusals import refused
from testbed.skin_scenes import box_solid, taxel_forces


def test_taxels_under_a_face_measure_its_force():
    T = PALM_SKIN.layout.T_frame_grid @ se3.compose(np.eye(3), np.array([0.018, 0.0, 0.01]))
    readings = taxel_forces(PALM_SKIN, box_solid([0.04, 0.03, 0.02]), T, 2.0)
    assert readings.sum() == pytest.approx(2.0)
    places = grid_places(*PALM_SKIN.places, PALM_SKIN.pitch)[readings > 0]
    np.testing.assert_allclose(places.min(axis=0)[:2], [0.0, -0.014], atol=1e-9)
    np.testing.assert_allclose(places.max(axis=0)[:2], [0.028, 0.014], atol=1e-9)


def test_the_power_grasp_presses_the_can_on_the_skin(simulated):
    samples = simulated(Scenario(object="can", seed=1, motion="grasp", rate=50, skin=True))
    last = samples[-1]
    assert not last.dropped
    assert len(last.touches) >= 3
    reading = last.observation.skin["palm"] - samples[0].observation.skin["palm"]
    assert reading.max() > 0.1
    # Along its axis the can ends on the array, near its end in the palm.
    end = se3.apply(
        se3.inverse(PALM_SKIN.layout.T_frame_grid) @ last.T_palm_object, np.array([[0, 0, 0.061]])
    )[0]
    pressed = grid_places(*PALM_SKIN.places, PALM_SKIN.pitch)[reading > 0.05]
    assert abs(pressed[:, 0].max() - end[0]) < 0.006


def test_the_box_cannot_be_pressed_on_the_palm():
    with refused(InvalidInput, "skin"):
        Scenario(object="box", skin=True)
