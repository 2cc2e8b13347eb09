"""A surface of many quadric patches: each is fitted to noisy points, in a window that widens as long as the fits agree
(Lepski 1991), and the distance from the surface is blended from theirs.

A patch is the surface F = 0 in a frame of its own, F = z + H z²/2 + (a u² + 2 b uv + c v²)/2, with z along its normal.
(a, b, c) are the second derivatives of its distance, the `bends`, positive where it is convex; H is chosen so that
planes, cylinders and balls are exact at any distance.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import factor, solve
from handsight._compiled.jit import entry, inner
from handsight._compiled.stack import local
from handsight._compiled.vec3 import Vec3, add, cross, dot, norm, scale, store, sub, vector

PATCH = np.dtype([
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("along", "f8", (2, 3)),
    ("bends", "f8", (3,)),
    ("bend", "f8"),  # H
    ("covariance", "f8", (6, 6)),  # of height, slopes and bends
    ("spread", "f8"),  # variance of the residuals: their squares over the degrees of freedom [m²]
    ("window", "f8"),  # radius of the widest window that it was fitted in [m]
    ("fits", "i8"),  # how many windows it was fitted in
    ("ended", "i8"),  # whether a wider window is not of one surface any more
    ("trust", "f8"),  # its weight among others, beside that by its distance
], align=True)  # fmt: skip


@inner
def gradient(patch: Any, u: float, v: float, z: float) -> Vec3:
    """Returns the gradient of F along the object's axes, at a point (u, v, z) of the patch's frame."""
    n = vector(patch.normal)
    a = vector(patch.along[0])
    b = vector(patch.along[1])
    by_u = patch.bends[0] * u + patch.bends[1] * v
    by_v = patch.bends[1] * u + patch.bends[2] * v
    return add(scale(n, 1 + patch.bend * z), add(scale(a, by_u), scale(b, by_v)))


@inner
def level_set(patch: Any, u: float, v: float, z: float) -> float:
    """Returns F at a point (u, v, z) of the patch's frame."""
    q = patch.bends[0] * u * u + 2 * patch.bends[1] * u * v + patch.bends[2] * v * v
    return z + 0.5 * (patch.bend * z * z + q)


@entry
def blended(patches: Any, spacing: float, around: Any, nearest: Any, nodes: Any, out: Any) -> None:
    """Writes to `out` (n, 4) the signed distance [m] of nodes (n, 3) from the surface, and the direction outwards.

    The distance from a patch is 2 F / (1 + √(1 + 2 H F)), exact for planes, cylinders and balls. It is averaged over
    the patches `around[nearest[j]]` (k,), the nearest first, weighted by how near they are and whether they face the
    way of the nearest: the far side of a thin wall and the other face of an edge do not count.
    """
    for j in range(len(nodes)):
        place = vector(nodes[j])
        near2 = 0.0
        total = 0.0
        weights = 0.0
        way = (0.0, 0.0, 0.0)
        ahead = vector(patches[nearest[j]].normal)
        for k in range(around.shape[1]):
            patch = patches[around[nearest[j], k]]
            offset = sub(place, vector(patch.point))
            away2 = dot(offset, offset)
            if k == 0:
                near2 = away2
            reach = 0.5 * np.sqrt(near2) + spacing
            facing = max(dot(vector(patch.normal), ahead), 0.0)
            w = np.exp((near2 - away2) / (2.5 * reach * reach)) * facing**4 * patch.trust
            u, v = dot(vector(patch.along[0]), offset), dot(vector(patch.along[1]), offset)
            z = dot(vector(patch.normal), offset)
            off = level_set(patch, u, v, z)
            way = add(way, scale(gradient(patch, u, v, z), w))
            total += w * 2 * off / (1 + np.sqrt(max(1 + 2 * patch.bend * off, 0.0)))
            weights += w
        out[j, 0] = total / weights
        out[j, 1], out[j, 2], out[j, 3] = way


