"""A Kalman filter over measurements of a state whose first numbers do a random walk and whose others are constant."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry


@entry
def filter_walk(rows: Any, values: Any, walked: Any, mean: Any, covariance: Any) -> None:
    """Mean (n,) and covariance (n, n) of a Gaussian state before the first measurement become those at the last.

    `rows` (k, m, n), `values` (k, m): k linear measurements in the order of time, each whitened. `walked` (k, w): by
    how much the variance of the state's first w numbers grows before each.
    """
    n, gain = len(mean), np.empty(len(mean))
    for k in range(len(rows)):
        for i in range(walked.shape[1]):
            covariance[i, i] += walked[k, i]
        # What is whitened can be taken in one number at a time.
        for m in range(rows.shape[1]):
            row, innovation, variance = rows[k, m], values[k, m], 1.0
            for i in range(n):
                gain[i] = 0.0
                for j in range(n):
                    gain[i] += covariance[i, j] * row[j]
                variance += row[i] * gain[i]
                innovation -= row[i] * mean[i]
            for i in range(n):
                mean[i] += gain[i] * innovation / variance
                for j in range(i + 1):
                    covariance[i, j] -= gain[i] * gain[j] / variance
                    covariance[j, i] = covariance[i, j]


def warm() -> None:
    """Compiles the kernel, or loads it."""
    filter_walk(np.zeros((1, 1, 2)), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(2), np.eye(2))
