"""Mean and covariance of a correction's posterior by a plain, slow sampler: what its integrals are judged by."""

from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from handsight.correction import modes, solve
from handsight.correction.correct import problem_of
from handsight.correction.mean import across_axes, known_information
from handsight.objects.symmetry import tangents
from testbed.report import Array

CHAINS = 64
"""Markov chains that move at once."""
ACCEPTANCE = 0.35
"""The share of accepted steps that strides are tuned to: about where mixing is fastest."""


def sampled(
    model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior | None, samples: int, **evidence: Any
) -> hs.PoseEstimate:
    """Returns the default estimate with the mean and the covariance of draws from the posterior around its maximum.

    `evidence`: further arguments of `correct_pose`. Markov chains (Metropolis) move along the eigenvectors of the
    information; not about a declared symmetry axis, with which the covariance is None.
    """
    estimate = hs.correct_pose(model, contacts, vision=vision, **evidence)
    problem, _ = problem_of(model, contacts, vision, **evidence)
    used = np.ones((1, len(problem.contacts)), dtype=bool)
    used[0, list(estimate.outliers)] = False
    T_mode = estimate.T_palm_object_maximum
    axes = tangents(model.symmetries, T_mode)
    basis = across_axes(axes, model.radius)
    values, vectors = np.linalg.eigh(basis @ modes.in_metres(estimate.information, model.radius) @ basis.T)
    length = 1 / np.sqrt(np.maximum(values, 1 / model.radius**2))
    directions = (vectors.T @ basis) * length[:, None] * np.repeat([1.0, 1 / model.radius], 3)

    def log_density(Ts: Array) -> Array:
        return -solve.cost(problem, Ts, used) / 2

    draws = _metropolis(log_density, T_mode, directions, max(samples, CHAINS))
    T, spread = se3.moved(T_mode, draws.mean(axis=0)), np.cov(draws.T)
    known = known_information(model, T, spread)
    return estimate.with_gaussian(T, None if len(axes) else spread, known, solve.residuals(problem, T))


def _metropolis(log_density: Any, T_mode: Array, directions: Array, samples: int) -> Array:
    """Returns (samples, 6) perturbations (δp [m], δθ [rad]) of the mode, drawn from a density.

    `log_density`: poses (c, 4, 4) to its logarithm (c,). `directions` (k, 6): steps of about one standard deviation.
    """
    rng = np.random.default_rng(0)
    kept = -(-samples // CHAINS)
    burn_in = max(kept, 100)
    at = np.repeat(T_mode[None], CHAINS, axis=0)
    density = log_density(at)
    stride = np.ones(len(directions))
    draws = []
    for step in range(burn_in + kept):
        j = step % len(directions)
        proposal = se3.moved(at, rng.normal(size=(CHAINS, 1)) * stride[j] * directions[j])
        proposed = log_density(proposal)
        accepted = np.log(rng.random(CHAINS)) < proposed - density
        at = np.where(accepted[:, None, None], proposal, at)
        density = np.where(accepted, proposed, density)
        if step < burn_in:
            stride[j] *= np.exp(accepted.mean() - ACCEPTANCE)
        else:
            draws.append(se3.difference(at, T_mode))
    return np.concatenate(draws)[:samples]