@entry
def neighbours(points: Any, pairs: Any, patches: Any, window: float, sums: Any) -> None:
    """Adds to `sums` (4,) what tells whether neighbouring points share their noise.

    For all `pairs` (k, 2) of points (n, 3) that are both within `window` [m] of a patch: the product of their
    residuals [m²], the mean of their squares [m²], the points' distance [m], and 1.
    """
    residuals = np.empty(len(points))
    for k in range(len(patches)):
        patch = patches[k]
        for i in range(len(points)):
            offset = sub(vector(points[i]), vector(patch.point))
            residuals[i] = np.nan
            if dot(offset, offset) < window * window:
                u, v = dot(vector(patch.along[0]), offset), dot(vector(patch.along[1]), offset)
                residuals[i] = level_set(patch, u, v, dot(vector(patch.normal), offset))
        for i, j in pairs:
            product = residuals[i] * residuals[j]
            if product == product:
                sums[0] += product
                sums[1] += 0.5 * (residuals[i] ** 2 + residuals[j] ** 2)
                sums[2] += norm(sub(vector(points[i]), vector(points[j])))
                sums[3] += 1


MIN_FACING = float(np.cos(np.deg2rad(35.0)))
"""The least cosine of a point's normal and the patch's; with a smaller one it is on another face."""
MAX_DRIFT = 1.5  # of a fit from those in smaller windows, in their standard deviations

LEVEL = np.dtype([
    ("place", "i8"),  # number of this window size, from the smallest
    ("window", "f8"),  # radius [m]
    ("origin", "f8", (3,)),  # of the grid that sorts the points, a cell of it as wide as that radius
    ("shape", "i8", (3,)),  # of that grid
    ("variance", "f8"),  # of a point's noise [m²]
    ("together", "f8"),  # how many points share one noise
    ("tolerance", "f8"),  # squared residual that the shape itself has in any window [m²]
    ("bend", "f8"),  # standard deviation of curvatures before anything is measured [1/m]
    ("free", "i8"),  # whether every window counts and no point is left out
], align=True)  # fmt: skip
ROOM = np.dtype([
    ("many", "f8"),  # effective number of points
    ("matrix", "f8", (6, 6)),
    ("factor", "f8", (6, 6)),
    ("right", "f8", (6,)),
    ("solution", "f8", (6,)),
    ("x", "f8", (6,)),
    ("powers", "f8", (6,)),
    ("tensor", "f8", (6,)),
], align=True)  # fmt: skip
WINDOW_VALUES = 16
"""Numbers of a fit in one window: point (3), normal (3), tensor of second derivatives (6), variances (3), spread."""


@inner
def _gathered(cloud: Any, keys: Any, level: Any, place: Vec3, index: Any) -> int:
    """Writes to `index` the points in the window around a place, and returns how many they are."""
    ny, nz = level.shape[1], level.shape[2]
    cell = scale(sub(place, vector(level.origin)), 1 / level.window)
    ix, iy, iz = int(cell[0]), int(cell[1]), int(cell[2])
    count = 0
    for x in range(ix - 1, ix + 2):
        for y in range(iy - 1, iy + 2):
            first = (x * ny + y) * nz + iz - 1
            for i in range(np.searchsorted(keys, first), np.searchsorted(keys, first + 3)):
                away = sub(vector(cloud[i]), place)
                if dot(away, away) < level.window * level.window and count < len(index):
                    index[count] = i
                    count += 1
    return count


@inner
def _fill(x: Any, u: float, v: float) -> None:
    """Writes the monomials of a quadric at (u, v) to x (6,)."""
    x[0] = 1.0
    x[1] = u
    x[2] = v
    x[3] = 0.5 * u * u
    x[4] = u * v
    x[5] = 0.5 * v * v


@inner
def _is_left_out(patch: Any, level: Any, normal: Vec3, place: Vec3, x: Any) -> int:
    """Returns 0 for a point of the patch, 1 for one on another face or off the surface, 2 for one on the other side."""
    u, v, z = place
    ahead = gradient(patch, u, v, z)
    facing = dot(ahead, normal) / max(norm(ahead), 1e-9)
    if facing < MIN_FACING:
        return 2 if facing < -0.5 else 1  # 2: on the other side of a thin wall
    if patch.fits == 0:
        return 0
    off = level_set(patch, u, v, z)
    predicted = 0.0
    _fill(x, u, v)
    for i in range(6):
        for j in range(6):
            predicted += x[i] * patch.covariance[i, j] * x[j]
    limit = 3.0  # standard deviations
    return 1 if off * off > limit * limit * (level.variance + predicted) else 0


