"""The choice of the next sweep: the one whose outcome tells most about the object's pose."""

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.correction.modes import pose_distances
from handsight.errors import InvalidInput
from handsight.search.area import Sweep, cast
from handsight.search.belief import CERTAIN_POSITION, CERTAIN_ROTATION, Belief

SIGMA_DISTANCE = 0.0025  # of a touch, along the normal: a degree at each joint of the finger [m]
SIGMA_NORMAL = float(np.deg2rad(6.0))  # of a touch's normal [rad]
SAME = 0.5  # distance of two poses that need not be distinguished [limits of certainty]
CURVATURE_RADIUS = 0.03  # of a surface that a sweep brushes [m]
MAX_SWEEPS = 256  # sweeps that are compared
MAX_POSES = 128  # particles on which each sweep is cast
MARGIN = 0.03  # length of a sweep before and beyond the points at which it may meet the object [m]


def expected_information(belief: Belief, sweeps: list[Sweep], radius: float) -> Array:
    """Returns (s,) the expected information of each sweep about the object's pose [nat], for a tip of `radius` [m].

    The outcome is a miss, or a distance and a normal with a touch's noise. The information is a lower bound by the
    Bhattacharyya distances between the outcomes of all pairs of poses (Kolchinsky and Tracey 2017, α = 1/2). Pairs so
    near to each other that the object can be grasped at either are not distinguished.
    """
    Ts = belief.Ts_world_object[:: max(len(belief.placements) // MAX_POSES, 1)]
    distances, normals, gaps = cast(belief.model, Ts, sweeps, radius)
    hit = np.isfinite(distances)
    directions = np.array([sweep.direction_world for sweep in sweeps])
    cosines = -np.einsum("snj,sj->sn", normals, directions)
    # How far the path would have to be shifted for a miss to be a hit, or a hit to be a miss.
    margins = np.where(hit, CURVATURE_RADIUS * cosines**2 / 2, gaps)
    shifts, turns = np.array([pose_distances(belief.model, Ts, T) for T in Ts]).transpose(1, 0, 2)
    same = (shifts < SAME * CERTAIN_POSITION) & (turns < SAME * CERTAIN_ROTATION)
    information = []
    for k in range(len(sweeps)):
        d = np.where(hit[k], distances[k], 0.0)
        n = normals[k]
        m = margins[k]
        h = hit[k]
        chi2 = ((d[:, None] - d) * (cosines[k, :, None] + cosines[k]) / 2 / SIGMA_DISTANCE) ** 2
        chi2 += ((n[:, None] - n) ** 2).sum(axis=2) / SIGMA_NORMAL**2
        chi2 = np.where(h[:, None] & h, chi2, ((m[:, None] + m) / SIGMA_DISTANCE) ** 2)
        chi2[same | ~(h[:, None] | h)] = 0.0
        information.append(-np.log(np.exp(-chi2 / 8).mean(axis=1)).mean())
    return np.maximum(information, 0.0)


def candidates(belief: Belief, heights: ArrayLike, rng: np.random.Generator) -> list[Sweep]:
    """Returns random level sweeps across the area, at `heights` above the table [m].

    Each passes the middle of the object, as one of the particles has it, within the object's radius. Raises
    InvalidInput.
    """
    levels = checks.finite(heights, "heights", (None,))
    if not len(levels) or not (levels > 0).all():
        raise InvalidInput(f"heights: expected some above 0, got {checks.brief(levels)}")
    area = belief.area
    some = belief.placements[:: max(len(belief.placements) // MAX_POSES, 1), :2]
    reach = float(np.linalg.norm(area.high - area.low)) / 2 + belief.model.radius + MARGIN
    sweeps = []
    for _ in range(MAX_SWEEPS):
        angle = rng.uniform(0, 2 * np.pi)
        offset = belief.model.radius * rng.uniform(-1, 1)
        along = np.array([np.cos(angle), np.sin(angle)])
        lateral = np.array([-np.sin(angle), np.cos(angle)])
        through = some[rng.integers(len(some))] + offset * lateral
        sweeps.append(area.sweep(through, along, rng.choice(levels), reach))
    return sweeps


def shortened(belief: Belief, sweep: Sweep, radius: float) -> Sweep:
    """Returns the part of a sweep in which it may meet the object; all of it if it meets the object of no particle.
    `radius` is the tip's [m]."""
    distances, _, _ = cast(belief.model, belief.Ts_world_object, [sweep], radius)
    hits = distances[np.isfinite(distances)]
    if not len(hits):
        return sweep
    return sweep.part(max(hits.min() - MARGIN, 0.0), min(hits.max() + MARGIN, sweep.length))


def best_sweep(belief: Belief, heights: ArrayLike, radius: float) -> Sweep:
    """Returns the sweep with the most expected information, as short as possible; the same for the same belief.

    `heights` are the heights above the table at which the hand can move the tip's middle [m], `radius` is the tip's
    radius [m]. Raises InvalidInput.
    """
    sweeps = candidates(belief, heights, np.random.default_rng((belief.seed, len(belief.touches), 1)))
    information = expected_information(belief, sweeps, checks.positive(radius, "radius"))
    return shortened(belief, sweeps[int(np.argmax(information))], radius)
