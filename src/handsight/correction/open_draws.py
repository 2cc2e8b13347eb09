"""Draws from a posterior along what the contacts leave open, where its highest mode says little.

Under a face, a point that should be outside says that the face is too deep, not in which direction it ends; and the
density has a step wherever an edge passes a taxel. So along an array it has no slope, but a comb of narrow modes. It is
drawn from by adaptive importance sampling: each round is about the likeliest draws of those before, and all draws are
weighted by the ratio of the posterior to the mixture of all rounds (Cornuet et al., Adaptive multiple importance
sampling, 2012). Across the open directions a Gauss-Newton step leads from a draw to the best pose, and the rest counts
as Gaussian there (`correction/kernels/lattice.py`).
"""

from functools import partial

import numpy as np

from handsight import se3
from handsight._compiled.records import FLAT_DIRECTIONS, LATTICE_POINT
from handsight._compiled.threads import in_parts
from handsight.checks import Array, Indices
from handsight.correction import modes
from handsight.correction.few_contacts import FREEDOM, Mixture
from handsight.correction.kernels import batch
from handsight.correction.kernels.integration_options import INTEGRATION
from handsight.correction.mean import across_axes
from handsight.correction.problem import Problem, Records
from handsight.objects import ObjectModel
from handsight.objects.symmetry import tangents

FIRST_DRAWS = 384  # from what contacts and vision leave open
MORE_DRAWS = 1536  # the same where the evidence fits at none of their modes
EACH = 96  # of a round
MOST = 1152  # besides the first ones, after which no round follows
CENTERS = 16  # draws that a round is about
NARROWER = 0.5  # factor on the spread about every other one, as modes are narrower
LEAST = 24
"""How many draws a round's centers count for: weights are flattened, by a power, until they do."""
ENOUGH = 80  # the same of draws after which no round follows
KEPT = 12  # likeliest draws that are starts