@inner
def _normal_equations(
    cloud: Any, index: Any, level: Any, patch: Any, room: Any
) -> tuple[float, float, float, float]:
    """Writes the normal equations of a fit; returns the sums of weights, squared weights, weights that are left out,
    and weighted squared heights."""
    n = vector(patch.normal)
    origin = vector(patch.point)
    h = level.window
    a, b = vector(patch.along[0]), vector(patch.along[1])
    room.matrix[:] = 0.0
    room.right[:] = 0.0
    total = 0.0
    squares = 0.0
    rejected = 0.0
    heights = 0.0
    for i in index:
        offset = sub(vector(cloud[i]), origin)
        u, v, z = dot(a, offset), dot(b, offset), dot(n, offset)
        # Weighted by the distance along the surface: with the height in it, thick noise would seem thin.
        w = max(1 - (u * u + v * v) / (h * h), 0.0)
        w *= w
        if not level.free:
            why = _is_left_out(patch, level, (cloud[i, 3], cloud[i, 4], cloud[i, 5]), (u, v, z), room.x)
            if why:
                rejected += w if why == 1 else 0.0
                continue
        y = z + 0.5 * patch.bend * z * z
        _fill(room.x, u / h, v / h)
        for r in range(6):
            room.right[r] += w * y * room.x[r]
            for c in range(r + 1):
                room.matrix[r, c] += w * room.x[r] * room.x[c]
        total += w
        squares += w * w
        heights += w * y * y
    return total, squares, rejected, heights


@inner
def _fitted(cloud: Any, index: Any, level: Any, patch: Any, room: Any) -> float:
    """Fits a patch; returns the share of weight that is left out, above 1 where there is no fit."""
    h = level.window
    total, squares, rejected, heights = _normal_equations(cloud, index, level, patch, room)
    # Effective number of points to which six numbers are fitted.
    if total * total < 7.5 * squares or not total > 0:
        return 2.0
    ridge = level.variance / (level.bend * h * h) ** 2
    for k in range(3, 6):
        room.matrix[k, k] += ridge
    if not factor(room.matrix, 6, 1e-12 * total, room.factor):
        return 2.0
    solve(room.factor, 6, room.right, room.solution)
    residual = heights
    many = total * total / squares
    for k in range(6):
        residual -= room.solution[k] * room.right[k]
        room.powers[k] = 1.0 if k == 0 else (1 / h if k < 3 else 1 / (h * h))
    patch.spread = max(residual, 0.0) / total * many / (many - 6)
    room.many = many
    _move(patch, room.solution, room.powers)
    noise = level.variance * level.together * squares / total
    for j in range(6):
        for k in range(6):
            room.x[k] = 1.0 if k == j else 0.0
        solve(room.factor, 6, room.x, room.right)
        for k in range(6):
            patch.covariance[j, k] = noise * room.right[k] * (room.powers[j] * room.powers[k])
    return rejected / (total + rejected)


@inner
def _move(patch: Any, solution: Any, powers: Any) -> None:
    """Moves a patch's frame to the fitted surface z + H z²/2 = X solution, and its second derivatives with it."""
    n = vector(patch.normal)
    a = vector(patch.along[0])
    b = vector(patch.along[1])
    height = solution[0]
    z = 2 * height / (1 + np.sqrt(max(1 + 2 * patch.bend * height, 0.25)))
    by_u, by_v = solution[1] * powers[1], solution[2] * powers[2]
    ahead = add(scale(n, 1 + patch.bend * z), add(scale(a, -by_u), scale(b, -by_v)))
    length = max(norm(ahead), 1e-9)
    store(add(vector(patch.point), scale(n, z)), patch.point)
    for k in range(3):
        patch.bends[k] = -solution[3 + k] * powers[3 + k] / length
    n = scale(ahead, 1 / length)
    a = sub(a, scale(n, dot(a, n)))
    a = scale(a, 1 / max(norm(a), 1e-9))
    store(n, patch.normal)
    store(a, patch.along[0])
    store(cross(n, a), patch.along[1])
    mean = 0.5 * (patch.bends[0] + patch.bends[2])
    half = 0.5 * (patch.bends[0] - patch.bends[2])
    root = np.sqrt(half * half + patch.bends[1] * patch.bends[1])
    k1 = mean + root
    k2 = mean - root
    patch.bend = (k1 * abs(k1) + k2 * abs(k2)) / max(abs(k1) + abs(k2), 1e-300)


