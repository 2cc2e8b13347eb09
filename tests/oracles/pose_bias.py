"""Pose and vision's errors from what vision measured, in plain steps: the slow truth of the smoother's kernels."""

import numpy as np

from handsight import se3


def biased(T_mount_object, T_measured_true, pivot):
    """The pose (4, 4) as vision measures it, with the bias (4, 4) about `pivot` (3,)."""
    about = np.eye(4)
    about[:3, 3] = pivot
    return about @ T_measured_true @ se3.inverse(about) @ T_mount_object


def expected(Ts, pivot, T_mount_palm):
    return biased(T_mount_palm @ Ts[0], Ts[1], pivot)


def moved(Ts, step):
    return se3.moved(Ts, step.reshape(2, 6))


def jacobian(Ts, pivot, T_mount_palm, h=1e-6):
    """(6, 12) of what vision should measure, by central differences."""
    at = expected(Ts, pivot, T_mount_palm)

    def measured(step):
        return se3.difference(expected(moved(Ts, step), pivot, T_mount_palm), at)

    return np.stack([(measured(h * e) - measured(-h * e)) / (2 * h) for e in np.eye(12)], axis=1)


def palm(one, latency):
    """The palm's pose in the mount when a MEASUREMENT was taken."""
    return se3.moved(one["T_mount_palm"], (one["latency"] - latency) * one["twist"])


def rows(Ts, latency, pivot, one, h=1e-6):
    """(6, 19) the derivative of a MEASUREMENT, and (6,) how far it is from what is expected without drift."""
    T = palm(one, latency)
    at, sides = expected(Ts, pivot, T), [expected(Ts, pivot, palm(one, latency + s)) for s in (h, -h)]
    by_latency = (se3.difference(sides[0], at) - se3.difference(sides[1], at)) / (2 * h)
    H = np.hstack([jacobian(Ts, pivot, T), one["drift_gain"] * np.eye(6), by_latency[:, None]])
    return H, se3.difference(one["T_mount_object"], at)


def mahalanobis2(Ts, rest, covariance, pivot, one):
    H, innovation = rows(Ts, rest[6], pivot, one)
    innovation = innovation - one["drift_gain"] * rest[:6]
    return innovation @ np.linalg.solve(H @ covariance @ H.T + one["covariance"], innovation)


def posterior(Ts_prior, rest_prior, prior, pivot, drift, measurements, Ts, steps=20):
    """Ts, rest and covariance (19, 19) when the last of the measurements came: one linear problem after another.

    Unknown are the state at the prior, each step of the walk before a measurement, and by how much the drift at each
    measurement differs from what is left of the first: jointly Gaussian, with the exponential covariance.
    """
    n, latency, t = len(measurements), rest_prior[6], measurements["time"]
    walked = np.diff(measurements["process_noise"], axis=0, prepend=np.zeros((1, 6)))
    left = np.exp(-t / drift[2])
    shared = np.exp(-np.abs(t[:, None] - t) / drift[2]) - left[:, None] * left
    unknown = np.zeros((19 + 12 * n, 19 + 12 * n))
    unknown[:19, :19] = prior
    unknown[19 : 19 + 6 * n, 19 : 19 + 6 * n] = np.diag(walked.ravel())
    unknown[19 + 6 * n :, 19 + 6 * n :] = np.kron(shared, np.diag(np.repeat(drift[:2], 3)))

    def at(k):
        """(19, ...) the state when a measurement came."""
        A = np.zeros((19, len(unknown)))
        A[:, :19] = np.eye(19)
        A[12:18, 12:18] *= left[k]
        A[:6, 19 : 19 + 6 * (k + 1)] = np.tile(np.eye(6), k + 1)
        A[12:18, 19 + 6 * n + 6 * k :][:, :6] = np.eye(6)
        return A

    for _ in range(steps):
        given = [rows(Ts, latency, pivot, one) for one in measurements]
        H = np.vstack([one[0] @ at(k) for k, one in enumerate(given)])
        mean = np.zeros(len(unknown))
        mean[:19] = np.concatenate([se3.difference(Ts_prior, Ts).reshape(12), rest_prior])
        mean[18] -= latency
        S = H @ unknown @ H.T
        for k in range(n):
            S[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += measurements["covariance"][k]
        gain = np.linalg.solve(S, H @ unknown).T
        last = at(n - 1) @ (mean + gain @ (np.concatenate([one[1] for one in given]) - H @ mean))
        covariance = at(n - 1) @ (unknown - gain @ H @ unknown) @ at(n - 1).T
        Ts, latency = moved(Ts, last[:12]), latency + last[18]
    return Ts, np.append(last[12:18], latency), covariance
