"""The flat directions of a mode, in which its posterior is not Gaussian, and the lattice of points that is laid there.

A mode is integrated along them. Coordinates are (s, radius θ) [m], straight along the object
(`uncertainty.retract_body`).
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.records import GRID, SHEET, WEAK_PRIOR
from handsight._compiled.vec3 import Mat33, Pose, cross, mul, norm, scale, vector
from handsight.correction.kernels.density import posterior_cost
from handsight.correction.kernels.integration_options import CALIBRATION, INTEGRATION
from handsight.correction.kernels.terms import FIXED_NOISE, PRIOR, Evidence, evidence_cost
from handsight.correction.kernels.uncertainty import retract_body

SPIN = 1e6
"""Information that is added for a spin around a declared axis, in traces of the matrix: so large that the spin is not
taken for an unobservable direction."""
TURN = np.array([
    [[0.8960, -0.4440, 0.0], [0.4440, 0.8960, 0.0], [0.0, 0.0, 1.0]],
    [[0.6816, -0.5834, 0.4416], [0.7267, 0.6105, -0.3150], [-0.0858, 0.5356, 0.8401]],
])  # fmt: skip
"""Orientation of lattices along two or three directions: turned, so that the rows of points do not all end at a wall
together."""


@inner
def _spin(model: Any, R: Mat33, k: int) -> Any:
    """Returns the direction (δp, radius δθ) of a spin about the k-th declared axis, of unit length."""
    axis = mul(R, vector(model.symmetry.axis[k]))
    moved = cross(mul(R, vector(model.symmetry.pivot)), axis)
    length = 1 / np.sqrt(norm(moved) ** 2 + model.radius**2)
    return scale(moved, length) + scale(axis, model.radius * length)


@inner
def mark_spins(model: Any, R: Mat33, matrix: Any) -> float:
    """Adds the spins about declared axes to a matrix (6, 6) by (δp, radius δθ); returns a bound that only their
    eigenvalues exceed."""
    size = 0.0
    for i in range(6):
        size += matrix[i, i]
    for k in range(model.symmetry.axes):
        spin = _spin(model, R, k)
        for i in range(6):
            for j in range(6):
                matrix[i, j] += SPIN * size * (spin[i] * spin[j])
    return 0.5 * SPIN * size


@inner
def _leave_out_spins(model: Any, R: Mat33, flat: Any) -> None:
    """Makes the slopes of the eigenvectors nearest to spins about declared axes infinite, and their rises negative."""
    for _ in range(model.symmetry.axes):
        nearest = 0
        most = -1.0
        for n in range(6):
            part = 0.0
            for k in range(model.symmetry.axes):
                spin = _spin(model, R, k)
                along = 0.0
                for i in range(6):
                    along += flat.vectors[i, n] * spin[i]
                part += along * along
            if part > most and flat.slopes[n] < np.inf:
                nearest, most = n, part
        flat.slopes[nearest] = np.inf
        flat.rises[nearest] = -np.inf


@inner
def choose(evidence: Evidence, pose: Pose, flat: Any) -> None:
    """Fills in the flat directions (`along`) and those across; where nothing departs from a Gaussian, the widest is
    flat.

    A spin about a declared axis is neither.
    """
    radius = evidence.model.radius
    rises = flat.rises
    slopes = flat.slopes
    flat.count = flat.count_across = 0
    _leave_out_spins(evidence.model, pose[0], flat)
    for n in range(INTEGRATION.max_directions):
        widest = -1
        for k in range(6):
            if rises[k] > (INTEGRATION.max_gaussian_rise if n else -1.0) and (
                widest < 0 or _before(rises, slopes, k, widest)
            ):
                widest = k
        if widest >= 0:
            _copy_column(flat.vectors, widest, flat.along, n)
            if n == 0:  # all there is to a line; a lattice is built later
                _copy_column(flat.vectors, widest, flat.lattice, n)
            flat.spacing[n] = min(1 / np.sqrt(max(slopes[widest], 1 / radius**2)), radius / 2)
            flat.count = n + 1
            rises[widest] = -np.inf
    blind = evidence.prior.kind == WEAK_PRIOR
    flat.proper = True
    for k in range(6):
        flat.proper = flat.proper and not (blind and slopes[k] * (CALIBRATION.open_sigma * radius) ** 2 < 1)
        if rises[k] >= 0:
            _copy_column(flat.vectors, k, flat.across, flat.count_across)
            narrower = slopes[k] / flat.calibrated[k] if slopes[k] > 0 else 1.0
            flat.stretch[flat.count_across] = np.sqrt(narrower)
            flat.count_across += 1


@inner
def _copy_column(source: Any, k: int, out: Any, n: int) -> None:
    """Copies a column: assigning a slice would take two seconds to compile, most of it for errors about shapes."""
    for i in range(6):
        out[i, n] = source[i, k]


@inner
def _before(rises: Any, slopes: Any, k: int, other: int) -> bool:
    """Returns whether a direction is to be integrated along before another: one that departs from a Gaussian comes
    first, then the wider one."""
    if (rises[k] > INTEGRATION.max_gaussian_rise) != (rises[other] > INTEGRATION.max_gaussian_rise):
        return rises[k] > INTEGRATION.max_gaussian_rise
    return slopes[k] < slopes[other]


@inner
def at_coordinates(mode: Pose, radius: float, six: Any) -> Pose:
    """Returns the pose at coordinates (6) from a mode."""
    return retract_body(mode, ((six[0], six[1], six[2]), scale((six[3], six[4], six[5]), 1 / radius)))


@inner
def without_bumps(evidence: Evidence, flat: Any, pose: Pose, cost: float) -> float:
    """Returns the cost of a pose without the dents of a scan: there contacts fit by chance, so that all costs below the
    level that chance explains count the same."""
    if flat.bump_margin > 0.0:
        by_prior = evidence_cost(evidence, PRIOR | FIXED_NOISE, pose)
        cost = by_prior + max(cost - by_prior, flat.level)
    return cost


@inner
def measure(evidence: Evidence, mode: Pose, flat: Any, here: float) -> None:
    """Sets the spacing of the lattice along each flat direction, by how far the cost, `here` at the mode, lets the pose
    move.

    Between the two sides at which it has risen by `INTEGRATION.rise` lie 2.8 standard deviations of a Gaussian, and 3.5
    of an interval; a spread over several directions is wider than along one of them. A mode may lie in a corner, so
    each direction is followed from the middle of the one before, twice.
    """
    radius = evidence.model.radius
    middle = np.zeros(6)
    six = np.zeros(6)
    for m in range(flat.count * INTEGRATION.sweeps):
        n = m % flat.count
        ends = (0.0, 0.0)
        for side in range(2):
            length = flat.spacing[n]
            near = 0.0
            far = 2 * radius
            for _ in range(INTEGRATION.max_probes):
                for i in range(6):
                    six[i] = middle[i] + flat.along[i, n] * (-length if side else length)
                pose = at_coordinates(mode, radius, six)
                rise = without_bumps(evidence, flat, pose, posterior_cost(evidence, pose)) - here
                if 0.5 * INTEGRATION.rise < rise < 2 * INTEGRATION.rise:
                    break
                if rise > INTEGRATION.rise:
                    far = length
                else:
                    near = length
                length = min(2 * length, 0.5 * (near + far))
            ends = ends[1], length
        for i in range(6):
            middle[i] += 0.5 * flat.along[i, n] * (ends[0] - ends[1])
        flat.spacing[n] = 0.5 * (ends[0] + ends[1])
    grid = 1 if evidence.model.fine.kind in (GRID, SHEET) else 0
    flat.points_per_sigma = INTEGRATION.points_per_sigma[grid][flat.count - 2]
    for n in range(flat.count):
        flat.spacing[n] *= INTEGRATION.sigma_of_reach / flat.points_per_sigma


@inner
def build_lattice(flat: Any) -> float:
    """Fills in the lattice's steps; returns the logarithm of the volume of its cell [m^count]."""
    cell = 0.0
    for n in range(flat.count):
        cell += np.log(flat.spacing[n])
        for i in range(6):
            value = 0.0
            for m in range(flat.count):
                value += flat.along[i, m] * (flat.spacing[m] * TURN[flat.count - 2, m, n])
            flat.lattice[i, n] = value
    return cell


@inner
def coordinates_at(flat: Any, point: Any, out: Any) -> None:
    """Fills `out` (6) with the coordinates of a lattice point."""
    for i in range(6):
        value = 0.0
        for n in range(flat.count):
            value += flat.lattice[i, n] * point.index[n]
        for n in range(flat.count_across):
            value += flat.across[i, n] * point.lateral[n]
        out[i] = value


@inner
def fine_enough(flat: Any, sums: Any, radius: float) -> bool:
    """Returns whether a standard deviation along each flat direction has enough points; where not, their spacing is
    made smaller."""
    fine = True
    wanted = flat.points_per_sigma
    for k in range(flat.count):
        mean = square = 0.0
        for i in range(6):
            a = flat.along[i, k] * (1.0 if i < 3 else radius)
            mean += a * sums.first[i] / sums.total
            for j in range(6):
                square += a * sums.second[i, j] / sums.total * flat.along[j, k] * (1.0 if j < 3 else radius)
        spread = np.sqrt(max(square - mean * mean, 0.0))
        if flat.spacing[k] * (0.8 * wanted) > spread:
            flat.spacing[k] = max(spread / wanted, flat.spacing[k] / 4)
            fine = False
    return fine
