"""The modes of a posterior by few contacts on a surface with much detail: their means and covariances from draws.

With three or four contacts such a posterior has dozens of minima beside each other, none of them a Gaussian. So it is
drawn from by importance sampling: the draws are from a mixture of Student's t about the minima that a search has found,
with tails that reach those beside them, and each is weighted by the ratio of its densities.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array, Mask
from handsight.correction import modes, solve
from handsight.correction.kernels.search_options import SEARCH
from handsight.correction.problem import Problem, Records

NUMBER = 384
NUMBER_SINGLE = 192  # where there is one minimum
LEAST_DEPARTURE = 3
"""One minimum is drawn about where the cost beside it rises by this factor more than a Gaussian's. Up to there the
lattice of `correction/kernels/mean.py`, which is faster, leaves out as little."""
MOST_OUTSIDE = 8  # points of the hand and planes; with more, the draws' costs take too long
MOST_MINIMA = 12  # minima that draws are about, the likeliest
WIDENED = 1.3  # how much wider than a minimum the draws about it are
TEMPERED = 0.5  # power of a minimum's probability by which these are shared out
OWN = 6
"""How many draws a mode's own covariance counts for: as many as leave none of the six directions out."""
NEGLIGIBLE = 1e-6  # probability of a mode that is left out
LEVEL = 0.99  # probability of the region that holds as many of the draws


DIMENSIONS = 6  # of a pose
FREEDOM = 4
"""Degrees of freedom of Student's t: tails that are heavier than the posterior's keep the weights of draws bounded."""
LOG_T = float(np.log(24) - 3 * np.log(4 * np.pi)) + 3 * float(np.log(2 * np.pi))
"""Log of what normalises that t, Γ(5) / (Γ(2) (4π)³), over what normalises a Gaussian."""


class Mixture(NamedTuple):
    """A mixture of Student's t distributions of d of a pose's coordinates."""

    centers: Array
    """(k, d) [m]."""
    roots: Array
    """(k, d, d) roots of their scales."""
    shares: Array
    """(k,) that sum to one."""

    def draws(self, standard: Array) -> Array:
        """Returns draws (n, d) out of those of the standard t (n, d), the centers' shares of them one after another."""
        counts = (self.shares * len(standard)).astype(int)
        counts[np.argmax(self.shares)] += len(standard) - counts.sum()
        of = np.repeat(np.arange(len(counts)), counts)
        return np.asarray(self.centers[of] + np.einsum("nij,nj->ni", self.roots[of], standard))

    def density(self, x: Array) -> Array:
        """Returns the density (n,) at coordinates (n, d), up to a constant factor."""
        inverse = np.linalg.inv(self.roots)
        d = x.shape[1]
        shifts = np.einsum("kij,kj->ki", inverse, self.centers).ravel()
        y = x @ inverse.reshape(-1, d).T
        y -= shifts
        y = y.reshape(len(x), len(self.centers), d)
        square = 1 + np.einsum("nki,nki->nk", y, y) / FREEDOM
        heights = self.shares / np.linalg.det(self.roots)
        return np.asarray(square ** (-0.5 * (FREEDOM + d)) @ heights)


@lru_cache(maxsize=1)
def _standard() -> Array:
    """Returns draws of the standard t (n, 6)."""
    rng = np.random.default_rng(0)
    number = NUMBER
    return np.asarray(
        rng.normal(size=(number, DIMENSIONS)) / np.sqrt(rng.chisquare(FREEDOM, (number, 1)) / FREEDOM)
    )


def may_draw(problem: Problem) -> bool:
    """Returns whether modes of a problem may have to be drawn from, rather than integrated.

    On a scan, whose bumps are not the object's, the integral knows which part of the cost to leave out; about a
    declared axis nothing is drawn.
    """
    model = problem.model
    error = problem.model.field_error
    return (
        not problem.blind
        and modes.has_detail(model)
        and modes.several_minima(model, problem.rows, len(problem.contacts))
        and len(problem.outside) <= MOST_OUTSIDE
        and not len(model.symmetries.axes)
        and (error is None or not error.values[..., 2].any())
    )


def have_draws(rows: Records) -> bool:
    """Returns whether the modes (K,) ANSWER of such a problem are drawn from."""
    return len(rows) > 1 or bool(rows[0]["departure"] > LEAST_DEPARTURE)


