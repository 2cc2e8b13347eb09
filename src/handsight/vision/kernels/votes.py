"""First poses by votes of point pairs (Drost, Ulrich, Navab and Ilic, CVPR 2010).

Two oriented points have four numbers that no motion changes: their distance, each normal's angle with the line
between them, and the normals' angle with each other. A pair of the scene looks up the pairs of the model that are
alike, each of which says which model point the scene's first one is, and by which spin about its normal.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.so3 import about_normal, rotation_exp
from handsight._compiled.symmetry import store_pose
from handsight._compiled.vec3 import Mat33, Vec3, dot, matmul, mul, norm, scale, sub, transpose, vector

DISTANCES = 20
ANGLES = 13
SPINS = 30
"""Steps in which a pair's distance, its angles and a spin are counted; right angles are in the middle of a step."""
CELLS = DISTANCES * ANGLES**3
PEAKS = 4  # poses that each reference point votes for
POINT_BITS = 16
"""A pair of the model is one whole number: its first point, and in this many bits below it the spin."""
TURN = 1 << POINT_BITS


@inner
def _angle(cosine: float) -> int:
    return int((ANGLES - 1) / np.pi * np.arccos(min(max(cosine, -1.0), 1.0)) + 0.5)


@inner
def cell_of(first: Vec3, n1: Vec3, second: Vec3, n2: Vec3, diameter: float) -> int:
    """Returns the number of the cell that a pair of points with unit normals falls into; -1 where it is in none."""
    d = sub(second, first)
    length = norm(d)
    step = int(length * (DISTANCES / diameter))
    if step >= DISTANCES or not length > 1e-9 * diameter:
        return -1
    d = scale(d, 1 / length)
    return ((step * ANGLES + _angle(dot(n1, d))) * ANGLES + _angle(dot(n2, d))) * ANGLES + _angle(dot(n1, n2))


@inner
def spin_of(frame: Mat33, first: Vec3, second: Vec3) -> float:
    """Returns the angle of a pair's second point about the first one's normal, which the frame brings to +x."""
    d = mul(frame, sub(second, first))
    return np.arctan2(d[2], d[1])


@entry
def pairs_of(points: Any, normals: Any, diameter: float, cells: Any, spins: Any) -> None:
    """Fills in the cell (m, m) and the spin (m, m) of each pair of model points (m, 3)."""
    for i in range(len(points)):
        first, n1 = vector(points[i]), vector(normals[i])
        frame = about_normal(n1)
        for j in range(len(points)):
            second = vector(points[j])
            cells[i, j] = cell_of(first, n1, second, vector(normals[j]), diameter) if i != j else -1
            spins[i, j] = spin_of(frame, first, second)


@inner
def _count(table: Any, points: Any, r: int, diameter: float, most: int, votes: Any) -> None:
    """Counts in `votes` (m, 2 SPINS) the model's pairs that are like those of point r with up to `most` others."""
    starts, pairs = table
    first, n1 = vector(points[r].point), vector(points[r].normal)
    frame = about_normal(n1)
    partners = 0
    for j in range(len(points)):
        n2 = vector(points[j].normal)
        if j == r or n2 == (0.0, 0.0, 0.0):
            continue
        second = vector(points[j].point)
        cell = cell_of(first, n1, second, n2, diameter)
        if cell < 0:
            continue
        spin = int(TURN * (spin_of(frame, first, second) / (2 * np.pi) + 1))
        for k in range(starts[cell], starts[cell + 1]):
            # The difference of two spins modulo a turn: the mask cuts off the bits of the point as well.
            away = (spin - pairs[k]) & (TURN - 1)
            votes[pairs[k] >> POINT_BITS, away * 2 * SPINS >> POINT_BITS] += 1
        partners += 1
        if partners == most:
            break


@entry
def vote(
    table: Any, model: Any, diameter: float, observed: Any, references: Any, partners: int, candidates: Any
) -> None:
    """Fills in the CANDIDATE (r, PEAKS) that the pairs of reference points (r,) with other observed points vote for.

    table: where the pairs of each cell begin (CELLS + 1,), and the pairs. model: points and normals (2, m, 3).
    observed: DEPTH_POINT (n,), of which each reference point is paired with at most so many partners.
    """
    points, normals = model[0], model[1]
    votes = np.empty((len(points), 2 * SPINS), np.int32)
    best = np.empty(len(points))
    spins = np.empty(len(points), np.int64)
    for n in range(len(references)):
        votes[:] = 0
        _count(table, observed, references[n], diameter, partners, votes)
        best[:] = -1.0
        for m in range(len(votes)):  # the best spin of each model point
            for s in range(SPINS):  # the half steps beside it count by half
                before = (2 * s - 1) % (2 * SPINS)
                after = (2 * s + 2) % (2 * SPINS)
                total = votes[m, 2 * s] + votes[m, 2 * s + 1] + 0.5 * (votes[m, before] + votes[m, after])
                if total > best[m]:
                    best[m], spins[m] = total, s
        reference = observed[references[n]]
        back = transpose(about_normal(vector(reference.normal)))
        for peak in range(PEAKS):
            i = np.argmax(best)
            candidate = candidates[n, peak]
            candidate.votes = best[i]
            angle = 2 * np.pi * (spins[i] + 0.5) / SPINS
            spun = matmul(back, rotation_exp((angle, 0.0, 0.0)))
            R = matmul(spun, about_normal(vector(normals[i])))
            p = sub(vector(reference.point), mul(R, vector(points[i])))
            store_pose((R, p), candidate.pose)
            best[i] = -1.0
