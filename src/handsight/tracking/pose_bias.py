"""What vision should measure, how far a measurement is from that, and the mean of two measurements.

A state is `Ts` (2, 4, 4) and `rest` (7). `Ts` are `T_palm_object`, and vision's bias `T_measured_true` about a pivot,
along the axes of the mount (what the camera is fixed to). `rest` are vision's drift (6), a shift of the object's origin
and a turn along the mount's axes, and its latency [s]. Its covariance (19, 19) is of the perturbations (δp, δθ) of the
pose, along the palm's axes, of those of the bias, of the drift and of the latency. A measurement's rows are
`H | innovation` (6, 20), where innovation = measured - expected = H (truth - state) + noise.

The drift is an Ornstein-Uhlenbeck process: c(t + s) = a c(t) + noise, a = exp(-s / τ), of a constant variance. `drift`
(3) has that variance for a position and for a rotation, and τ. A measurement contains `drift_gain` times the drift.
"""

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.checks import Array
from handsight.gaussian_pose import kalman_update

POSES = slice(0, 12)
BIAS = slice(6, 12)
DRIFT = slice(12, 18)
LATENCY = 18
INNOVATION = 19
LENGTH_PER_TURN = 0.1  # that a radian counts as where the nearest palms are merged [m]

MEASUREMENT = np.dtype([
    ("T_mount_palm", float, (4, 4)),
    ("T_mount_object", float, (4, 4)),
    ("covariance", float, (6, 6)),  # of the noise, along the mount's axes
    ("process_noise", float, 6),  # variance of the object's random walk in the palm from the prior to it
    ("twist", float, 6),  # of the palm in the mount
    ("latency", float),  # that the palm's pose was placed with [s]
    ("time", float),  # since the prior, and that of the first of those that were merged [s]
    ("began", float),
    ("drift_gain", float),
])  # fmt: skip
"""A pose from vision, or several merged."""
Measurements = NDArray[np.void]


def palms(measurements: Measurements, latency: float) -> Array:
    """Returns the palm's poses (k, 4, 4) in the mount when measurements were taken: as much earlier as the latency
    exceeds the one that they were placed with."""
    since = latency - measurements["latency"]
    return se3.moved(measurements["T_mount_palm"], -since[:, None] * measurements["twist"])


def expected(Ts: Array, pivot: Array, T_mount_palm: Array) -> Array:
    """Returns the object's poses (..., 4, 4) that vision should measure from poses of the palm (..., 4, 4), but for the
    drift: E (T_mount_palm T_palm_object), E being the bias about the pivot."""
    T = T_mount_palm @ Ts[0]
    E = Ts[1, :3, :3]
    shift = Ts[1, :3, 3]
    return se3.compose(E @ T[..., :3, :3], pivot + shift + (T[..., :3, 3] - pivot) @ E.T)


def rows(Ts: Array, latency: float, pivot: Array, measurements: Measurements) -> Array:
    """Returns the rows (k, 6, 20) of measurements; the expected drift is not yet in the innovation.

    With R the palm's rotation in the mount and E, e the bias: a shift and a turn of the object appear in the
    measurement turned by E R; a perturbation of the bias moves it about the pivot, from which it is ℓ away:
    [I, -[ℓ]x; 0, I]. A latency moves it back along the velocity of the object with the palm.
    """
    T_mount_palm = palms(measurements, latency)
    R = T_mount_palm[:, :3, :3]
    at = expected(Ts, pivot, T_mount_palm)
    E = Ts[1, :3, :3]
    lever = at[:, :3, 3] - pivot - Ts[1, :3, 3]
    velocity = measurements["twist"][:, :3]
    omega = measurements["twist"][:, 3:]
    arm = R @ Ts[0, :3, 3]
    carried = np.einsum("kij,kj->ki", se3.skew(omega), arm)
    found = np.zeros((len(measurements), 6, 20))
    found[:, :3, :3] = E @ R
    found[:, 3:, 3:6] = E @ R
    found[:, :, BIAS] = np.eye(6)
    found[:, :3, 9:12] = -se3.skew(lever)
    found[:, :, DRIFT] = measurements["drift_gain"][:, None, None] * np.eye(6)
    found[:, :3, LATENCY] = -(velocity + carried) @ E.T
    found[:, 3:, LATENCY] = -omega @ E.T
    found[:, :, INNOVATION] = se3.difference(measurements["T_mount_object"], at)
    return found


