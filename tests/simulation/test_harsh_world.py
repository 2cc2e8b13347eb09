"""Nuisances of a harsh world: each does what it says, alone, and all are drawn by the seed."""

import dataclasses
import functools

import numpy as np
import pytest

import shared
from handsight import se3
from handsight.simulation import (
    Nuisances,
    Scenario,
    constant_errors,
    rig_of,
    simulate,
)
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.scenario import FINGERS
from handsight.simulation.scene import UNLOADED, tip_shape
from handsight.simulation.simulate import Sensors, samples
from handsight.simulation.tables import tables
from handsight.simulation.world import Payload, World
from simulation.simulated import NONE, only

USUAL = Nuisances()
ALONE = {
    "force_gain": {"force_gain": 0.03},
    "backlash": {"force_backlash": 0.05, "torque_backlash": 2.5e-4},
    "loss": {"message_loss": 0.2},
    "jitter": {"stamp_jitter": 0.004},
    "drift": {"vision_drift_position": 0.01, "vision_drift_rotation": 0.05, "vision_drift_time": 0.5},
}


@functools.cache
def together(base, motion="manipulate"):
    """By name, the samples with each nuisance of `ALONE` switched on beside some others, and `without`: one world. A
    lost sample is None."""
    variants = {"without": base} | {name: dataclasses.replace(base, **n) for name, n in ALONE.items()}
    base_scenario = Scenario(object="box", seed=3, motion=motion, rate=50.0, nuisances=base)
    world = World(base_scenario, grasp_for("box", 3))
    sensors = [Sensors(dataclasses.replace(base_scenario, nuisances=n), world) for n in variants.values()]
    columns = zip(*samples(base_scenario, world, sensors), strict=True)
    return dict(zip(variants, columns, strict=True))


def wrenches(samples):
    """(n, 5, 6) of the fingers, NaN where a message is lost."""
    silent = np.full(6, np.nan)
    return np.array([[s.observation.wrenches.get(f, silent) for f in FINGERS] for s in samples])


@pytest.mark.parametrize("name", ALONE)
def test_a_nuisance_changes_its_own_readings_and_leaves_all_others_bit_for_bit(name):
    changed = {
        "force_gain": "wrenches",
        "backlash": "wrenches",
        "jitter": "stamp",
        "drift": "vision",
        "loss": "",
    }
    runs = together(USUAL, "grasp")
    for a, b in zip(runs["without"], runs[name], strict=True):
        if b is None:
            continue
        np.testing.assert_array_equal(a.T_palm_object, b.T_palm_object)
        for f, wrench in b.observation.wrenches.items():
            same = np.array_equal(wrench, a.observation.wrenches[f])
            assert same or changed[name] == "wrenches"
        assert b.observation.joint_positions == a.observation.joint_positions
        assert b.observation.stamp == a.observation.stamp or changed[name] == "stamp"
        if b.observation.vision is not None:
            pose, alone = (s.observation.vision.T_frame_object for s in (b, a))
            assert np.array_equal(pose, alone) or changed[name] == "vision"


def test_gains_are_constant_and_of_the_stated_sigma():
    runs = together(NONE)
    true, wrong = (wrenches(runs[name]) - UNLOADED for name in ("without", "force_gain"))
    gains = constant_errors(Scenario(nuisances=only(**ALONE["force_gain"]), seed=3)).gains
    np.testing.assert_allclose(wrong, gains * true, atol=1e-12)
    drawn = [
        constant_errors(Scenario(nuisances=Nuisances(force_gain=0.03), seed=seed)).gains
        for seed in range(100)
    ]
    np.testing.assert_allclose(np.std(drawn), 0.03, rtol=0.1)


def test_a_reading_with_backlash_stays_until_the_force_has_moved_by_half_the_width():
    runs = together(NONE)
    true, stuck = wrenches(runs["without"]), wrenches(runs["backlash"])
    width = np.repeat([0.05, 2.5e-4], 3)
    off = (stuck - true) / width
    assert np.abs(off).max() < 1 + 1e-9
    assert (off.max(axis=0) > 0.9).mean() > 0.3  # both ends are met
    moves = np.abs(np.diff(stuck, axis=0)) > 1e-12
    np.testing.assert_allclose(np.abs(off[1:][moves]), 1, atol=1e-9)
    assert 0.05 < moves.mean() < 0.95


