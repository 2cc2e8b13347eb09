"""The force of a contact is the same, wherever it is measured: by a tip's wrench, or by three-axis taxels of any link."""

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import handsight as hs
from forces.hand_in_air import CENTER, MASS, TILTS, Held, contacts, rig, sensor_frame
from forces.loads import FINGERS, load, steady
from forces.loads import rig as some_rig
from handsight import se3
from handsight.contact import TactileSurface, compensate
from handsight.forces import LINK_TAXELS, SlipDetector, Weigher
from testbed import skin_scenes

JOINTS = len(rig().hand.moving)
KNOWN = np.zeros(JOINTS), rig().sigma_joint_offset * np.eye(JOINTS)
PALM, THUMB = rig().hand.palm, rig().fingers["th"].frame


def surface(frame, components=3, **fields):
    given = {"rows": 6, "columns": 4, "pitch": 0.006, "threshold": 0.03} | fields
    T = se3.compose(se3.rotation_exp(np.array([0.3, -0.2, 0.5])), np.array([0.01, -0.02, 0.03]))
    return TactileSurface.grid(frame=frame, T_frame_grid=T, components=components, **given)


@functools.cache
def hand(*frames):
    """The hand with taxels on these links too."""
    return replace(rig(), skin={frame: surface(frame) for frame in frames})


def by_taxels(observation, finger):
    """The same observation, in which a finger's taxels measure what its wrench did."""
    known = rig().fingers[finger]
    Ts = dict(zip(rig().fingers, rig().hand.Ts_palm_tip(observation.joint_positions), strict=True))
    T_palm_sensor = Ts[finger] @ sensor_frame(known)
    gravity = T_palm_sensor[:3, :3].T @ observation.T_world_palm[:3, :3].T @ rig().gravity
    wrenches = dict(observation.wrenches)
    wrench = wrenches.pop(finger)
    f, m = compensate(wrench[:3], wrench[3:], gravity, known.calibration)
    T = sensor_frame(known)
    force, torque = T[:3, :3] @ f, T[:3, :3] @ m
    wrenches[LINK_TAXELS.format(known.frame)] = np.concatenate([force, torque + np.cross(T[:3, 3], force)])
    return replace(observation, wrenches=wrenches)


def weighed(weigher, held, change=lambda seen: seen):
    for k, tilt in enumerate(TILTS[:3]):
        for seen in held.observations(tilt, start=1.0 * k, count=31):
            weigher.update(change(seen), *contacts(held), KNOWN)
    return weigher


def test_an_object_is_weighed_the_same_whether_a_wrench_or_taxels_measure_a_tips_load():
    found = weighed(Weigher(hand(THUMB)), Held(), lambda seen: by_taxels(seen, "th")).believed
    assert found.directions == 3
    assert found.mass == pytest.approx(MASS, rel=2e-3)
    assert np.linalg.norm(found.center_palm - CENTER) < 1e-3


def test_taxels_beside_a_wrench_on_one_tip_are_not_counted_twice():
    def both(seen):
        return replace(seen, wrenches={**seen.wrenches, **by_taxels(seen, "th").wrenches})

    weigher, alone = weighed(Weigher(hand(THUMB)), Held(), both), weighed(Weigher(rig()), Held())
    assert weigher.believed.mass == alone.believed.mass


def test_the_gains_of_taxels_are_as_uncertain_as_their_noise_so_the_weight_is_too():
    by_wrench = weighed(Weigher(rig()), Held()).believed.sigma_mass
    names = list(rig().fingers)
    frames = [rig().fingers[name].frame for name in names]

    def all_of_them(seen):
        return functools.reduce(by_taxels, names, seen)

    assert weighed(Weigher(hand(*frames)), Held(), all_of_them).weighing.sigma_mass > by_wrench