def whitening(covariances: Array) -> Array:
    """Returns the factors (k, 6, 6) that give rows noise of unit variance; raises LinAlgError for covariances (k, 6, 6)
    that are not positive definite."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariances)))


def distance2(rows: Array, noise: Array, rest: Array, covariance: Array) -> float:
    """Returns χ² (six degrees of freedom) of a measurement's rows (6, 20) with their noise (6, 6), given a state's
    `rest` (7) and its covariance (19, 19)."""
    H = rows[:, :INNOVATION]
    off = rows[:, INNOVATION] - H[:, DRIFT] @ rest[:6]
    return float(off @ np.linalg.solve(H @ covariance @ H.T + noise, off))


def drifted(covariance: Array, rest: Array, drift: Array, seconds: float) -> tuple[Array, Array]:
    """Returns a state's covariance (19, 19) and `rest` (7) so much later, as far as the drift is concerned."""
    kept = np.exp(-seconds / drift[2])
    factor = np.ones(len(covariance))
    factor[DRIFT] = kept
    later = covariance * factor[:, None] * factor
    later[DRIFT, DRIFT] += (1 - kept**2) * np.diag(np.repeat(drift[:2], 3))
    return later, rest * factor[DRIFT.start :]


def merged(
    measurements: Measurements, most: int, same: Array, Ts: Array, latency: float, pivot: Array, drift: Array
) -> Measurements:
    """Returns measurements (k), in the order of time, of which the last is new, with two neighbours replaced by their
    mean.

    These are the last two, if their palms are nearer than `same` [m, rad] and the older began at most `same[2]`
    correlation times ago; else, of more than `most`, those two whose palms are nearest. Only neighbours in time are
    merged, because what was measured in between shares the drift of both.
    """
    if len(measurements) == 1:
        return measurements
    T = measurements["T_mount_palm"]
    off = se3.difference(T[1:], T[:-1])
    shift = np.linalg.norm(off[:, :3], axis=1)
    turn = np.linalg.norm(off[:, 3:], axis=1)
    age = (measurements["time"][-1] - measurements["began"][-2]) / drift[2]
    is_same = shift[-1] <= same[0] and turn[-1] <= same[1] and age <= same[2]
    if not is_same and len(measurements) <= most:
        return measurements
    first = len(off) - 1 if is_same else int(np.argmin(shift + LENGTH_PER_TURN * turn))
    pair = measurements[first : first + 2]
    mean = _mean(pair, Ts, latency, pivot, drift)
    return np.concatenate([measurements[:first], mean, measurements[first + 2 :]])


def _mean(pair: Measurements, Ts: Array, latency: float, pivot: Array, drift: Array) -> Measurements:
    """Returns the mean (1,) of an older and a newer measurement, weighted by their information, as one from the older's
    palm pose.

    The older is first brought to the newer's time: its covariance grows by the object's random walk in between, and its
    drift, a c + w with c the drift at the newer's time, by the part w that the two do not share.
    """
    old, new = pair
    T_mount_palm = palms(pair, latency)
    at = expected(Ts, pivot, T_mount_palm)
    off = se3.difference(pair["T_mount_object"], at)
    gain = old["drift_gain"] * np.exp((old["time"] - new["time"]) / drift[2])
    walked = np.diag(new["process_noise"] - old["process_noise"])
    own_drift = (old["drift_gain"] ** 2 - gain**2) * np.diag(np.repeat(drift[:2], 3))
    before = old["covariance"] + own_drift + se3.rotate_covariance(T_mount_palm[0, :3, :3], walked)
    step, after = kalman_update(before, np.eye(6), off[1] - off[0], new["covariance"])
    share = 1 - np.trace(after) / np.trace(
        before
    )  # of the newer in the mean, on average over the six directions
    mean = pair[1:].copy()
    mean["T_mount_palm"] = T_mount_palm[0]
    mean["T_mount_object"] = se3.moved(at[0], off[0] + step)
    mean["covariance"] = after
    mean["twist"] = (1 - share) * old["twist"] + share * new["twist"]
    mean["drift_gain"] = (1 - share) * gain + share * new["drift_gain"]
    mean["latency"] = latency
    mean["began"] = old["began"]
    return mean