def test_messages_are_lost_with_the_stated_probability():
    runs = together(NONE)
    lost = runs["loss"]
    assert np.mean([s is None for s in lost]) == pytest.approx(0.2, abs=0.05)
    kept = [s for s in lost if s is not None]
    assert np.isnan(wrenches(kept)[..., 0]).mean() == pytest.approx(0.2, abs=0.03)
    due = [a for a, b in zip(runs["without"], lost, strict=True) if b is not None and a.observation.vision]
    seen = sum(s.observation.vision is not None for s in kept)
    assert 1 - seen / len(due) == pytest.approx(0.2, abs=0.1)


def test_stamps_are_late_by_the_jitter_at_most_and_stay_in_order():
    runs = together(NONE)
    late = np.array(
        [
            b.observation.stamp - a.observation.stamp
            for a, b in zip(runs["without"], runs["jitter"], strict=True)
        ]
    )
    assert late.min() >= 0
    assert 0.0035 < late.max() <= 0.004
    np.testing.assert_allclose(late.mean(), 0.002, rtol=0.1)
    wild = simulate(Scenario(rate=50.0, nuisances=only(stamp_jitter=1.0)))
    assert np.diff([s.observation.stamp for s in wild]).min() > 0


def test_visions_error_wanders_with_the_stated_size_and_correlation_time():
    T_mount_camera, centre = rig_of(Scenario()).camera.T_mount_camera, np.array([0.0, 0.02, 0.07])
    wrong = []
    for sample in together(NONE)["drift"]:
        if sample.observation.vision is not None:
            T = T_mount_camera @ sample.observation.vision.T_frame_object @ se3.inverse(sample.T_world_object)
            shift = se3.apply(T, centre[None])[0] - centre
            wrong.append([*shift / 0.01, *se3.rotation_log(T[:3, :3]) / 0.05])
    wrong = np.array(wrong)
    np.testing.assert_allclose(wrong.std(), 1, rtol=0.2)
    # Ten poses a second: neighbours are exp(-.1 / .5) correlated, those of a second exp(-2).
    assert np.mean(wrong[1:] * wrong[:-1]) / np.mean(wrong**2) == pytest.approx(np.exp(-0.2), abs=0.1)
    assert np.mean(wrong[10:] * wrong[:-10]) / np.mean(wrong**2) == pytest.approx(np.exp(-2), abs=0.2)


def test_true_tips_differ_from_the_rigs_as_drawn_and_by_two_sigma_at_most():
    nuisances = only(tip_size=2e-4)
    model, drawn = (
        Payload.of(Scenario(seed=5, nuisances=nuisances)).scene.model,
        constant_errors(Scenario(nuisances=nuisances, seed=5)).tips,
    )
    for finger, (wider, longer) in zip(FINGERS, drawn, strict=True):
        np.testing.assert_allclose(
            model.geom(f"{finger}_tip").size - tip_shape(finger)[0], [wider, wider, longer]
        )
    many = np.array([constant_errors(Scenario(nuisances=nuisances, seed=seed)).tips for seed in range(200)])
    assert np.abs(many).max() == pytest.approx(4e-4)
    np.testing.assert_allclose(many.std(), 2e-4, rtol=0.15)


def test_a_harsh_world_is_drawn_by_its_seed_from_the_stated_ranges():
    worlds = [Nuisances.harsh(seed) for seed in range(200)]
    assert Nuisances.harsh(7) == worlds[7] != worlds[8]
    for name, (low, high) in tables()["harsh"].items():
        drawn = np.array([getattr(world, name) for world in worlds])
        if name == "object_mass":
            drawn, (low, high) = np.log(drawn), np.log([low, high])
        assert low <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high
        np.testing.assert_allclose(drawn.mean(), (low + high) / 2, atol=0.1 * (high - low))
    others = {item.name for item in dataclasses.fields(Nuisances) if item.name not in tables()["harsh"]}
    assert all(getattr(worlds[0], name) == getattr(USUAL, name) for name in others)


def test_a_harsh_world_gives_the_same_samples_again():
    grasp = Scenario(object="box", seed=1, rate=50.0)
    harsh = dataclasses.replace(grasp, nuisances=Nuisances.harsh(1))
    runs = [list(simulate(harsh)) for _ in range(2)]
    assert [s.observation.stamp for s in runs[0]] == [s.observation.stamp for s in runs[1]]
    np.testing.assert_array_equal(wrenches(runs[0]), wrenches(runs[1]))
    assert len(runs[0]) < len(shared.simulated(grasp))
