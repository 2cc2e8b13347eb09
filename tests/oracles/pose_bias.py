"""Pose and vision's bias from what vision measured, in plain steps: the slow truth of the smoother's kernels."""

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


def mahalanobis2(Ts, covariance, pivot, T_mount_palm, T_mount_object, noise):
    H = jacobian(Ts, pivot, T_mount_palm)
    innovation = se3.difference(T_mount_object, expected(Ts, pivot, T_mount_palm))
    return innovation @ np.linalg.solve(H @ covariance @ H.T + noise, innovation)


def posterior(Ts_prior, prior, pivot, measurements, Ts, steps=20):
    """Ts and covariance (12, 12) when the last of the measurements came: one linear problem after another.

    Unknown are the state when the last came and each step of the walk between two, so that an earlier measurement is
    of the state less the steps since.
    """
    n = len(measurements)
    walked = np.diff(measurements["process_noise"], axis=0)
    for _ in range(steps):
        rows, values, weights = [], [], []
        # The prior is of the state before the first, less all steps.
        first = np.zeros((12, 12 + 6 * (n - 1)))
        first[:, :12] = np.eye(12)
        first[:6, 12:] = -np.tile(np.eye(6), n - 1)
        before = prior + np.diag(np.concatenate([measurements["process_noise"][0], np.zeros(6)]))
        rows.append(first)
        values.append(se3.difference(Ts_prior, Ts).reshape(12))
        weights.append(np.linalg.inv(before))
        for k, one in enumerate(measurements):
            H = jacobian(Ts, pivot, one["T_mount_palm"])
            row = np.zeros((6, 12 + 6 * (n - 1)))
            row[:, :12] = H
            row[:, 12 + 6 * k :] = -np.tile(H[:, :6], n - 1 - k)
            rows.append(row)
            at = expected(Ts, pivot, one["T_mount_palm"])
            values.append(se3.difference(one["T_mount_object"], at))
            weights.append(np.linalg.inv(one["covariance"]))
        information = sum(J.T @ W @ J for J, W in zip(rows, weights, strict=True))
        information[12:, 12:] += np.diag(1 / walked.ravel())
        slope = sum(J.T @ W @ r for J, W, r in zip(rows, weights, values, strict=True))
        covariance = np.linalg.inv(information)
        Ts = moved(Ts, (covariance @ slope)[:12])
    return Ts, covariance[:12, :12]
