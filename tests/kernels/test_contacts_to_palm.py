"""Fingers' raw wrenches become the contacts in the palm that plain steps make of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from contact.contact_cases import any_tip, touches
from handsight import se3
from handsight.contact import Ellipsoid, Reason, Sphere, WrenchCalibration
from handsight.contact.kernels.contacts_to_palm import TIP_TO_TIP, contacts_to_palm
from handsight.contact.kernels.sensing_records import FINGER, PALM_CONTACT
from handsight.rig import Finger
from handsight.tracking.fingertips import finger_record
from oracles.contacts_to_palm import contact_in_palm

GRAVITY = np.array([1.0, -9.0, 3.0])
SEEDS = st.integers(0, 2**32 - 1)


def some_finger(rng):
    kind = rng.integers(3)
    T = se3.random(rng, spread=0.01)
    tip = (
        any_tip(rng, T_surface_sensor=T, max_friction=1.0),
        Ellipsoid((0.009, 0.009, 0.0145), cap=-0.007, max_friction=0.8),
        Sphere(0.009, T_surface_sensor=T),
    )[kind]
    none = np.zeros(3)
    reading = ("on_sensor", "on_tip")[rng.integers(2)]
    bias = rng.normal(size=3), 0.02 * rng.normal(size=3)
    known = WrenchCalibration(*bias, 0.03, 0.01 * rng.normal(size=3), none, none, 1.0, reading)
    sigmas = dict(zip(("sigma_point", "sigma_normal"), rng.uniform(1e-4, 1e-2, 2), strict=True))
    sigmas["sigma_gain"] = rng.choice([0.0, 0.02, 0.1])
    return Finger(
        frame="tip", T_frame_surface=se3.random(rng, spread=0.02), tip=tip, calibration=known, **sigmas
    )


def raw(rng, finger, T_palm_tip):
    """A reading of a push, a pull, too little, or nothing at all."""
    tip, known = finger.tip, finger.calibration
    truth = touches(rng, tip, 1)
    T_surface_sensor = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
    R, p = T_surface_sensor[:3, :3], T_surface_sensor[:3, 3]
    force, torque = R.T @ truth.forces[0], R.T @ (truth.torques[0] - np.cross(p, truth.forces[0]))
    size = rng.choice([1.0, 1.0, 1.0, -1.0, 1e-4, np.nan])
    gravity = (T_palm_tip @ finger.T_frame_surface @ T_surface_sensor)[:3, :3].T @ GRAVITY
    weight = known.mass * gravity
    load = np.r_[size * force + weight, size * torque + np.cross(known.center_of_mass, weight)]
    sign = 1.0 if known.reading == "on_sensor" else -1.0
    return sign * load + np.r_[known.bias_force, known.bias_torque]


def contacts_of(fingers, readings, Ts, jacobians, variance=0.0):
    records = np.array([finger_record(finger) for finger in fingers], dtype=FINGER)
    contacts = np.empty(len(fingers), dtype=PALM_CONTACT)
    contacts_to_palm(records, readings, Ts, np.sqrt(variance) * jacobians, GRAVITY, contacts)
    return contacts


@settings(deadline=None)
@given(SEEDS, st.integers(1, 5), st.integers(0, 22))
def test_contacts_in_the_palm_are_those_of_plain_steps(seed, count, joints):
    rng = np.random.default_rng(seed)
    fingers = [some_finger(rng) for _ in range(count)]
    Ts = se3.random(rng, count)  # a metre apart: none is near another
    readings = np.array([raw(rng, finger, T) for finger, T in zip(fingers, Ts, strict=True)])
    jacobians = rng.normal(scale=0.1, size=(count, 6, joints))
    contacts = contacts_of(fingers, readings, Ts, jacobians, 0.02)
    for i, finger in enumerate(fingers):
        expected = contact_in_palm(finger, readings[i], Ts[i], jacobians[i], GRAVITY, 0.02)
        assert contacts["reason"][i] == expected[0]
        if expected[0] != Reason.CONTACT or contacts["gap"][i] < 0.02:
            continue
        np.testing.assert_allclose(contacts["point"][i], expected[1], atol=1e-12)
        np.testing.assert_allclose(contacts["normal"][i], expected[2], atol=1e-9)
        np.testing.assert_allclose(contacts["load"][i], expected[4], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(contacts["covariance"][i], expected[3], rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(
            contacts["covariance"][i][3:] @ np.r_[0, 0, 0, contacts["normal"][i]], 0, atol=1e-12
        )
        assert np.linalg.eigvalsh(contacts["covariance"][i]).min() > -1e-12


def ball(radius=0.01):
    none = np.zeros(3)
    known = WrenchCalibration(none, none, 1e-9, none, none, none, 1.0)
    return Finger(frame="tip", T_frame_surface=np.eye(4), tip=Sphere(radius), calibration=known)


@pytest.mark.parametrize("gap", [0.0, 0.001, 0.003, 0.006])
def test_a_contact_near_another_tip_is_less_certain_by_the_chance_that_they_touch(gap):
    """Two balls beside each other, both pushed from above."""
    down = np.array([0.0, 0, -1, 0, 0, 0])
    Ts = np.array([np.eye(4), se3.compose(np.eye(3), np.array([0.02 + gap, 0, 0]))])
    readings = np.array([down, down])
    alone, near = (contacts_of([ball()] * n, readings[:n], Ts[:n], np.zeros((n, 6, 0)))[0] for n in (1, 2))
    assert near["gap"] == pytest.approx(gap, abs=1e-15)
    np.testing.assert_array_equal(near["point"], alone["point"])
    np.testing.assert_array_equal(near["normal"], alone["normal"])
    chance = norm.sf(1.645 * gap / TIP_TO_TIP.max_gap)
    two = chance * np.diag(np.repeat([TIP_TO_TIP.variance_point, TIP_TO_TIP.variance_normal], 3))
    tangent = np.eye(6)
    tangent[3:, 3:] -= np.outer(near["normal"], near["normal"])
    added = near["covariance"] - alone["covariance"]
    np.testing.assert_allclose(added, tangent @ two @ tangent, atol=1e-12)


@settings(deadline=None)
@given(SEEDS, st.floats(-0.004, 0.004))
def test_pressed_contacts_stay_contacts(seed, gap):
    """Whatever tips and loads: unit normals, and covariances that are positive semidefinite without any along them."""
    rng = np.random.default_rng(seed)
    fingers = [some_finger(rng) for _ in range(3)]
    Ts = se3.random(rng, 3, spread=0.01 + gap)
    readings = np.array([raw(rng, finger, T) for finger, T in zip(fingers, Ts, strict=True)])
    for contact in contacts_of(fingers, readings, Ts, rng.normal(scale=0.1, size=(3, 6, 4)), 0.02):
        if contact["reason"] == Reason.CONTACT:
            C, normal = contact["covariance"], contact["normal"]
            assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
            assert np.abs(C[3:] @ np.r_[0, 0, 0, normal]).max() < 1e-12 * (1 + np.abs(C).max())
            assert np.linalg.eigvalsh(C)[0] > -1e-10 * np.abs(C).max()
