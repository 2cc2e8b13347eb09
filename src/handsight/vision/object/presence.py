"""Whether a pose that an image supports is one where the object is."""

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array

MOST_UNEXPLAINED, LEAST = 2.0, 30.0
"""Of the pixels expected; and those at least."""
EVIDENCE = np.array([-9.53, 14.95, -7.72, 6.6, -18.67])
"""What the numbers of `evidence_of` are worth in the logarithm of the odds (`experiments/sight_fit.py`). Shares alone:
sums, and how close points lie, tell more of drawn pictures, and lead a real camera's astray."""


def evidence_of(candidates: NDArray[np.void]) -> Array:
    """Returns (k, 5) of CANDIDATE (k,): one; of the expected pixels the shares explained, seen past, hidden and left
    over."""
    size = np.maximum(candidates["expected"], LEAST)
    shares = [candidates[name] / size for name in ("explained", "passed", "hidden")]
    left = np.minimum(candidates["unexplained"] / size, MOST_UNEXPLAINED)
    return np.stack([np.ones(len(candidates)), *shares, left], axis=1)


def log_odds(candidates: NDArray[np.void]) -> Array:
    """Returns (k,) that the object is where CANDIDATE (k,) have it, against that it is not."""
    return np.asarray(evidence_of(candidates) @ EVIDENCE)


def probabilities(odds: Array) -> Array:
    """Returns (n,) of answers with such log odds (n,) against none of them: with that of none, their sum is 1."""
    most = max(float(odds.max(initial=0.0)), 0.0)
    here = np.exp(odds - most)
    return np.asarray(here / (here.sum() + np.exp(-most)))