def draw(
    problem: Problem, T_palm_object: Array, information: Array, first: int
) -> tuple[Array, Array, Array]:
    """Returns the likeliest poses (k, 4, 4), and the mean (4, 4) and the covariance (6, 6) of the posterior.

    It is drawn from around the pose (4, 4) and the information (6, 6) that the contacts alone lead to, along the
    object's own axes, so that another palm frame changes nothing. `first`: the number of draws from these.
    """
    rng = np.random.default_rng(first)
    T = T_palm_object
    flat, directions, widths = _open_directions(problem.model, T, information)
    d = len(directions)
    given = problem.arguments(problem.everyone)
    mixture = Mixture(np.zeros((1, d)), np.diag(widths)[None], np.ones(1))
    mixtures = list[Mixture]()
    points = np.zeros(0, LATTICE_POINT)
    density = np.zeros(0)
    lateral = np.zeros((EACH, 6))
    while True:
        new = np.zeros(EACH, LATTICE_POINT)
        standard = rng.normal(size=(len(new), 6)) @ directions.T
        standard /= np.sqrt(rng.chisquare(FREEDOM, (len(new), 1)) / FREEDOM)
        new["index"][:, :d] = mixture.draws(standard)
        new["lateral"] = lateral
        in_parts(partial(batch.visit_all, *given, T, flat), (new,), EACH // 2)
        there = sum((m.density(new["index"][:, :d]) for m in mixtures), np.zeros(len(new)))
        mixtures.append(mixture)
        points = np.append(points, new)
        density = np.append(density, there) + mixture.density(points["index"][:, :d])
        flat["most_cost"] = points["cost"].min() + 2 * INTEGRATION.given_up
        # Where the evidence fits nowhere, all logarithms may be -inf; then all draws count alike.
        logs = np.maximum(points["log_weight"], -1e300) - np.log(density)
        enough = _effective(np.exp(logs - logs.max())) >= ENOUGH
        if len(points) >= first and (enough or len(points) >= first + MOST):
            break
        if len(points) >= first:
            mixture, chosen = _next_round(points["index"][:, :d], logs, rng)
            lateral = points["lateral"][np.repeat(chosen, EACH // CENTERS)]
    weights = _flattened(logs, LEAST)
    best = np.argsort(points["cost"], kind="stable")[:KEPT]
    mean = weights @ points["moved"]
    off = points["moved"] - mean
    C = off.T @ (off * weights[:, None]) + np.einsum("k,kij", weights, points["within"])
    return se3.moved(T, points["moved"][best]), se3.moved(T, mean), C


def _open_directions(
    model: ObjectModel, T_palm_object: Array, information: Array
) -> tuple[Records, Array, Array]:
    """Returns (1,) FLAT_DIRECTIONS for `visit_all`, and those of its directions that an information (6, 6) leaves open,
    at least one: (d, 6) along the object's own axes, and their widths (d,) [m]."""
    own = np.eye(6)
    flat = np.zeros(1, FLAT_DIRECTIONS)
    own[:3, :3] = own[3:, 3:] = T_palm_object[:3, :3]
    basis = across_axes(tangents(model.symmetries, T_palm_object), model.radius) @ own
    of_basis = basis @ own.T @ modes.in_metres(information, model.radius) @ own @ basis.T
    values, vectors = np.linalg.eigh(of_basis)
    directions = vectors.T @ basis
    widths = 1 / np.sqrt(np.maximum(values, model.radius**-2))
    wide = np.count_nonzero(widths > INTEGRATION.narrow_sigma * model.radius)
    d = int(np.clip(wide, 1, INTEGRATION.max_directions))
    along = own @ directions.T
    flat["count"] = d
    flat["count_across"] = len(values) - d
    flat["stretch"] = 1.0
    flat["most_cost"] = np.inf
    flat["lattice"][0, :, :d] = along[:, :d]
    flat["across"][0, :, : len(values) - d] = along[:, d:]
    return flat, directions[:d], widths[:d]


def _next_round(x: Array, logs: Array, rng: np.random.Generator) -> tuple[Mixture, Indices]:
    """Returns the mixture that the next round draws from, about some of the draws (n, d) so far, whose weights have
    these logarithms (n,); and which ones these are.

    Every other one is chosen by weights that are flattened, so that early rounds spread; the others, by plain weights,
    are drawn about more closely.
    """
    at = (np.arange(CENTERS) + rng.random()) / CENTERS
    weights = _flattened(logs, LEAST)
    d = x.shape[1]
    chosen, plain = (np.searchsorted(np.cumsum(w), at) for w in (weights, _flattened(logs, 1.0)))
    chosen[1::2] = plain[1::2]
    chosen = np.minimum(chosen, len(x) - 1)
    off = x - weights @ x
    values, vectors = np.linalg.eigh(off.T @ (off * weights[:, None]))
    # Silverman's rule for the width of a density kernel.
    width = (4 / ((d + 2) * LEAST)) ** (1 / (d + 4))
    root = (vectors * (width * np.sqrt(np.maximum(values, 1e-12)))) @ vectors.T
    roots = np.repeat(root[None], CENTERS, axis=0)
    roots[1::2] *= NARROWER
    return Mixture(x[chosen], roots, np.full(CENTERS, 1 / CENTERS)), chosen


def _effective(weights: Array) -> Array:
    """Returns how many draws (...) weights (..., n) count for (Kish's effective sample size)."""
    return np.asarray(weights.sum(axis=-1) ** 2 / (weights**2).sum(axis=-1))


def _flattened(logs: Array, least: float) -> Array:
    """Returns weights (n,) that sum to one: those of these logarithms (n,), to the highest power of up to 1 at which
    so many count."""
    weights = np.exp(np.outer(0.8 ** np.arange(30), logs - logs.max()))
    chosen = weights[np.argmax(_effective(weights) >= least)]
    return np.asarray(chosen / chosen.sum())
