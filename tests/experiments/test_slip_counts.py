"""What counts as a slip that was noticed."""

import numpy as np
import pytest

from experiments.shared import slips

PERIOD = 0.004


def told(alarm, slip, speed=0.02, samples=500):
    """Alarms and speeds of a run with one of each, from when to when [s]."""
    stamps = 1.0 + PERIOD * np.arange(samples)
    alarms = (stamps >= alarm[0] - 1e-9) & (stamps < alarm[1] - 1e-9)
    speeds = np.where((stamps >= slip[0] - 1e-9) & (stamps < slip[1] - 1e-9), speed, 1e-4)
    return alarms, speeds, stamps


def test_a_delay_is_from_slip_to_alarm_and_below_zero_before():
    assert slips.delays(*told((1.52, 1.8), (1.5, 1.8))) == [pytest.approx(0.02)]
    assert slips.delays(*told((1.4, 1.8), (1.5, 1.8))) == [pytest.approx(-0.1)]
    assert slips.delays(*told((1.9, 1.95), (1.5, 1.8))) == [None]


def test_samples_are_counted_as_slipping_creeping_or_holding():
    alarms, speeds, _ = told((1.4, 1.8), (1.5, 1.7))
    found = slips.counted(alarms, speeds, PERIOD)
    assert (found["alarmed"], found["slipped"], found["found"]) == (100, 50, 50)
    assert found["right"] == found["strict"] == 50 + 2 * round(slips.NEAR / PERIOD)
    creeping = slips.counted(*told((1.4, 1.8), (1.5, 1.7), speed=0.001)[:2], PERIOD)
    assert (creeping["strict"], creeping["slipped"], creeping["right"]) == (0, 0, 60)


def test_a_pull_is_drawn_by_its_seed():
    one, same, other = (slips.scenario("box", seed, 100.0) for seed in (7, 7, 8))
    assert one == same
    assert one.nuisances != other.nuisances
    assert (one.nuisances.pull_torque > 0) is not (other.nuisances.pull_torque > 0)
    assert 0.3 <= one.nuisances.friction <= 0.8
