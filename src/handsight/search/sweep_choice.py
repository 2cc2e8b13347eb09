"""The choice of the next sweep: the most informative one, whose outcome is least certain given the belief."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.search.belief import Belief
from handsight.search.touch import Sweep, cast


class SweepOptions(NamedTuple):
    """`SweepOptions` say how the next sweep is chosen."""

    distance_bin: float = 0.004  # width of the bins of a touch's distance along the sweep [m]
    normal_bin: float = float(np.deg2rad(12.0))  # width of the bins of its normal's two angles [rad]
    max_normal_bins: int = 1000  # more than an angle has bins: it combines three bin numbers into one
    max_sweeps: int = 256  # sweeps that are compared
    max_poses: int = 512  # particles on which each sweep is cast
    margin: float = 0.03
    """Length of a sweep before the first and beyond the last point at which it may meet the object [m]."""


SWEEPS = SweepOptions()


def expected_information(belief: Belief, sweeps: list[Sweep], radius: float) -> Array:
    """Returns (s,) the entropy of each sweep's outcome under the belief [nat], for a tip of `radius` [m].

    An outcome is a miss, or a distance in bins of 4 mm with a normal in bins of 12°. The expected information of a
    sweep is this entropy less that of the measurement's noise, which is about the same for all sweeps.
    """
    distances, normals = cast(belief.model, _some_poses(belief), sweeps, radius)
    azimuth = np.arctan2(normals[..., 1], normals[..., 0])
    elevation = np.arcsin(np.clip(normals[..., 2], -1, 1))
    hit = np.isfinite(distances)
    bins = np.stack(
        [
            np.where(hit, distances, 0.0) / SWEEPS.distance_bin,
            azimuth / SWEEPS.normal_bin,
            elevation / SWEEPS.normal_bin,
        ]
    )
    i, j, k = np.floor(bins).astype(np.int64)
    miss = -SWEEPS.max_normal_bins * SWEEPS.max_normal_bins
    outcomes: Indices = np.where(hit, (i * SWEEPS.max_normal_bins + j) * SWEEPS.max_normal_bins + k, miss)
    entropies = []
    for row in outcomes:
        _, counts = np.unique(row, return_counts=True)
        share = counts / counts.sum()
        entropies.append(float(-(share * np.log(share)).sum()))
    return np.array(entropies)


def candidates(belief: Belief, heights: ArrayLike, rng: np.random.Generator) -> list[Sweep]:
    """Returns random level sweeps across the area, at `heights` above the table [m].

    Each passes the middle of the object, as one of the particles has it, within the object's radius. Raises
    InvalidInput.
    """
    levels = checks.finite(heights, "heights", (None,))
    if not len(levels) or not (levels > 0).all():
        raise InvalidInput(f"heights: expected some above 0, got {checks.brief(levels)}")
    poses = _some_poses(belief)
    middles = se3.apply(poses, belief.model.center_object[None])[:, 0]
    reach = (
        float(np.linalg.norm(belief.area.high - belief.area.low)) / 2 + belief.model.radius + SWEEPS.margin
    )
    center = (belief.area.low + belief.area.high) / 2
    sweeps = []
    for _ in range(SWEEPS.max_sweeps):
        angle, offset = rng.uniform(0, 2 * np.pi), belief.model.radius * rng.uniform(-1, 1)
        along, lateral = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        through = middles[rng.integers(len(middles)), :2] + offset * lateral
        height = belief.area.table.height + rng.choice(levels)
        sweeps.append(level_sweep(center, reach, through, along, height))
    return sweeps


def level_sweep(center: Array, reach: float, through: Array, along: Array, height: float) -> Sweep:
    """Returns the level sweep through a point (2,) in the direction `along` (2,), a unit vector, at a height [m].

    It starts and ends at a distance `reach` from `center` (2,), measured along its direction [m].
    """
    start = through + ((center - through) @ along - reach) * along
    return Sweep(np.array([*start, height]), np.array([*along, 0.0]), 2 * reach)


def shortened(belief: Belief, sweep: Sweep, radius: float) -> Sweep:
    """Returns the part of a sweep in which it may meet the object; all of it if it meets the object of no particle.

    `radius` is the tip's [m].
    """
    distances, _ = cast(belief.model, belief.Ts_world_object, [sweep], radius)
    hits = distances[np.isfinite(distances)]
    if not len(hits):
        return sweep
    return sweep.part(max(hits.min() - SWEEPS.margin, 0.0), min(hits.max() + SWEEPS.margin, sweep.length))


def best_sweep(belief: Belief, heights: ArrayLike, radius: float) -> Sweep:
    """Returns the sweep with the most expected information, as short as possible; the same for the same belief.

    `heights` are the heights above the table at which the hand can move the tip's middle [m], `radius` is the tip's
    radius [m]. Raises InvalidInput.
    """
    rng = np.random.default_rng((belief.seed, len(belief.touches), 1))
    sweeps = candidates(belief, heights, rng)
    information = expected_information(belief, sweeps, checks.positive(radius, "radius"))
    return shortened(belief, sweeps[int(np.argmax(information))], radius)


def _some_poses(belief: Belief) -> Array:
    """Returns the poses (n, 4, 4) of about `SWEEPS.max_poses` of the particles, or of all if there are fewer."""
    return belief.Ts_world_object[:: max(len(belief.placements) // SWEEPS.max_poses, 1)]
