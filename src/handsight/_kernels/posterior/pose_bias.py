"""The smoother's steps: what vision should measure, the distance of a measurement from that, and the posterior.

A state is `Ts` (2, 4, 4): `T_palm_object`, and vision's bias `T_measured_true` about a pivot, along the axes of the
mount (what the camera is fixed to). Its covariance (12, 12) is of the perturbations (δp, δθ) of the pose, along the
palm's axes, and of the bias. A measurement's rows are `H | innovation` (6, 13), where innovation = measured - expected
= H (truth - state) + noise.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.math.dense6 import factor, solve
from handsight._kernels.math.so3 import rotation_exp, rotation_log
from handsight._kernels.math.symmetry import store_transform, transform_of
from handsight._kernels.math.vec3 import (
    Vec3,
    add,
    dot,
    matmul,
    matrix,
    mul,
    norm,
    skew,
    store,
    sub,
    sub33,
    transpose,
    vector,
)
from handsight._kernels.runtime.compilation import entry, inner

STATE = 12
"""Size of a perturbation of pose and bias."""


@inner
def _expected(Ts: Any, pivot: Vec3, T_mount_palm: Any) -> Pose:
    """Returns the pose of the object that vision should measure from a palm: E (T_mount_palm T_palm_object), E being
    the bias about the pivot."""
    (R, p), (Q, q), (E, e) = transform_of(T_mount_palm), transform_of(Ts[0]), transform_of(Ts[1])
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
def linearize(Ts: Any, pivot: Vec3, one: Any, rows: Any) -> None:
    """Fills in the rows `H | innovation` (6, 13) of a MEASUREMENT.

    With R the palm's rotation in the mount and E, e the bias: a shift and a turn of the object appear in the
    measurement turned by E R; a perturbation of the bias moves it about the pivot, from which it is ℓ away:
    [I, -[ℓ]x; 0, I].
    """
    expected = _expected(Ts, pivot, one.T_mount_palm)
    _, e = transform_of(Ts[1])
    by_object = matmul(matrix(Ts[1]), matrix(one.T_mount_palm))
    by_turn = skew(sub(sub(expected[1], pivot), e))
    for i in range(6):
        for j in range(STATE):
            rows[i, j] = 1.0 if j == 6 + i else 0.0
    for i in range(3):
        for j in range(3):
            rows[i, j] = rows[3 + i, 3 + j] = by_object[i][j]
            rows[i, 9 + j] = -by_turn[i][j]
    off = np.empty(6)
    _store_difference(transform_of(one.T_mount_object), expected, off)
    for i in range(6):
        rows[i, STATE] = off[i]


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
    """Fills `T` (4, 4) with the pose that vision should measure, in the mount."""
    store_transform(_expected(Ts, vector(pivot), T_mount_palm), T)


@entry
def distance2(Ts: Any, covariance: Any, pivot: Any, measurement: Any) -> float:
    """Returns χ² (six degrees of freedom) of a MEASUREMENT (1), given a state with its covariance; infinite where the
    covariance of its noise is not positive definite."""
    rows, factored, spread = np.empty((6, STATE + 1)), np.empty((6, 6)), covariance.copy()
    linearize(Ts, vector(pivot), measurement[0], rows)
    if not factor(measurement[0].covariance, 6, 0.0, factored):
        return np.inf
    _whiten(factored, rows)
    return _update(rows, np.zeros(STATE), spread)


@entry
def smooth(Ts_prior: Any, prior: Any, pivot: Any, measurements: Any, Ts: Any, covariance: Any) -> bool:
    """Writes the posterior at the time of the last measurement; returns False where the covariance of a measurement's
    noise is not positive definite.

    `Ts`, the last answer, becomes the maximum a posteriori of a prior with covariance `prior` and all `measurements`
    (k) MEASUREMENT, by Gauss-Newton; `covariance` is written. A step is a Kalman filter over the measurements, in the
    order of time, with every derivative taken at one state. So the object's random walk since an older measurement is
    an error common to all that are as old.
    """
    rows, factored, step = np.empty((6, STATE + 1)), np.empty((6, 6)), np.empty(STATE)
    joint, back = np.empty((STATE, STATE)), np.empty(STATE)
    center = vector(pivot)
    for _ in range(2):  # steps for each new measurement; the error that they leave is removed with the next
        for i in range(2):
            _store_difference(transform_of(Ts_prior[i]), transform_of(Ts[i]), step[6 * i : 6 * i + 6])
        for i in range(STATE):
            for j in range(STATE):
                covariance[i, j] = prior[i, j]
        for k in range(len(measurements)):
            one = measurements[k]
            for i in range(6):
                before = measurements[k - 1].process_noise[i] if k else 0.0
                covariance[i, i] += one.process_noise[i] - before
            linearize(Ts, center, one, rows)
            if not factor(one.covariance, 6, 0.0, factored):
                return False
            _whiten(factored, rows)
            _update(rows, step, covariance)
        for i in range(2):
            _move(Ts[i], step[6 * i : 6 * i + 6])
        turned = max(norm(vector(step[3:])), norm(vector(step[9:])))
        if factor(covariance, STATE, 0.0, joint):
            solve(joint, STATE, step, back)
            left = 0.0
            for i in range(STATE):
                left += step[i] * back[i]
            # A step that turns by an angle leaves at most that fraction of itself: here a χ² of a hundredth of a
            # standard deviation, squared.
            if turned * turned * left < 1e-4:
                break
    return True


@inner
def _average(old: Any, new: Any, Ts: Any, pivot: Vec3) -> bool:
    """Replaces the newer of two measurements by their mean, weighted by their information, as one from the older's palm
    pose; returns whether that was possible.

    The older is first brought to the newer's time: its covariance grows by the object's random walk in between.
    """
    R, expected = matrix(old.T_mount_palm), _expected(Ts, pivot, old.T_mount_palm)
    both, factored, rows = np.empty((6, 6)), np.empty((6, 6)), np.zeros((6, 7))
    innovation, other = np.empty(6), np.empty(6)
    _store_difference(transform_of(old.T_mount_object), expected, innovation)
    _store_difference(transform_of(new.T_mount_object), _expected(Ts, pivot, new.T_mount_palm), other)
    for i in range(6):
        rows[i, i], rows[i, 6] = 1.0, other[i]
        for j in range(6):
            both[i, j] = old.covariance[i, j]
    for a in range(0, 6, 3):
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    drift = new.process_noise[a + k] - old.process_noise[a + k]
                    both[a + i, a + j] += R[i][k] * drift * R[j][k]
    if not factor(new.covariance, 6, 0.0, factored):
        return False
    _whiten(factored, rows)
    _update(rows, innovation, both)
    for i in range(6):
        for j in range(6):
            new.covariance[i, j] = (both[i, j] + both[j, i]) / 2
    for i in range(4):
        for j in range(4):
            new.T_mount_palm[i, j] = old.T_mount_palm[i, j]
    store_transform(expected, new.T_mount_object)
    _move(new.T_mount_object, innovation)
    return True


@entry
def merge(measurements: Any, most: int, same: Any, Ts: Any, pivot: Any) -> int:
    """Returns how many of the measurements (k + 1) MEASUREMENT, in the order of time, are left after the last, which is
    new, was merged with that of the nearest palm: if there are more than `most`, or if it is nearer than `same` [m],
    [rad]."""
    last, best, least, near = len(measurements) - 1, 0, np.inf, False
    length_per_turn = 0.1  # that a radian counts as [m]
    new = measurements[last]
    for k in range(last):
        (R, p), (Q, q) = transform_of(measurements[k].T_mount_palm), transform_of(new.T_mount_palm)
        # Two rotations differ, entry by entry, by √8 times the sine of half the angle between them.
        rest = sub33(R, Q)
        square = dot(rest[0], rest[0]) + dot(rest[1], rest[1]) + dot(rest[2], rest[2])
        shift, turn = norm(sub(p, q)), 2 * np.arcsin(min(np.sqrt(square / 8), 1.0))
        if shift + length_per_turn * turn < least:
            best, least = k, shift + length_per_turn * turn
            near = shift <= same[0] and turn <= same[1]
    if last == 0 or not (near or last >= most):
        return last + 1
    if not _average(measurements[best], new, Ts, vector(pivot)):
        return last + 1
    for k in range(best, last):
        measurements[k] = measurements[k + 1]
    return last
