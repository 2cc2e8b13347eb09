"""Mass and centre of mass from fingertips' loads: equations against differences, truth recovered, honest sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from forces.hand_in_air import CENTER, MASS, TILTS, Held, rig, touched
from handsight import se3
from handsight.forces import Carried, Unknowns, load_sum, weigh
from handsight.forces.weigher import CREEP, SIGMA_GRAVITY

JOINTS = len(rig().hand.moving)
STAY = np.zeros(JOINTS)


def unknowns(gains=0.0):
    sigma = [[finger.sigma_force] * 3 + [finger.sigma_torque] * 3 for finger in rig().fingers.values()]
    root = rig().sigma_joint_offset * np.eye(JOINTS)
    return Unknowns(root, np.ravel(sigma), CREEP, rig().gravity, SIGMA_GRAVITY, np.full(30, gains))


def carried(held, tilts, **how):
    loads = [load_sum(rig(), held.observations(tilt, **how), touched(held), STAY) for tilt in tilts]
    return [Carried(load, np.eye(4), np.zeros(6), 0.0) for load in loads]


@pytest.mark.parametrize("mass", [0.05, 0.15, 0.6])
def test_exact_readings_give_mass_and_centre(mass):
    center = CENTER + np.array([0.02, -0.01, 0.015])
    found = weigh(carried(Held(mass, center), TILTS[:3]), unknowns())
    assert found.mass == pytest.approx(mass, rel=1e-3)
    # A weak prior has the centre near the tips: it pulls by (σ / REACH)² of the way.
    assert np.linalg.norm(found.center_palm - center) < 3e-3 * 0.15 * (0.15 / mass)
    assert found.consistent


def test_the_derivatives_of_the_wrench_are_those_of_differences():
    """By the joints, which are believed less far where an offset is taken away, by biases and by gains."""
    tilt, h = [0.2, 0.1, 0.0], 1e-6
    seen = Held().observations(tilt, count=5)
    load, clean = (load_sum(rig(), seen, felt, STAY) for felt in (touched(Held()), {}))
    for j in range(JOINTS):
        step = h * np.eye(JOINTS)[j]
        off = (load_sum(rig(), seen, {}, -step).wrench - load_sum(rig(), seen, {}, step).wrench) / (2 * h)
        np.testing.assert_allclose(load.by_joint[:, j], off, atol=1e-3)  # but for the tip's own torque
    for k in range(0, 30, 4):
        wrong = 0.01 * np.eye(30)[k].reshape(5, 6)
        by_gain = clean.by_bias[:, k] * clean.readings[k]
        for held, expected in ((Held(biases=wrong), clean.by_bias[:, k]), (Held(gains=wrong), by_gain)):
            wrench = load_sum(rig(), held.observations(tilt, count=5), {}, STAY).wrench
            np.testing.assert_allclose((wrench - clean.wrench) / 0.01, expected, atol=1e-9)


def test_one_orientation_leaves_the_height_along_gravity_open():
    (instant,) = carried(Held(), TILTS[:1])
    found = weigh([instant], unknowns())
    down = instant.load.gravity / np.linalg.norm(instant.load.gravity)
    values, vectors = np.linalg.eigh(found.covariance_center)
    assert abs(vectors[:, 2] @ down) > 0.99
    assert np.sqrt(values[2]) > 0.1 > 0.01 > np.sqrt(values[1])
    across = np.eye(3) - np.outer(down, down)
    assert np.linalg.norm(across @ (found.center_palm - CENTER)) < 1e-3


def test_the_palms_acceleration_is_compensated():
    still = weigh(carried(Held(), TILTS[:3]), unknowns())
    shaken = weigh(carried(Held(), TILTS[:3], acceleration=(1.0, -2.0, 1.5)), unknowns())
    assert shaken.mass == pytest.approx(still.mass, rel=1e-3)
    np.testing.assert_allclose(shaken.center_palm, still.center_palm, atol=2e-4)


def test_a_wrong_acceleration_costs_nothing_across_the_load():
    """It is wrong in the force as it is in the torque: c x F = T, whatever the acceleration is."""
    (instant,) = carried(Held(), TILTS[:1], acceleration=(1.0, -2.0, 1.5))
    wrong = replace(instant.load, gravity=instant.load.gravity + np.array([0.3, -0.2, 0.1]), acceleration=1.5)
    found = weigh([replace(instant, load=wrong)], unknowns())
    hangs = instant.load.wrench[:3] / np.linalg.norm(instant.load.wrench[:3])
    across = np.eye(3) - np.outer(hangs, hangs)
    assert np.linalg.norm(across @ (found.center_palm - CENTER)) < 1e-3


@pytest.mark.parametrize("extra", [(0.25, 0, 0), (0, 0.25, 0), (0, 0, 0.25)])
def test_a_force_that_is_fixed_in_the_palm_is_noticed(extra):
    alone, pressed = (
        weigh(carried(Held(extra_palm=np.array(force)), TILTS[:3]), unknowns())
        for force in ((0, 0, 0), extra)
    )
    assert alone.consistent
    assert pressed.p_fixed < 0.05 * alone.p_fixed
    assert pressed.p_fixed < pressed.p_value


@pytest.mark.parametrize("count", [1, 3, 5])
def test_errors_fit_the_covariance_and_chi2_its_degrees_of_freedom(count):
    """With errors drawn from all unknowns: the NEES is near one, and so is χ² for each degree of freedom."""
    rng, nees, chi2, freedom = np.random.default_rng(1), [], 0.0, 0
    given = unknowns(0.03)
    sigma = given.biases.reshape(5, 6)
    for _ in range(12 if count > 1 else 24):
        held = Held(
            offsets=rig().sigma_joint_offset * rng.normal(size=JOINTS),
            biases=sigma * rng.normal(size=(5, 6)),
            gains=0.03 * rng.normal(size=(5, 6)),
            plumb=SIGMA_GRAVITY * rng.normal(size=3),
            noise=1.0,
            rng=rng,
        )
        instants = carried(held, TILTS[:count])
        found = weigh(instants, given)
        down = instants[-1].load.gravity[None] / np.linalg.norm(instants[-1].load.gravity)
        axes = np.linalg.svd(down)[2][1:] if count == 1 else np.eye(3)
        off = axes @ (found.center_palm - CENTER)
        nees.append(off @ np.linalg.solve(axes @ found.covariance_center @ axes.T, off) / len(axes))
        chi2, freedom = chi2 + found.chi2, freedom + found.freedom
    assert 0.6 < np.mean(nees) < 1.5
    # Its joints' noise, that the readings here lack, and the prior's rows are counted in it.
    assert 0.5 < chi2 / freedom < 1.2


def test_a_known_mass_counts_as_a_measurement():
    found = weigh(carried(Held(biases=np.full((5, 6), 0.002)), TILTS[:2]), unknowns())
    known = found.given_mass(MASS, 1e-6)
    assert known.mass == pytest.approx(MASS, abs=1e-5)
    assert known.freedom == found.freedom + 1
    assert known.chi2 - found.chi2 == pytest.approx(((found.mass - MASS) / found.sigma_mass) ** 2, rel=1e-3)
    none = found.given_mass(MASS, 1e3)
    np.testing.assert_allclose(none.mean, found.mean, atol=1e-9)


def test_an_earlier_instant_is_carried_along_in_the_grip():
    """The object has moved by T, and crept in addition: earlier loads still measure where it is now."""
    T = se3.compose(se3.rotation_exp(np.array([0.05, -0.04, 0.03])), np.array([0.004, -0.003, 0.002]))
    kappa, creep = 2e-4, np.array([3.0, -2.0, 4.0, 10.0, 0.0, -10.0])
    drift = kappa * (creep[:3] + np.cross(creep[3:], CENTER))
    then = Held(center_palm=se3.apply(se3.inverse(T), (CENTER - drift)[None])[0])
    first = [Carried(i.load, T, creep, 1e-5) for i in carried(then, TILTS[1:])]
    found = weigh([*first, *carried(Held(), TILTS[:1])], unknowns())
    assert np.linalg.norm(found.center_palm - CENTER) < 1e-4
    stayed = [Carried(i.load, np.eye(4), 0 * creep, 1e-5) for i in carried(then, TILTS[1:])]
    assert (
        np.linalg.norm(weigh([*stayed, *carried(Held(), TILTS[:1])], unknowns()).center_palm - CENTER) > 1e-3
    )