@pytest.mark.parametrize("components", [1, 3])
def test_the_wrench_of_a_surface_is_the_sum_over_its_taxels(components):
    rng = np.random.default_rng(2)
    shape = skin_scenes.SHAPES["ball"]
    for _ in range(10):
        tip = skin_scenes.tip(shape, rng, components=components)
        truth = skin_scenes.pressed(shape, tip, rng, dead=0)
        touch = tip.touch(truth.readings)
        if components == 1:
            assert np.isnan(touch.wrench).all()
            continue
        used = touch.rise[:-1]  # of all taxels: those far from the patch have noise alone
        forces = np.einsum("nik,nk->ni", tip.taxels["axes"], used * [1, 1, -1])
        torque = np.cross(tip.points, forces).sum(axis=0)
        np.testing.assert_allclose(touch.wrench[:3], forces.sum(axis=0), atol=0.05)
        np.testing.assert_allclose(touch.wrench[3:], torque, atol=1e-3)
    assert (tip.touch(np.zeros(tip.shape)).wrench == 0).all()


def test_a_patch_with_a_taxel_at_its_full_scale_measures_no_force():
    known = surface(PALM, full_scale=1.0)
    reading = np.zeros(known.shape)
    reading[2:4, 1:3, 2] = 0.5
    assert np.isfinite(known.touch(reading).wrench).all()
    reading[2, 1, 2] = 1.0
    touch = known.touch(reading)
    assert len(touch.patches) == 1
    assert np.isnan(touch.wrench).all()
    assert np.isnan(touch.patches["force"]).all()


def tips_of_taxels():
    """A rig of fingers with taxels, for a detector."""
    tips = {name: SimpleNamespace(**vars(tip) | {"frame": name}) for name, tip in some_rig().fingers.items()}
    return SimpleNamespace(fingers=tips, skin={name: surface(name) for name in tips})


def swinging(ratio, seconds=0.2):
    """Loads that change by a quarter, to and fro, 5 times a second, and do not turn, which would show friction."""
    times = np.arange(0, seconds, 0.002)
    return [np.array([load(ratio, 2 + 0.5 * np.sin(31 * t))] * len(FINGERS)) for t in times]


@pytest.mark.parametrize(
    ("loads", "taxels", "slips"),
    [
        (list(steady([load(0.46)] * 3, 0.1)), (), False),  # of a friction of 0.5
        (swinging(0.46), (), False),
        (swinging(0.46), FINGERS, True),
        (swinging(0.42), FINGERS, False),
        (list(steady([load(0.5)] * 3, 0.3)), FINGERS, False),
    ],
)
def test_tips_of_taxels_slip_where_they_may_be_at_their_limits_and_their_loads_are_not_constant(
    loads, taxels, slips
):
    """Their ratios are known to 5 %, so a rest just below the limit is told from a slide by its constant loads."""
    one = SlipDetector(tips_of_taxels(), (0.5, 0.02))
    said = [one.update(0.002 * k, FINGERS, row, taxels) for k, row in enumerate(loads, 1)]
    assert any(each.slipping for each in said) is slips


@pytest.mark.parametrize("seed", range(4))
def test_errors_of_taxels_that_last_longer_than_a_mean_do_not_contradict_a_weight(seed):
    names = list(rig().fingers)
    off = 0.015 * np.random.default_rng(seed).normal(size=(len(TILTS), len(names)))

    def lasting(seen):
        seen = functools.reduce(by_taxels, names, seen)
        factors = 1 + off[int(seen.stamp)]
        wrenches = zip(seen.wrenches.items(), factors, strict=True)
        return replace(seen, wrenches={name: factor * wrench for (name, wrench), factor in wrenches})

    frames = [rig().fingers[name].frame for name in names]
    found = weighed(Weigher(hand(*frames)), Held(), lasting)
    assert found.believed is not None, found.reason
    assert abs(found.believed.mass - MASS) < 3 * found.believed.sigma_mass


def test_tips_of_pressure_alone_are_contacts_and_no_evidence_of_slips_or_weight(can):
    robot, shapes = skin_scenes.with_taxels(can.rig, np.random.default_rng(0), components=1)
    tracker = hs.Tracker(robot, can.model)
    for observation in skin_scenes.taxel_observations(robot, shapes, can.observations[-40:], 3):
        tracker.update(observation)
    assert len(tracker.fingertips.fingers) >= 3
    assert set(tracker.slip.unmeasured) == set(tracker.fingertips.fingers)
    assert (tracker.slip.ratios, tracker.slip.slipping) == ({}, False)
    assert tracker.weight is None
