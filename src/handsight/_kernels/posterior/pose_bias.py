"""The steps of the smoother: what vision should measure, how far a pose is from that, and the posterior of all of them.

A state is `Ts` (2, 4, 4): `T_palm_object`, and vision's bias `T_measured_true`, along the mount's axes, both about a
pivot; its covariance (12, 12) is of the perturbations (δp, δθ) of the pose, along the palm's axes, and of the bias. A
measurement's rows are `H | innovation` (6, 13), innovation = measured less expected = H (true less state) + noise.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Pose
from handsight._kernels.evidence.prior_term import rotation_exp, rotation_log
from handsight._kernels.math.dense6 import factor, solve
from handsight._kernels.math.symmetry import store_transform, transform_of
from handsight._kernels.math.vec3 import (
    Vec3,
    add,
    matmul,
    matrix,
    mul,
    norm,
    skew,
    store,
    sub,
    transpose,
    vector,
)
from handsight._kernels.runtime.compilation import entry, inner

STATE = 12
"""Numbers of a perturbation of pose and bias."""
GAUSS_NEWTON_STEPS = 2
"""For each measurement; what they leave comes with the next."""
SMALL_STEP = 1e-4
"""χ² of what a step leaves to the next: a hundredth of a standard deviation. Of a step that turns by an angle, at most
that part of it is left."""
LENGTH_PER_TURN = 0.1
"""What a radian counts as [m] when palms are compared."""


@inner
def _measured(Ts: Any, pivot: Vec3, T_mount_palm: Any) -> Pose:
    """Returns where vision should see the object from a palm: E (T_mount_palm T_palm_object), E the bias about the
    pivot."""
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
    """Moves a pose (4, 4) after the perturbation (δp, δθ) (6)."""
    R, p = transform_of(T)
    turn = rotation_exp(vector(step[3:]))
    store_transform((matmul(turn, R), add(p, vector(step))), T)


@inner
def linearize(Ts: Any, pivot: Vec3, one: Any, rows: Any) -> None:
    """Fills `rows` (6, 13) of a MEASUREMENT.

    With the palm in the mount R, the bias E, e: a shift of the object moves what is measured by E R, a turn turns it by
    as much; the bias shifts and turns it by itself, about the pivot, from which it is ℓ off: [I, -[ℓ]x; 0, I].
    """
    expected = _measured(Ts, pivot, one.T_mount_palm)
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
    """Turns `rows` (6, m) into L⁻¹ rows, of a covariance L Lᵀ that is `factored`."""
    for i in range(6):
        for k in range(i):
            for j in range(rows.shape[1]):
                rows[i, j] -= factored[i, k] * rows[k, j]
        for j in range(rows.shape[1]):
            rows[i, j] *= factored[i, i]


@inner
def _take_in(rows: Any, mean: Any, covariance: Any) -> float:
    """Returns a Gaussian after a whitened measurement (6, 13), one number at a time (Kalman); its χ² before."""
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
    store_transform(_measured(Ts, vector(pivot), T_mount_palm), T)


@entry
def distance2(Ts: Any, covariance: Any, pivot: Any, measurement: Any) -> float:
    """Returns χ² (six degrees of freedom) of a MEASUREMENT (1) against what a state expects; infinite where its noise
    is no covariance."""
    rows, factored, spread = np.empty((6, STATE + 1)), np.empty((6, 6)), covariance.copy()
    linearize(Ts, vector(pivot), measurement[0], rows)
    if not factor(measurement[0].covariance, 6, 0.0, factored):
        return np.inf
    _whiten(factored, rows)
    return _take_in(rows, np.zeros(STATE), spread)


@entry
def smooth(Ts_prior: Any, prior: Any, pivot: Any, measurements: Any, Ts: Any, covariance: Any) -> bool:
    """Returns the posterior when the last of the measurements came; False where the noise of one is no covariance.

    `Ts`, the last answer, becomes the maximum a posteriori of a prior with covariance `prior` and all `measurements`
    (k) MEASUREMENT, by Gauss-Newton; `covariance` is written. A step is a Kalman filter over the measurements, in the
    order of time, with every derivative taken at one state: what the object has walked since an older one is common to
    all that are as old.
    """
    rows, factored, step = np.empty((6, STATE + 1)), np.empty((6, 6)), np.empty(STATE)
    joint, back = np.empty((STATE, STATE)), np.empty(STATE)
    center = vector(pivot)
    for _ in range(GAUSS_NEWTON_STEPS):
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
            _take_in(rows, step, covariance)
        for i in range(2):
            _move(Ts[i], step[6 * i : 6 * i + 6])
        turned = max(norm(vector(step[3:])), norm(vector(step[9:])))
        if factor(covariance, STATE, 0.0, joint):
            solve(joint, STATE, step, back)
            left = 0.0
            for i in range(STATE):
                left += step[i] * back[i]
            if turned * turned * left < SMALL_STEP:
                break
    return True


@inner
def _copy(one: Any, out: Any) -> None:
    """Copies a measurement, field by field, for numba assigns no record whole."""
    for i in range(4):
        for j in range(4):
            out.T_mount_palm[i, j] = one.T_mount_palm[i, j]
            out.T_mount_object[i, j] = one.T_mount_object[i, j]
    for i in range(6):
        out.process_noise[i] = one.process_noise[i]
        for j in range(6):
            out.covariance[i, j] = one.covariance[i, j]


@inner
def _age(one: Any, process_noise: Any, covariance: Any) -> None:
    """Writes the `covariance` (6, 6) of a measurement, were it from when the object had walked by `process_noise`
    (6)."""
    R = matrix(one.T_mount_palm)
    for i in range(6):
        for j in range(6):
            covariance[i, j] = one.covariance[i, j]
    for a in range(0, 6, 3):
        for i in range(3):
            for j in range(3):
                for k in range(3):
                    motion_variance = process_noise[a + k] - one.process_noise[a + k]
                    covariance[a + i, a + j] += R[i][k] * motion_variance * R[j][k]


@inner
def _average(old: Any, new: Any, Ts: Any, pivot: Vec3) -> bool:
    """Returns the newer of two measurements becomes both, from the older's palm: innovations weighted by their
    information."""
    expected = _measured(Ts, pivot, old.T_mount_palm)
    aged, factored, rows = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 7))
    innovation, other = np.empty(6), np.empty(6)
    _store_difference(transform_of(old.T_mount_object), expected, innovation)
    _store_difference(transform_of(new.T_mount_object), _measured(Ts, pivot, new.T_mount_palm), other)
    _age(old, new.process_noise, aged)
    # With A the older's covariance, L Lᵀ that of the difference and W = L⁻¹ A: A - Wᵀ W is that of both.
    for i in range(6):
        for j in range(6):
            rows[i, j] = aged[i, j]
            factored[i, j] = aged[i, j] + new.covariance[i, j]
        rows[i, 6] = other[i] - innovation[i]
    if not factor(factored.copy(), 6, 0.0, factored):
        return False
    _whiten(factored, rows)
    for i in range(6):
        for k in range(6):
            innovation[i] += rows[k, i] * rows[k, 6]
        for j in range(6):
            for k in range(6):
                aged[i, j] -= rows[k, i] * rows[k, j]
    for i in range(6):
        for j in range(6):
            new.covariance[i, j] = (aged[i, j] + aged[j, i]) / 2
    for i in range(4):
        for j in range(4):
            new.T_mount_palm[i, j] = old.T_mount_palm[i, j]
    store_transform(expected, new.T_mount_object)
    _move(new.T_mount_object, innovation)
    return True


@inner
def _angles_between(a: Any, b: Any) -> tuple[float, float]:
    """Returns how far palms (4, 4) are from each other [m], [rad]."""
    shift, square = sub((a[0, 3], a[1, 3], a[2, 3]), (b[0, 3], b[1, 3], b[2, 3])), 0.0
    for i in range(3):
        for j in range(3):
            square += (a[i, j] - b[i, j]) ** 2
    # Two rotations differ by √8 times the sine of half the angle between them.
    return norm(shift), 2 * np.arcsin(min(np.sqrt(square / 8), 1.0))


@entry
def merge(measurements: Any, most: int, same: Any, Ts: Any, pivot: Any) -> int:
    """Returns how many of the measurements (k + 1) MEASUREMENT are left when the last, which is new, has become one
    with that of the nearest palm, if there are more than `most` or it is nearer than `same` [m], [rad]; in the order
    of time."""
    last, best, least = len(measurements) - 1, 0, np.inf
    new, near = measurements[last], False
    for k in range(last):
        shift, turn = _angles_between(measurements[k].T_mount_palm, new.T_mount_palm)
        if shift + LENGTH_PER_TURN * turn < least:
            best, least = k, shift + LENGTH_PER_TURN * turn
            near = not (shift > same[0] or turn > same[1])
    if last == 0 or not (near or last >= most):
        return last + 1
    if not _average(measurements[best], new, Ts, vector(pivot)):
        return last + 1
    for k in range(best, last):
        _copy(measurements[k + 1], measurements[k])
    return last
