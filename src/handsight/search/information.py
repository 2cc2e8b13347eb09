"""Which sweep tells most: the one whose outcome is least known."""

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array, Indices
from handsight.errors import InvalidInput
from handsight.search.belief import Belief
from handsight.search.touch import Sweep, cast

DISTANCE_BIN, NORMAL_BIN = 0.004, float(np.deg2rad(12.0))
"""Outcomes that differ by less are not told apart [m], [rad]."""
APART = 1000
"""More steps than there are of a normal."""
CANDIDATES, LOOKED_AT = 256, 512
"""Sweeps that are compared, and poses on which they are."""
MARGIN = 0.03
"""Before the first and behind the last place where the object may be met [m]."""


def expected_information(belief: Belief, sweeps: list[Sweep], radius: float) -> Array:
    """(s,) entropy of each sweep's outcome given what is believed [nat]: none where it is sure to pass, or to meet.

    An outcome is a miss, or a distance in steps of 4 mm with a normal in steps of 12°. What a touch is expected to tell
    is that entropy less that of its own noise, which is about the same for all. `radius` of the tip [m].
    """
    distances, normals = cast(belief.model, _looked_at(belief), sweeps, radius)
    return np.array([_entropy(_outcomes(*row)) for row in zip(distances, normals, strict=True)])


def candidates(belief: Belief, heights: ArrayLike, rng: np.random.Generator) -> list[Sweep]:
    """Level sweeps, all over where the object may be, at `heights` above the table [m]; raises InvalidInput.

    Each passes some believed pose at up to the object's radius beside its middle.
    """
    levels = checks.finite(heights, "heights", (None,))
    if not len(levels) or not (levels > 0).all():
        raise InvalidInput(f"heights: expected some above 0, got {checks.brief(levels)}")
    poses = _looked_at(belief)
    middles = se3.apply(poses, belief.model.center_object[None])[:, 0]
    reach = float(np.linalg.norm(belief.area.high - belief.area.low)) / 2 + belief.model.radius + MARGIN
    center = (belief.area.low + belief.area.high) / 2
    sweeps = []
    for _ in range(CANDIDATES):
        angle, aside = rng.uniform(0, 2 * np.pi), belief.model.radius * rng.uniform(-1, 1)
        way, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        through = middles[rng.integers(len(middles)), :2] + aside * across
        sweeps.append(level_sweep(center, reach, through, way, belief.area.table.height + rng.choice(levels)))
    return sweeps


def level_sweep(center: Array, reach: float, through: Array, way: Array, height: float) -> Sweep:
    """All of the level line through (2,) along (2,) that is within `reach` of a center (2,) along it [m]."""
    start = through + ((center - through) @ way - reach) * way
    return Sweep(np.array([*start, height]), np.array([*way, 0.0]), 2 * reach)


def shortened(belief: Belief, sweep: Sweep, radius: float) -> Sweep:
    """The part of it on which the object may be met; all of it where that is nowhere. `radius` of the tip [m]."""
    distances, _ = cast(belief.model, belief.Ts_world_object, [sweep], radius)
    met = distances[np.isfinite(distances)]
    if not len(met):
        return sweep
    return sweep.part(max(met.min() - MARGIN, 0.0), min(met.max() + MARGIN, sweep.length))


def best_sweep(belief: Belief, heights: ArrayLike, radius: float) -> Sweep:
    """Of many sweeps the one that is expected to tell most, as short as it may be; the same for the same belief.

    `heights` of the tip's middle above the table that the hand can sweep at (any number), its `radius` [m]. Raises
    InvalidInput.
    """
    rng = np.random.default_rng((belief.seed, len(belief.touches), 1))
    sweeps = candidates(belief, heights, rng)
    told = expected_information(belief, sweeps, checks.positive(radius, "radius"))
    return shortened(belief, sweeps[int(np.argmax(told))], radius)


def _looked_at(belief: Belief) -> Array:
    """(n, 4, 4) of the believed poses, some."""
    return belief.Ts_world_object[:: max(len(belief.places) // LOOKED_AT, 1)]


def _outcomes(distances: Array, normals: Array) -> Indices:
    """(n,) whole numbers that say which outcome each is, of distances (n,) and normals (n, 3)."""
    azimuth, elevation = np.arctan2(normals[:, 1], normals[:, 0]), np.arcsin(np.clip(normals[:, 2], -1, 1))
    met = np.isfinite(distances)
    bins = np.stack(
        [np.where(met, distances, 0.0) / DISTANCE_BIN, azimuth / NORMAL_BIN, elevation / NORMAL_BIN]
    )
    far, around, up = np.floor(bins).astype(np.int64)
    return np.where(met, (far * APART + around) * APART + up, -APART * APART)


def _entropy(outcomes: Indices) -> float:
    """Of equally likely outcomes (n,) [nat]."""
    _, counts = np.unique(outcomes, return_counts=True)
    share = counts / counts.sum()
    return float(-(share * np.log(share)).sum())
