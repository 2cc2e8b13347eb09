import numpy as np
import pytest

from handsight import se3
from handsight.contact import calibrate_wrench, compensate
from handsight.errors import InvalidInput
from testbed.refusals import refused

BIAS_FORCE, BIAS_TORQUE = np.array([0.3, -0.2, 1.1]), np.array([0.01, -0.02, 0.005])
MASS, COM = 0.025, np.array([0.001, -0.002, 0.018])
SIX = 9.81 * np.concatenate([np.eye(3), -np.eye(3)])


def read(gravities, sign=1.0, force=0.0, torque=0.0):
    """Of a sensor that carries the tip, with `force` and `torque` of the object on the tip."""
    weight = MASS * np.asarray(gravities)
    return (BIAS_FORCE + sign * (weight + force), BIAS_TORQUE + sign * (np.cross(COM, weight) + torque))


@pytest.mark.parametrize(("reading", "sign"), [("on_sensor", 1.0), ("on_tip", -1.0)])
def test_the_truth_is_recovered(reading, sign):
    rng = np.random.default_rng(0)
    gravities = 9.81 * se3.random(rng, 12)[:, 2, :3]
    found = calibrate_wrench(*read(gravities, sign), gravities, reading=reading)
    np.testing.assert_allclose(found.bias_force, BIAS_FORCE, atol=1e-13)
    np.testing.assert_allclose(found.bias_torque, BIAS_TORQUE, atol=1e-13)
    assert found.mass == pytest.approx(MASS, abs=1e-13)
    np.testing.assert_allclose(found.center_of_mass, COM, atol=1e-12)
    np.testing.assert_allclose([found.residual_force, found.residual_torque], 0, atol=1e-13)


def test_the_residual_is_the_noise():
    rng = np.random.default_rng(1)
    gravities = np.repeat(SIX, 300, axis=0)
    F, M = read(gravities)
    noise_force, noise_torque = np.array([0.01, 0.02, 0.03]), np.array([1e-5, 2e-5, 5e-5])
    found = calibrate_wrench(
        F + noise_force * rng.normal(size=F.shape), M + noise_torque * rng.normal(size=M.shape), gravities
    )
    np.testing.assert_allclose(found.residual_force, noise_force, rtol=0.06)
    np.testing.assert_allclose(found.residual_torque, noise_torque, rtol=0.06)
    # Six faces: √2 per column of the torque's design at worst, so the bias has the noise over √n.
    assert found.condition < 1.8
    np.testing.assert_allclose(found.bias_force, BIAS_FORCE, atol=5 * 0.03 / np.sqrt(1800))


@pytest.mark.parametrize(("reading", "sign"), [("on_sensor", 1.0), ("on_tip", -1.0)])
def test_what_is_compensated_is_what_the_object_does(reading, sign):
    rng = np.random.default_rng(2)
    calibration = calibrate_wrench(*read(SIX, sign), SIX, reading=reading)
    force, torque = rng.normal(size=(4, 3)), 0.02 * rng.normal(size=(4, 3))
    gravities = 9.81 * se3.random(rng, 4)[:, 2, :3]
    readings = read(gravities, sign, force, torque)
    F, M = compensate(*readings, gravities, calibration)
    np.testing.assert_allclose(F, force, atol=1e-13)
    np.testing.assert_allclose(M, torque, atol=1e-13)
    one = compensate(readings[0][1], readings[1][1], gravities[1], calibration)
    np.testing.assert_allclose(one, (F[1], M[1]), atol=1e-15)
    same = compensate(*read(gravities[0], sign, force, torque), gravities[0], calibration)
    np.testing.assert_allclose(same, (force, torque), atol=1e-13)


def cone(degrees, n=8):
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    a = np.deg2rad(degrees)
    return 9.81 * np.column_stack([np.sin(a) * np.cos(turn), np.sin(a) * np.sin(turn), np.full(n, np.cos(a))])


@pytest.mark.parametrize(
    "gravities",
    [
        np.repeat(SIX[:1], 6, axis=0),
        np.repeat(SIX[[0, 3]], 3, axis=0),
        np.repeat(SIX[[0, 1]], 3, axis=0),
        cone(2.0),
    ],
    ids=["one", "opposite", "two", "narrow"],
)
def test_orientations_too_alike_are_refused_with_their_spread(gravities):
    with refused(InvalidInput, "gravities"):
        calibrate_wrench(*read(gravities), gravities)


def test_a_cone_of_ten_degrees_is_wide_enough_and_its_conditioning_says_so():
    gravities = cone(10.0)
    found = calibrate_wrench(*read(gravities), gravities)
    np.testing.assert_allclose(found.center_of_mass, COM, atol=1e-9)
    assert 5 < found.condition < 50


@pytest.mark.parametrize(
    ("reading", "sign", "side"), [("on_sensor", -1.0, "along"), ("on_tip", 1.0, "against")]
)
def test_the_wrong_sign_of_reading_is_named(reading, sign, side):
    with refused(InvalidInput, "forces"):
        calibrate_wrench(*read(SIX, sign), SIX, reading=reading)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"forces": np.full((6, 3), np.nan)}, "forces"),
        ({"torques": np.zeros((6, 2))}, "torques"),
        ({"torques": np.zeros((5, 3))}, "forces, torques, gravities"),
        ({"gravities": SIX / 9.81}, "gravities[0]"),
        ({"gravities": 0 * SIX}, "gravities[0]"),
        ({"reading": "up"}, "reading"),
    ],
)
def test_wrong_readings_are_refused_by_name(change, field):
    F, M = read(SIX)
    with refused(InvalidInput, field):
        calibrate_wrench(**{"forces": F, "torques": M, "gravities": SIX, **change})


def test_compensation_refuses_shapes_that_do_not_fit():
    calibration = calibrate_wrench(*read(SIX), SIX)
    with refused(InvalidInput, "forces, torques, gravities"):
        compensate(np.zeros((2, 3)), np.zeros((3, 3)), SIX[0], calibration)
    with refused(InvalidInput, "gravities"):
        compensate(np.zeros(3), np.zeros(3), [0, 0], calibration)
