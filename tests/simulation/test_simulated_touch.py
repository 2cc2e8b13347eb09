import numpy as np
import pytest

from handsight.simulation import Scenario, rig_of
from simulation.simulated import NONE, location_errors, only, samples, sensed
from testbed.touches import forces_object

SENSOR = {"force_noise": 0.01, "torque_noise": 5e-5}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "tips", "clean", "noisy"), [("can", 5, 60e-6, 200e-6), ("box", 3, 30e-6, 200e-6)]
)
def test_the_contact_point_follows_from_the_wrench(kind, tips, clean, noisy):
    for most, draws, nuisances in ((clean, 8, NONE), (noisy, 5, only(**SENSOR))):
        errors = [location_errors(samples(kind, seed, nuisances=nuisances)[-1]) for seed in range(draws)]
        assert np.mean([len(e) for e in errors]) > tips - 0.5
        assert np.mean(np.concatenate(errors)) < most


@pytest.mark.parametrize("kind", ["can", "box"])
def test_at_rest_a_sensor_measures_the_sum_of_the_forces_on_its_tip(kind):
    sample = samples(kind)[-1]
    for finger, (_, force_palm) in sensed(sample.observation).items():
        true = sum((t.force_palm for t in sample.contacts_truth if t.finger == finger), np.zeros(3))
        np.testing.assert_allclose(force_palm, true, atol=2e-3)


def test_an_open_hand_reads_bias_and_weight_alone():
    rig, first = rig_of(Scenario()), samples()[0]
    assert not first.contacts_truth
    for finger, raw in first.observation.wrenches.items():
        calibration = rig.fingers[finger].calibration
        # Whatever way gravity points, its force is the tip's weight.
        unloaded = np.linalg.norm(raw[:3] - calibration.bias_force)
        assert unloaded == pytest.approx(calibration.mass * 9.81, rel=0.02)
    assert all(np.linalg.norm(force) < 2e-3 for _, force in sensed(first.observation).values())


@pytest.mark.parametrize(("kind", "tips"), [("can", 5), ("box", 3)])
def test_in_the_air_the_tips_carry_the_objects_weight_and_inertia(kind, tips):
    """m (g - a), while the palm moves too: what is felt is of the very instant of the pose beside it."""
    run = samples(kind, motion="manipulate")
    assert len(forces_object(run[-1])) == tips
    position = np.array([s.T_world_object[:3, 3] for s in run])
    acceleration = np.diff(position, n=2, axis=0) * 10.0**2  # of run[1:-1], ten samples a second
    in_air = position[1:-1, 2] > position[0, 2] + 0.01
    assert in_air.sum() > 100
    assert np.ptp(acceleration[in_air], axis=0).max() > 0.3
    for sample, a in zip(np.array(run, dtype=object)[1:-1][in_air], acceleration[in_air], strict=True):
        total_palm = sum(force for _, force in sensed(sample.observation).values())
        total_world = sample.observation.T_world_palm[:3, :3] @ total_palm
        np.testing.assert_allclose(total_world, 0.15 * ([0, 0, -9.81] - a), atol=0.03)


def test_bias_and_drift_add_to_what_a_sensor_reads():
    clean = samples()
    biased = samples(nuisances=only(force_bias=0.05, torque_bias=2.5e-4))
    drifting = samples(nuisances=only(force_drift=0.1, torque_drift=1e-3))
    for finger in "ff", "th":
        of = [[s.observation.wrenches[finger] for s in run] for run in (clean, biased, drifting)]
        bias, drift = np.array(of[1]) - of[0], np.array(of[2]) - of[0]
        np.testing.assert_allclose(bias, np.broadcast_to(bias[0], bias.shape), atol=1e-12)
        assert 0.005 < np.abs(bias[0, :3]).max() < 0.25
        stamps = np.array([s.observation.stamp for s in clean])
        np.testing.assert_allclose(drift, stamps[:, None] * drift[-1] / stamps[-1], atol=1e-12)
        assert 0.01 < np.abs(drift[-1, :3]).max() < 1


def test_sensor_noise_has_the_stated_sigma():
    clean, noisy = (samples(rate=100.0, nuisances=n) for n in (NONE, only(**SENSOR)))
    noise = np.array(
        [
            [b.observation.wrenches[f] - a.observation.wrenches[f] for f in a.observation.wrenches]
            for a, b in zip(clean, noisy, strict=True)
        ]
    )
    np.testing.assert_allclose(noise[..., :3].std(), 0.01, rtol=0.05)
    np.testing.assert_allclose(noise[..., 3:].std(), 5e-5, rtol=0.05)


def test_a_tip_deflects_under_force_and_the_joints_do_not_measure_it():
    compliance = 1e-4
    hard, soft = samples("can")[-1], samples("can", nuisances=only(tip_compliance=compliance))[-1]
    rig = rig_of(Scenario())
    away = [rig.hand.Ts_palm_tip(s.observation.joint_positions) for s in (hard, soft)]
    for i, (finger, (_, force_palm)) in enumerate(sensed(hard.observation).items()):
        center = rig.fingers[finger].T_frame_surface[:, 3]
        moved = ((away[0][i] - away[1][i]) @ center)[:3]
        np.testing.assert_allclose(
            moved, compliance * force_palm, atol=0.15 * compliance * np.linalg.norm(force_palm)
        )


def test_joints_are_exact_without_nuisances_and_off_by_a_constant_and_noise_with_them():
    offset, noise = np.deg2rad(1.0), np.deg2rad(0.1)
    clean = samples(rate=100.0)
    wrong = samples(rate=100.0, nuisances=only(joint_offset=offset, joint_noise=noise))
    a, b = (np.array([list(s.observation.joint_positions.values()) for s in run]) for run in (clean, wrong))
    assert np.abs((b - a).mean(axis=0)).max() < 4 * offset
    np.testing.assert_allclose((b - a).mean(axis=0).std(), offset, rtol=0.4)
    np.testing.assert_allclose((b - a).std(axis=0).mean(), noise, rtol=0.1)
    names = list(clean[0].observation.joint_positions)
    assert len(names) == 24
    assert set(names) == set(rig_of(Scenario()).hand.joint_names)
