"""Where in a depth image a hand may be: turned and shifted in steps, each time as far away as most of it agrees.

It is looked at in cells of even size along the rays, so that neither the image's resolution nor its lens has a say.
"""

from typing import Any

import numpy as np

from handsight._kernels.image.depth_image import normal_at
from handsight._kernels.image.pinhole import project
from handsight._kernels.math.vec3 import matrix, mul, norm, vector
from handsight._kernels.runtime.compilation import entry, inner

FACING = 0.2
"""Least cosine between a point's normal and the way to the camera for it to be looked for."""
AGREES = 0.5
"""Least cosine of a point's normal with what is seen there."""
BINS, REACH, AWAY = 25, 2, 6
"""Of how much nearer or farther the image is than the hand; that agree on either side; that are tried."""
PASSED, HIDDEN = 1.5, 0.1
"""What a point that the camera sees past weighs, and one that is hidden, against one that agrees."""
BESIDE = 1.0
"""What a point beside the hand weighs where the image has something as near as the hand is."""
MIN_VISIBLE, VISIBLE_SLACK = 10, 20
"""Points that must fall on depth; and what is added to their number, so that few do not win by their share."""


@entry
def cells_of(camera: Any, rays: Any, depth: Any, corner: Any, cells: Any) -> None:
    """Fills in `cells` (h, w, 4): depth and normal along the rays `corner[:2] + corner[2] · (column, row)`.

    Depth 0: none there; below 0: out of the image. Normal 0: none.
    """
    height, width = depth.shape
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            cell = cells[i, j]
            x, y = corner[0] + corner[2] * j, corner[1] + corner[2] * i
            u, v = project(camera[0], (x, y, 1.0))
            cell[0] = -1.0
            cell[1] = cell[2] = cell[3] = 0.0
            if not (-0.5 < u < width - 0.5 and -0.5 < v < height - 0.5):
                continue
            row, column = int(v + 0.5), int(u + 0.5)
            cell[0] = depth[row, column] if depth[row, column] > 0 else 0.0
            if cell[0] > 0:
                cell[1], cell[2], cell[3] = normal_at(rays, depth, row, column)


@inner
def _best(there: Any, agree: Any, visible: float) -> tuple[float, int]:
    """By how much most agree, and the bin in which they do, from the middle one."""
    half, best, where = BINS // 2, -np.inf, 0
    for b in range(half - AWAY, half + AWAY + 1):
        good, near, before = 0.0, 0.0, 0.0
        for k in range(b - REACH, b + REACH + 1):
            good += agree[k]
            near += there[k]
        for k in range(b - REACH):
            before += there[k]
        score = good - PASSED * (visible - near - before) - HIDDEN * before
        if score > best:
            best, where = score, b - half
    return best, where


@entry
def scan(cells: Any, corner: Any, hand: Any, middles: Any, rotations: Any, found: Any) -> None:
    """Fills in `found` (r, s, 2): by how much the image agrees, and how much farther it is [m], for the best distance.

    corner: as of `cells_of`, and how wide a bin of distances is [m]. hand: points about its middle and normals
    (2, m, 3), normals of 0 for points in the air beside it. rotations (r, 3, 3), middles (s, 3) of it in the camera.
    """
    height, width, count = cells.shape[0], cells.shape[1], hand.shape[1]
    there, agree, turned = np.empty(BINS), np.empty(BINS), np.empty((count, 2, 3))
    half, finer, bins = BINS // 2, 1 / corner[2], 1 / corner[3]
    for r in range(len(rotations)):
        R = matrix(rotations[r])
        for m in range(count):
            for side in range(2):
                turned[m, side, 0], turned[m, side, 1], turned[m, side, 2] = mul(R, vector(hand[side, m]))
        for s in range(len(middles)):
            c = vector(middles[s])
            least, visible, out = FACING * norm(c), 0.0, 0.0
            there[:] = 0.0
            agree[:] = 0.0
            for m in range(count):
                X, Y, Z = turned[m, 0, 0] + c[0], turned[m, 0, 1] + c[1], turned[m, 0, 2] + c[2]
                n = vector(turned[m, 1])
                beside = n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0
                if not ((beside or -(n[0] * X + n[1] * Y + n[2] * Z) > least) and Z > 0):
                    continue
                column = int((X / Z - corner[0]) * finer + 0.5)
                row = int((Y / Z - corner[1]) * finer + 0.5)
                if not (0 <= row < height and 0 <= column < width and cells[row, column, 0] > 0):
                    out += 0.0 if beside else 1.0
                    continue
                cell = cells[row, column]
                b = min(max(int((cell[0] - Z) * bins + half + 0.5), 0), BINS - 1)
                if beside:
                    agree[b] -= BESIDE
                    continue
                visible += 1.0
                there[b] += 1.0
                known = cell[1] != 0.0 or cell[2] != 0.0 or cell[3] != 0.0
                same = n[0] * cell[1] + n[1] * cell[2] + n[2] * cell[3] > AGREES
                agree[b] += (1.0 if same else 0.0) if known else 0.5
            found[r, s, 0], found[r, s, 1] = -np.inf, 0.0
            if visible >= MIN_VISIBLE:
                score, away = _best(there, agree, visible)
                found[r, s, 0], found[r, s, 1] = score / (visible + out + VISIBLE_SLACK), away * corner[3]
