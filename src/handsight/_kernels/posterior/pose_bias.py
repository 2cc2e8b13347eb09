"""The smoother's steps: what vision should measure, the distance of a measurement from that, and the posterior.

A state is `Ts` (2, 4, 4) and `rest` (7). `Ts` are `T_palm_object`, and vision's bias `T_measured_true` about a pivot,
along the axes of the mount (what the camera is fixed to). `rest` are vision's drift (6), a shift of the object's origin
and a turn along the mount's axes, and its latency [s]. Its covariance (19, 19) is of the perturbations (δp, δθ) of the
pose, along the palm's axes, of those of the bias, of the drift and of the latency. A measurement's rows are
`H | innovation` (6, 20), where innovation = measured - expected = H (truth - state) + noise.

The drift is an Ornstein-Uhlenbeck process: c(t + s) = a c(t) + noise, a = exp(-s / τ), of a constant variance. `drift`
(3) has that variance for a position and for a rotation, and τ. A measurement contains `drift_gain` times the drift.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.jit import entry, inner
from handsight._kernels.math.dense6 import factor, solve
from handsight._kernels.math.so3 import rotation_exp, rotation_log
from handsight._kernels.math.symmetry import store_transform, transform_of
from handsight._kernels.math.vec3 import (
    Vec3,
    add,
    dot,
    matmul,
    mul,
    norm,
    skew,
    store,
    sub,
    sub33,
    transpose,
    vector,
)

POSES, LATENCY, STATE = 12, 18, 19
"""Size of a perturbation of pose and bias; the row of the latency; the size of the state with drift and latency."""


@inner
def _palm(one: Any, latency: float) -> Pose:
    """Returns the palm's pose in the mount when a MEASUREMENT was taken: as much earlier as the latency exceeds the one
    that it was placed with."""
    R, p = transform_of(one.T_mount_palm)
    since = latency - one.latency
    if since == 0.0:
        return R, p
    back = (-since * one.twist[3], -since * one.twist[4], -since * one.twist[5])
    shift = (-since * one.twist[0], -since * one.twist[1], -since * one.twist[2])
    return matmul(rotation_exp(back), R), add(p, shift)


@inner
def _expected(Ts: Any, pivot: Vec3, palm: Pose) -> Pose:
    """Returns the pose of the object that vision should measure from a palm: E (T_mount_palm T_palm_object), E being
    the bias about the pivot."""
    (R, p), (Q, q), (E, e) = palm, transform_of(Ts[0]), transform_of(Ts[1])
    place = add(p, mul(R, q))
    return matmul(E, matmul(R, Q)), add(add(pivot, e), mul(E, sub(place, pivot)))


@inner
def _store_difference(pose: Pose, reference: Pose, out: Any) -> None:
    """Fills `out` (6) with the perturbation (δp, δθ) from the reference to a pose."""
    store(sub(pose[1], reference[1]), out)
    store(rotation_log(matmul(pose[0], transpose(reference[0]))), out[3:])


@inner
def _move(T: Any, step: Any) -> None:
    """Moves a pose (4, 4) by the perturbation (δp, δθ) (6)."""
    R, p = transform_of(T)
    turn = rotation_exp(vector(step[3:]))
    store_transform((matmul(turn, R), add(p, vector(step))), T)


@inner
def linearize(Ts: Any, latency: float, pivot: Vec3, one: Any, rows: Any) -> None:
    """Fills in the rows `H | innovation` (6, 20) of a MEASUREMENT; the expected drift is not yet in the innovation.

    With R the palm's rotation in the mount and E, e the bias: a shift and a turn of the object appear in the
    measurement turned by E R; a perturbation of the bias moves it about the pivot, from which it is ℓ away:
    [I, -[ℓ]x; 0, I]. A latency moves it back along the velocity of the object with the palm.
    """
    palm = _palm(one, latency)
    expected = _expected(Ts, pivot, palm)
    E, e = transform_of(Ts[1])
    by_object = matmul(E, palm[0])
    by_turn = skew(sub(sub(expected[1], pivot), e))
    omega = vector(one.twist[3:])
    velocity = mul(E, add(vector(one.twist), mul(skew(omega), mul(palm[0], transform_of(Ts[0])[1]))))
    turning = mul(E, omega)
    for i in range(6):
        for j in range(STATE):
            rows[i, j] = 1.0 if j == 6 + i else 0.0
        rows[i, POSES + i] = one.drift_gain
    for i in range(3):
        for j in range(3):
            rows[i, j] = rows[3 + i, 3 + j] = by_object[i][j]
            rows[i, 9 + j] = -by_turn[i][j]
        rows[i, LATENCY] = -velocity[i]
        rows[3 + i, LATENCY] = -turning[i]
    off = np.empty(6)
    _store_difference(transform_of(one.T_mount_object), expected, off)
    for i in range(6):
        rows[i, STATE] = off[i]


@inner
def _decay(covariance: Any, mean: Any, drift: Any, seconds: float) -> None:
    """Brings a state's covariance (19, 19) and mean (19) on in time, as far as the drift is concerned."""
    kept = np.exp(-seconds / drift[2])
    for i in range(POSES, LATENCY):
        mean[i] *= kept
        for j in range(STATE):
            covariance[i, j] *= kept
            covariance[j, i] *= kept
        covariance[i, i] += (1.0 - kept * kept) * drift[(i - POSES) // 3]


@inner
def _whiten(factored: Any, rows: Any) -> None:
    """Turns `rows` (6, m) into L⁻¹ rows, where `factored` holds the factor of their covariance L Lᵀ."""
    for i in range(6):
        for k in range(i):
            for j in range(rows.shape[1]):
                rows[i, j] -= factored[i, k] * rows[k, j]
        for j in range(rows.shape[1]):
            rows[i, j] *= factored[i, i]


@inner
def _update(rows: Any, mean: Any, covariance: Any) -> float:
    """Turns a Gaussian (n) into its posterior after a whitened measurement `H | innovation` (6, n + 1), one row at a
    time (Kalman); returns the χ² of the measurement before."""
    n, gain, chi2 = len(mean), np.empty(len(mean)), 0.0
    for m in range(len(rows)):
        innovation, variance = rows[m, n], 1.0
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += covariance[i, j] * rows[m, j]
            gain[i] = total
            variance += rows[m, i] * total
            innovation -= rows[m, i] * mean[i]
        chi2 += innovation * innovation / variance
        for i in range(n):
            share = gain[i] / variance
            mean[i] += share * innovation
            for j in range(n):
                covariance[i, j] -= share * gain[j]
    return chi2


@entry
def expect(Ts: Any, pivot: Any, T_mount_palm: Any, T: Any) -> None:
    """Fills `T` (4, 4) with the pose that vision should measure, in the mount, but for its drift."""
    store_transform(_expected(Ts, vector(pivot), transform_of(T_mount_palm)), T)


@entry
def propagate(covariance: Any, rest: Any, drift: Any, seconds: float) -> None:
    """Brings the drift in `rest` (7), and in a covariance (19, 19), on in time."""
    mean = np.zeros(STATE)
    mean[POSES:] = rest
    _decay(covariance, mean, drift, seconds)
    rest[:] = mean[POSES:]


@entry
def distance2(Ts: Any, rest: Any, covariance: Any, pivot: Any, measurement: Any) -> float:
    """Returns χ² (six degrees of freedom) of a MEASUREMENT (1), given a state with its covariance; infinite where the
    covariance of its noise is not positive definite."""
    rows, factored, spread = np.empty((6, STATE + 1)), np.empty((6, 6)), covariance.copy()
    linearize(Ts, rest[6], vector(pivot), measurement[0], rows)
    if not factor(measurement[0].covariance, 6, 0.0, factored):
        return np.inf
    _whiten(factored, rows)
    mean = np.zeros(STATE)
    mean[POSES:LATENCY] = rest[:6]
    return _update(rows, mean, spread)


@entry
def smooth(
    Ts_prior: Any,
    rest_prior: Any,
    prior: Any,
    pivot: Any,
    drift: Any,
    measurements: Any,
    Ts: Any,
    rest: Any,
    covariance: Any,
) -> bool:
    """Writes the posterior at the time of the last measurement; returns False where the covariance of a measurement's
    noise is not positive definite.

    `Ts` and `rest`, the last answer, become the maximum a posteriori of a prior with covariance `prior` and all
    `measurements` (k) MEASUREMENT, by Gauss-Newton; `covariance` is written. A step is a Kalman filter over the
    measurements, in the order of time, with every derivative taken at one state. So the object's random walk since an
    older measurement is an error common to all that are as old, and measurements share vision's drift the more, the
    nearer they are in time.
    """
    rows, factored, step = np.empty((6, STATE + 1)), np.empty((6, 6)), np.empty(STATE)
    joint, back = np.empty((POSES, POSES)), np.empty(POSES)
    center = vector(pivot)
    for _ in range(2):  # steps for each new measurement; the error that they leave is removed with the next
        for i in range(2):
            _store_difference(transform_of(Ts_prior[i]), transform_of(Ts[i]), step[6 * i : 6 * i + 6])
        step[POSES:] = rest_prior
        step[LATENCY] -= rest[6]
        for i in range(STATE):
            for j in range(STATE):
                covariance[i, j] = prior[i, j]
        for k in range(len(measurements)):
            one = measurements[k]
            for i in range(6):
                before = measurements[k - 1].process_noise[i] if k else 0.0
                covariance[i, i] += one.process_noise[i] - before
            _decay(covariance, step, drift, one.time - (measurements[k - 1].time if k else 0.0))
            linearize(Ts, rest[6], center, one, rows)
            if not factor(one.covariance, 6, 0.0, factored):
                return False
            _whiten(factored, rows)
            _update(rows, step, covariance)
        for i in range(2):
            _move(Ts[i], step[6 * i : 6 * i + 6])
        rest[:6] = step[POSES:LATENCY]
        rest[6] += step[LATENCY]
        # A palm that turns fast turns by some radians a second.
        turned = max(norm(vector(step[3:])), norm(vector(step[9:])), abs(step[LATENCY]))
        if factor(covariance, POSES, 0.0, joint):
            solve(joint, POSES, step, back)
            left = 0.0
            for i in range(POSES):
                left += step[i] * back[i]
            # A step that turns by an angle leaves at most that fraction of itself: here a χ² of a hundredth of a
            # standard deviation, squared.
            if turned * turned * left < 1e-4:
                break
    return True


@inner
def _average(old: Any, new: Any, Ts: Any, latency: float, pivot: Vec3, drift: Any) -> bool:
    """Replaces the newer of two measurements by their mean, weighted by their information, as one from the older's palm
    pose; returns whether that was possible.

    The older is first brought to the newer's time: its covariance grows by the object's random walk in between, and its
    drift, a c + w with c the drift at the newer's time, by the part w that the two do not share.
    """
    palm, other_palm = _palm(old, latency), _palm(new, latency)
    R, expected = palm[0], _expected(Ts, pivot, palm)
    both, factored, rows = np.empty((6, 6)), np.empty((6, 6)), np.zeros((6, 7))
    innovation, other = np.empty(6), np.empty(6)
    _store_difference(transform_of(old.T_mount_object), expected, innovation)
    _store_difference(transform_of(new.T_mount_object), _expected(Ts, pivot, other_palm), other)
    gain = old.drift_gain * np.exp((old.time - new.time) / drift[2])
    for i in range(6):
        rows[i, i], rows[i, 6] = 1.0, other[i]
        for j in range(6):
            both[i, j] = old.covariance[i, j]
        both[i, i] += (old.drift_gain**2 - gain**2) * drift[i // 3]
    for a in range(0, 6, 3):
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    step = new.process_noise[a + k] - old.process_noise[a + k]
                    both[a + i, a + j] += R[i][k] * step * R[j][k]
    if not factor(new.covariance, 6, 0.0, factored):
        return False
    _whiten(factored, rows)
    share = 0.0  # of the newer in the mean, on average over the six directions
    for i in range(6):
        share += both[i, i] / 6
    before = share
    _update(rows, innovation, both)
    for i in range(6):
        share -= both[i, i] / 6
        for j in range(6):
            new.covariance[i, j] = (both[i, j] + both[j, i]) / 2
    share /= before
    for i in range(6):
        new.twist[i] = (1 - share) * old.twist[i] + share * new.twist[i]
    new.drift_gain = (1 - share) * gain + share * new.drift_gain
    new.latency, new.began = latency, old.began
    store_transform(palm, new.T_mount_palm)
    store_transform(expected, new.T_mount_object)
    _move(new.T_mount_object, innovation)
    return True


@entry
def merge(measurements: Any, most: int, same: Any, Ts: Any, latency: float, pivot: Any, drift: Any) -> int:
    """Returns how many of the measurements (k + 1) MEASUREMENT, in the order of time, are left after the last, which is
    new, was merged with the one before it, if their palms are nearer than `same` [m], [rad], and that one began at most
    `same[2]` correlation times ago; or, if there are more than `most`, after those two neighbours were merged whose
    palms are nearest.

    Only neighbours in time are merged, because what was measured in between shares the drift of both.
    """
    last, best, least = len(measurements) - 1, 0, np.inf
    length_per_turn = 0.1  # that a radian counts as [m]
    if last == 0:
        return 1
    for k in range(last if last < most else 1, last + 1):
        (R, p), (Q, q) = (
            transform_of(measurements[k - 1].T_mount_palm),
            transform_of(measurements[k].T_mount_palm),
        )
        # Two rotations differ, entry by entry, by √8 times the sine of half the angle between them.
        rest = sub33(R, Q)
        square = dot(rest[0], rest[0]) + dot(rest[1], rest[1]) + dot(rest[2], rest[2])
        shift, turn = norm(sub(p, q)), 2 * np.arcsin(min(np.sqrt(square / 8), 1.0))
        age = (measurements[k].time - measurements[k - 1].began) / drift[2]
        near = k == last and shift <= same[0] and turn <= same[1] and age <= same[2]
        if near or (last >= most and shift + length_per_turn * turn < least):
            best, least = k, shift + length_per_turn * turn
    if best == 0 or not _average(
        measurements[best - 1], measurements[best], Ts, latency, vector(pivot), drift
    ):
        return last + 1
    for k in range(best - 1, last):
        measurements[k] = measurements[k + 1]
    return last
