"""A sensor's bias is read while its tip is in the air, and only then."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forces.hand_in_air import CENTER, MASS, TILTS, Held, rig
from forces.test_weigher import weighed
from handsight.errors import InvalidInput
from handsight.forces import Weigher, calibrate_sensors, read_in_air
from handsight.forces.loads import MAX_BIAS
from testbed.refusals import refused


def moving(held, bend=0.2, count=21):
    """Observations of fingers that bend by so much meanwhile [rad]."""
    return [
        held.observations(TILTS[0], start=0.01 * k, bend=bend * k / count, count=1)[0] for k in range(count)
    ]


def biased(newtons, tip=2):
    biases = np.zeros((5, 6))
    biases[tip, :3] = newtons
    return biases


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(-0.25, 0.25), min_size=3, max_size=3))
def test_a_tips_reading_in_the_air_is_its_sensors_bias(newtons):
    read = read_in_air(rig(), moving(Held(biases=biased(newtons), noise=1.0)))
    np.testing.assert_allclose(read[2, :3], newtons, atol=0.015)
    np.testing.assert_allclose(read[3, :3], 0, atol=0.015)


def test_the_reading_of_a_tip_that_may_touch_something_is_no_bias():
    held = Held(noise=1.0)
    assert np.isnan(read_in_air(rig(), moving(held))[[0, 1, 4]]).all()  # these hold the object
    assert np.isnan(read_in_air(rig(), moving(held, bend=0.0))).all()
    large = Held(biases=biased([MAX_BIAS, 0.1, 0]), noise=1.0)
    assert np.isnan(read_in_air(rig(), moving(large))[2]).all()
    changing = moving(held)
    for k, seen in enumerate(changing):
        seen.wrenches["rf"][0] += 0.005 * k
    assert np.isnan(read_in_air(rig(), changing)[2]).all()


def listened(held, weigher):
    for seen in moving(held, count=31):
        weigher.listen(seen)
    return weigher


def test_a_bias_that_was_read_in_the_air_is_subtracted_and_reported():
    held = Held(biases=biased([0.2, -0.2, 0.15]))
    weigher = weighed(listened(held, Weigher(rig())), held)
    assert weigher.biased == ("rf",)
    assert weigher.believed.mass == pytest.approx(MASS, rel=3e-3)
    assert np.linalg.norm(weigher.believed.center_palm - CENTER) < 1e-3
    assert abs(weighed(Weigher(rig()), held).weighing.mass / MASS - 1) > 0.01


ORIENTATIONS = [np.zeros(3), *(sign * 1.5 * np.eye(3)[axis] for axis in range(3) for sign in (1, -1))]


def in_the_air(bias_by_gravity, orientations=ORIENTATIONS):
    """Observations of a hand that touches nothing; ff's bias depends on gravity's direction [N]."""
    for k, turn in enumerate(orientations):
        held = Held(noise=1.0, rng=np.random.default_rng(k), empty=True)
        off = bias_by_gravity * np.random.default_rng(100 + k).normal(size=6) * [1, 1, 1, 0, 0, 0]
        for seen in held.observations(turn, start=2.0 * k, count=40):
            seen.wrenches["ff"] = seen.wrenches["ff"] + off
            yield seen


def test_what_a_calibration_leaves_becomes_the_sensors_sigma():
    """A bias that depends on the direction of gravity is no noise of readings, but an error all the same."""
    after = calibrate_sensors(rig(), in_the_air(0.2))
    assert 0.1 < after.fingers["ff"].sigma_force < 0.3
    assert after.fingers["mf"].sigma_force == pytest.approx(rig().fingers["mf"].sigma_force, rel=0.3)
    assert after.fingers["mf"].sigma_torque == pytest.approx(rig().fingers["mf"].sigma_torque, rel=0.3)
    known = rig().fingers["mf"].calibration
    assert after.fingers["mf"].calibration.mass == pytest.approx(known.mass, abs=3e-4)
    np.testing.assert_allclose(after.fingers["mf"].calibration.bias_force, known.bias_force, atol=5e-3)


def test_a_sensor_that_was_not_turned_cannot_be_calibrated():
    with refused(InvalidInput, "finger ff"):
        calibrate_sensors(rig(), in_the_air(0.0, ORIENTATIONS[:2]))
