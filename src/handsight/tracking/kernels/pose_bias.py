"""A Kalman filter over the measurements of the smoother (`tracking/pose_bias.py`), which runs at every image."""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry

POSE = 6  # where the pose ends among the state's numbers,
DRIFT = 12  # where the drift begins,
LATENCY = 18  # and where it ends


@entry
def follow(rows: Any, walked: Any, gaps: Any, drift: Any, mean: Any, covariance: Any) -> None:
    """Turns a Gaussian, `mean` (19,) and `covariance` (19, 19), into its posterior after whitened measurements.

    Before each of them the pose walks at random, with variances `walked` (k, 6), and the drift decays for `gaps` (k)
    [s]. `rows` (k, 6, 20) are `H | innovation`; one row is used at a time.
    """
    n = len(mean)
    gain = np.empty(n)
    for k in range(len(rows)):
        kept = np.exp(-gaps[k] / drift[2])
        for i in range(POSE):
            covariance[i, i] += walked[k, i]
        for i in range(DRIFT, LATENCY):
            mean[i] *= kept
            for j in range(n):
                covariance[i, j] *= kept
                covariance[j, i] *= kept
            covariance[i, i] += (1.0 - kept * kept) * drift[(i - DRIFT) // 3]
        for m in range(6):
            innovation = rows[k, m, n]
            variance = 1.0
            for i in range(n):
                gain[i] = 0.0
                for j in range(n):
                    gain[i] += covariance[i, j] * rows[k, m, j]
                variance += rows[k, m, i] * gain[i]
                innovation -= rows[k, m, i] * mean[i]
            for i in range(n):
                share = gain[i] / variance
                mean[i] += share * innovation
                for j in range(n):
                    covariance[i, j] -= share * gain[j]
