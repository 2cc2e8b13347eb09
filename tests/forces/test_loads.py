"""A sensor's bias is read while its tip is in the air, and only then."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forces.hand_in_air import CENTER, MASS, TILTS, Held, rig
from forces.test_weigher import weighed
from handsight.forces import LOADS, Weigher, read_in_air


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
    large = Held(biases=biased([LOADS.max_bias, 0.1, 0]), noise=1.0)
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
    held = Held(biases=biased([0.06, -0.06, 0.05]))
    weigher = weighed(listened(held, Weigher(rig())), held)
    assert weigher.biased == ("rf",)
    assert weigher.believed.mass == pytest.approx(MASS, rel=3e-3)
    assert np.linalg.norm(weigher.believed.center_palm - CENTER) < 1e-3
    assert abs(weighed(Weigher(rig()), held).weighing.mass / MASS - 1) > 0.01


def test_no_bias_is_reported_with_a_good_calibration():
    assert listened(Held(noise=1.0), Weigher(rig())).biased == ()
