"""First poses by votes of point pairs (Drost, Ulrich, Navab and Ilic, CVPR 2010).

Two oriented points have four numbers that no motion changes: their distance, each normal's angle with the line
between them, and the normals' angle with each other. A pair of the scene looks up the pairs of the model that are
alike, each of which says which model point the scene's first one is, and by which spin about its normal.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.search import rotation_exp
from handsight._kernels.symmetry import store_pose
from handsight._kernels.vec3 import (
    Mat33,
    Vec3,
    dot,
    matmul,
    mul,
    norm,
    scale,
    sub,
    transpose,
    vector,
)

DISTANCES, ANGLES, SPINS = 20, 13, 30
"""Steps in which a pair's distance, its angles and a spin are counted; a box's right angles are in a step's middle."""
CELLS = DISTANCES * ANGLES**3
PEAKS = 4
"""Poses that each reference point gives."""


@inner
def about_normal(n: Vec3) -> Mat33:
    """A rotation that brings a unit normal to +x, the same for the same normal (Duff and others, JCGT 2017)."""
    sign = 1.0 if n[2] >= 0 else -1.0
    a = -1 / (sign + n[2])
    b = n[0] * n[1] * a
    return n, (1 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]), (b, sign + n[1] * n[1] * a, -n[1])


@inner
def _angle(cosine: float) -> int:
    return int((ANGLES - 1) / np.pi * np.arccos(min(max(cosine, -1.0), 1.0)) + 0.5)


@inner
def cell_of(first: Vec3, n1: Vec3, second: Vec3, n2: Vec3, diameter: float) -> int:
    """Which of the cells a pair of points and unit normals falls into; below 0: none."""
    d = sub(second, first)
    length = norm(d)
    step = int(length * (DISTANCES / diameter))
    if step >= DISTANCES or not length > 1e-9 * diameter:
        return -1
    d = scale(d, 1 / length)
    return ((step * ANGLES + _angle(dot(n1, d))) * ANGLES + _angle(dot(n2, d))) * ANGLES + _angle(dot(n1, n2))


@inner
def spin_of(frame: Mat33, first: Vec3, second: Vec3) -> float:
    """The angle of a pair's second point about the first one's normal, which the frame brings to +x."""
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
def _count(table: Any, seen: Any, r: int, diameter: float, most: int, votes: Any) -> None:
    """Adds the votes of pairs of a reference point and up to so many others to `votes` (m, SPINS)."""
    starts, models, spins = table
    first, n1 = vector(seen[r].point), vector(seen[r].normal)
    frame, partners = about_normal(n1), 0
    for j in range(len(seen)):
        n2 = vector(seen[j].normal)
        if j == r or n2 == (0.0, 0.0, 0.0):
            continue
        second = vector(seen[j].point)
        cell = cell_of(first, n1, second, n2, diameter)
        if cell < 0:
            continue
        spin = spin_of(frame, first, second)
        for k in range(starts[cell], starts[cell + 1]):
            turn = SPINS * ((spin - spins[k]) / (2 * np.pi) + 1.0)
            whole = int(turn)
            beside = whole + 1 if turn - whole > 0.5 else whole - 1
            votes[models[k], whole % SPINS] += 1.0
            votes[models[k], beside % SPINS] += 0.5
        partners += 1
        if partners == most:
            break


@entry
def vote(table: Any, model: Any, seen: Any, references: Any, limits: Any, looks: Any) -> None:
    """Fills in the LOOK (r, PEAKS) that pairs of reference points (r,) with other seen points vote for.

    table: starts of cells (CELLS + 1,), model points and spins of their pairs. model: points and normals (2, m, 3).
    limits: diameter [m], most partners of a reference point.
    """
    points, normals, most = model[0], model[1], int(limits[1])
    votes = np.empty((len(points), SPINS), np.float32)
    for n in range(len(references)):
        votes[:] = 0.0
        _count(table, seen, references[n], limits[0], most, votes)
        reference = seen[references[n]]
        back = transpose(about_normal(vector(reference.normal)))
        for peak in range(PEAKS):
            best_i = best_s = 0
            for i in range(len(points)):
                for s in range(SPINS):
                    if votes[i, s] > votes[best_i, best_s]:
                        best_i, best_s = i, s
            look = looks[n, peak]
            look.votes = votes[best_i, best_s]
            angle = 2 * np.pi * (best_s + 0.5) / SPINS
            spun = matmul(back, rotation_exp((angle, 0.0, 0.0)))
            R = matmul(spun, about_normal(vector(normals[best_i])))
            p = sub(vector(reference.point), mul(R, vector(points[best_i])))
            store_pose((R, p), look.pose)
            for s in range(SPINS):
                votes[best_i, s] = 0.0
