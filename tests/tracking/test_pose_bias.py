"""What vision should measure, and the smoother's posterior, against slow and plain oracles."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from handsight import se3
from handsight.tracking import pose_bias
from handsight.tracking.pose_bias import MEASUREMENT
from handsight.tracking.smoother import PoseAndBias, PoseBiasSmoother
from oracles import pose_bias as oracle

SEEDS = st.integers(0, 2**32 - 1)
SIGMAS = np.array([0.005] * 3 + [0.05] * 3)
DRIFT = np.array([0.01**2, 0.05**2, 2.0])
SAME = np.array([0.01, 0.03, 0.5])


def some(rng, count, spread=0.02):
    """A state with its covariance, a pivot, and measurements of it from palms all around, that move."""
    Ts = np.stack([se3.random(rng, spread=0.1), se3.moved(np.eye(4), rng.normal(size=6) * 0.1)])
    root, pivot = 0.02 * rng.normal(size=(19, 19)), rng.normal(scale=0.3, size=3)
    rest = rng.normal(size=7) * np.repeat([0.01, 0.05, 0.05], [3, 3, 1])
    measurements = np.zeros(count, dtype=MEASUREMENT)
    for one in measurements:
        one["T_mount_palm"], one["twist"] = se3.random(rng, spread=0.3), rng.normal(size=6) * 0.3
        one["latency"], one["drift_gain"] = rng.normal() * 0.03, rng.uniform(0.5, 1)
        at = oracle.expected(Ts, pivot, oracle.palm(one, rest[6]))
        L = SIGMAS[:, None] * (np.eye(6) + 0.3 * rng.normal(size=(6, 6)))
        one["T_mount_object"], one["covariance"] = se3.moved(at, spread * rng.normal(size=6)), L @ L.T
    measurements["process_noise"] = np.cumsum(rng.uniform(1e-6, 1e-4, size=(count, 6)), axis=0)
    measurements["time"] = measurements["began"] = np.cumsum(rng.uniform(0.1, 1, size=count))
    return Ts, rest, root @ root.T + 1e-6 * np.eye(19), pivot, measurements


@given(SEEDS)
def test_the_rows_are_the_derivative_of_what_vision_should_measure_and_how_far_it_is_off(seed):
    Ts, rest, _, pivot, measurements = some(np.random.default_rng(seed), 1)
    one = measurements[0]
    (rows,) = pose_bias.rows(Ts, rest[6], pivot, measurements)
    at = pose_bias.expected(Ts, pivot, one["T_mount_palm"])
    np.testing.assert_allclose(at, oracle.expected(Ts, pivot, one["T_mount_palm"]), atol=1e-12)
    H, off = oracle.rows(Ts, rest[6], pivot, one)
    np.testing.assert_allclose(rows[:, :19], H, atol=1e-8)
    np.testing.assert_allclose(rows[:, 19], off, atol=1e-12)


@settings(max_examples=10)
@given(SEEDS, st.integers(1, 4))
def test_the_posterior_is_that_of_a_dense_gaussian_with_an_exponential_covariance(seed, count):
    rng = np.random.default_rng(seed)
    Ts_true, rest, prior, pivot, measurements = some(rng, count, spread=0.003)
    prior[18] *= 0.1  # a latency of tens of milliseconds
    prior[:, 18] *= 0.1
    off = np.linalg.cholesky(prior) @ rng.normal(size=19) / 10
    before = PoseAndBias(oracle.moved(Ts_true, off[:12]), prior, rest + off[12:])
    now = {"process_noise": measurements["process_noise"][-1], "time": measurements["time"][-1]}
    smoother = PoseBiasSmoother(before, pivot, before, measurements=measurements, drift=DRIFT, **now)
    for _ in range(10):  # each goes on from the last answer
        smoother = smoother.with_prior(before)
    found = smoother.now
    given_ = before.Ts, before.rest, prior, pivot, DRIFT, measurements
    expected, others, spread = oracle.posterior(*given_, before.Ts)
    sigmas = np.sqrt(spread.diagonal())
    off = np.concatenate([se3.difference(found.Ts, expected).reshape(12), found.rest - others]) / sigmas
    np.testing.assert_allclose(off, 0, atol=1e-4)
    scale = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(found.covariance / scale, spread / scale, atol=1e-5)


def test_measurements_from_palms_apart_or_long_ago_stay_until_they_are_too_many():
    Ts, rest, _, pivot, measurements = some(np.random.default_rng(0), 4)
    given_ = SAME, Ts, rest[6], pivot, DRIFT
    before = measurements.copy()
    assert len(pose_bias.merged(measurements, 4, *given_)) == 4
    measurements["T_mount_palm"][3], measurements["time"][3] = measurements["T_mount_palm"][2], 20.0
    left = pose_bias.merged(measurements, 4, *given_)
    assert len(left) == 4
    np.testing.assert_array_equal(left[:3], before[:3])
    assert len(pose_bias.merged(measurements, 3, *given_)) == 3