@inner
def _tensor(patch: Any, out: Any) -> None:
    """Writes the tensor of second derivatives along the object's axes to `out` (6): xx, yy, zz, xy, xz, yz."""
    a, b = vector(patch.along[0]), vector(patch.along[1])
    for k in range(6):
        i, j = (k, k) if k < 3 else ((0, k - 2) if k < 5 else (1, 2))
        mixed = a[i] * b[j] + b[i] * a[j]
        out[k] = patch.bends[0] * a[i] * a[j] + patch.bends[1] * mixed + patch.bends[2] * b[i] * b[j]


@inner
def _has_drifted(patch: Any, earlier: Any, windows: int, tensor: Any) -> bool:
    """Returns whether a patch differs from its fit in a smaller window by more than that one's standard deviations."""
    n = vector(patch.normal)
    limit = MAX_DRIFT * MAX_DRIFT
    for j in range(windows):
        row = earlier[j]
        height = dot(n, sub(vector(patch.point), vector(row)))
        turn = 0.0
        bend = 0.0
        for k in range(3):
            turn += (n[k] - row[3 + k]) ** 2
        for k in range(6):
            bend += (1.0 if k < 3 else 2.0) * (tensor[k] - row[6 + k]) ** 2
        if height * height > limit * row[12] or turn > 2 * limit * row[13]:
            return True
        # The squared error of the tensor has four terms, in variances of one of them.
        if bend > 3.0 * limit * row[14]:
            return True
    return False


@entry
def widen(cloud: Any, keys: Any, levels: Any, patches: Any, earlier: Any) -> None:
    """Fits each of `patches` (m,) PATCH in a wider window, and keeps the new fit unless it contradicts earlier ones.

    `cloud` (n, 6): points and normals, in the order of their grid cells, `keys` (n,). `levels` (1,): LEVEL. `earlier`
    (m, windows, WINDOW_VALUES): the fits in smaller windows; those in this one are added.
    """
    # Later ones, in the order of cells, are left out.
    level = levels[0]
    room = local(ROOM)
    index = np.empty(1500, np.int64)
    trials = np.empty(1, PATCH)
    for k in range(len(patches)):
        patch = patches[k]
        trial = trials[0]
        if patch.ended:
            continue
        count = _gathered(cloud, keys, level, vector(patch.point), index)
        trials[0] = patch
        left_out = 0.0
        for _ in range(2):  # the frame is moved to the surface after each
            if left_out <= 1:
                left_out = _fitted(cloud, index[:count], level, trial, room)
        if left_out > 1:
            continue
        _tensor(trial, room.tensor)
        if patch.fits > 0 and not level.free:
            # Standard deviations of the residuals' variance.
            excess = 3.0 * np.sqrt(2 * level.together / room.many)
            expected = level.variance * (1 + excess) + level.tolerance
            # Where much weight is left out, the window reaches beyond the patch.
            wide = left_out > 0.1 or trial.spread > expected
            if wide or _has_drifted(trial, earlier[k], level.place, room.tensor):
                patch.ended = 1
                continue
        patches[k] = trial
        patch.window = level.window
        row = earlier[k, level.place]
        C = patch.covariance
        store(vector(patch.point), row[:3])
        store(vector(patch.normal), row[3:6])
        row[6:12] = room.tensor
        row[12] = C[0, 0]
        row[13] = 0.5 * (C[1, 1] + C[2, 2])
        row[14] = 0.5 * (C[3, 3] + C[5, 5])
        row[15] = patch.spread
        patch.fits += 1