def with_draws(problem: Problem, rows: Records, used: Mask) -> Records:
    """Returns the distinct modes, likeliest first, out of minima (K,) ANSWER, likeliest first: each with the mean, the
    covariance and the probability of the draws that are nearest to it.

    `used` (1, n): the contacts in use. Coordinates are (δp, radius δθ) [m] from the first minimum, along the object's
    own axes. A minimum that is turned by more than a right angle from it remains as it is.
    """
    T = rows[0]["T_palm_object"].copy()
    scale = np.repeat([1.0, problem.model.radius], 3)
    along = np.kron(np.eye(2), T[:3, :3].T) * scale[:, None]
    across = np.linalg.inv(along)
    places = se3.difference(rows["T_palm_object"], T) @ along.T
    likely = rows["log_weight"] > rows["log_weight"].max() - SEARCH.unlikely
    near = np.linalg.norm(places[:, 3:], axis=1) < np.pi / 2 * problem.model.radius
    chosen = np.flatnonzero(likely & near)[:MOST_MINIMA]
    covariances = along @ rows["covariance"] @ along.T
    number = NUMBER if len(rows) > 1 else NUMBER_SINGLE

    def log_density(x: Array) -> Array:
        """Returns the log density (n,) of the posterior at coordinates (n, 6), up to a constant."""
        half = np.linalg.norm(x[:, 3:], axis=1) / (2 * problem.model.radius)
        cost = solve.cost(problem, se3.moved(T, x @ across.T), used)
        # The volume of rotations shrinks with the turn; beyond half a turn they are reached the other way round.
        log_volume = 2 * np.log(np.sinc(np.minimum(half / np.pi, 0.5)))
        return np.where(half < np.pi / 2, log_volume - cost / 2, -np.inf)

    shares = np.exp(TEMPERED * (rows["log_weight"][chosen] - rows["log_weight"][chosen[0]]))
    ridge = 1e-12 * np.eye(DIMENSIONS)
    roots = WIDENED * np.linalg.cholesky(covariances[chosen] + ridge)
    mixture = Mixture(places[chosen], roots, shares / shares.sum())
    x = mixture.draws(_standard()[:number])
    logs = log_density(x) - np.log(mixture.density(x))
    weights = np.exp(logs - logs.max())
    log_mean = logs.max() + np.log(weights.mean())
    weights /= weights.sum()
    # Draws belong to the nearest mode, in units of the distance at which two are distinct.
    model = problem.model
    distinct = modes.distinct(model, rows["T_palm_object"], np.arange(len(rows)), modes.MAX_MODES)
    centers = np.array([j for j in distinct if j in chosen])
    gaps = (x - places[centers, None]).reshape(len(centers), -1, 2, 3)
    limits = np.array(modes.SAME_MODE) * [1.0, model.radius]
    nearest = (np.linalg.norm(gaps, axis=3) / limits).max(axis=2).argmin(axis=0)
    merged = [rows[j] for j in distinct if j not in chosen]
    for k, j in enumerate(centers):
        own = weights * (nearest == k)
        if own.sum() > NEGLIGIBLE:
            mean, covariance = _moments(x, own / own.sum(), places[j], covariances[j])
            row = rows[j].copy()
            row["T_palm_object"] = se3.moved(T, across @ mean)
            row["covariance"] = across @ covariance @ across.T
            row["information"] = along.T @ np.linalg.inv(covariance) @ along
            row["log_weight"] = log_mean - LOG_T + np.log(own.sum())
            merged.append(row)
    merged.sort(key=lambda row: -row["log_weight"])
    return np.array(merged)


def _moments(x: Array, weights: Array, place: Array, covariance: Array) -> tuple[Array, Array]:
    """Returns the mean (6,) and the covariance (6, 6) of weighted draws (n, 6) of a mode at `place` (6,).

    The mode with its own covariance counts as some more draws: a conjugate prior. What is returned is the covariance of
    the next draw, which is wider the fewer there are, and as wide as it takes for its region to hold as many of the
    draws as a Gaussian's: tails are heavier.
    """
    mean = weights @ x
    effective = 1 / (weights @ weights)
    prior = OWN
    number = effective + prior
    off = place - mean
    spread = (x - mean).T @ ((x - mean) * weights[:, None])
    C = effective * spread + prior * covariance + effective * prior / number * np.outer(off, off)
    mean = mean + prior / number * off
    C = C * (1 + 1 / number) / number
    square = np.einsum("ni,ni->n", x - mean, (x - mean) @ np.linalg.inv(C))
    order = np.argsort(square)
    within = min(int(np.searchsorted(np.cumsum(weights[order]), LEVEL)), len(x) - 1)
    return mean, C * max(1.0, square[order[within]] / modes.chi2_limit(DIMENSIONS, 1 - LEVEL))
