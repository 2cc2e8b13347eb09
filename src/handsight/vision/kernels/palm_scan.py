"""Where in a depth image a hand may be: turned and shifted in steps, each time as far away as most of it agrees.

The image is sampled in cells of even size along the rays, so that neither its resolution nor its lens matters.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.pinhole import project, whole
from handsight._compiled.vec3 import Vec3, matrix, mul, norm, store, vector
from handsight.vision.kernels.depth_image import normal_at


class PalmScanOptions(NamedTuple):
    """`PalmScanOptions` say how poses of the palm are compared with a coarse depth image."""

    facing_cosine: float = 0.2
    """Least cosine between a point's normal and the way to the camera for the point to be visible."""
    normal_cosine: float = 0.5  # least cosine of a point's normal with the image's
    range_bins: int = 25  # bins of how much nearer or farther than the hand the image is
    agreeing_bins: int = 2  # bins on either side that agree
    tried_bins: int = 6  # bins to either side that are tried
    passed_weight: float = 1.5  # of a point that the camera sees past, against one that agrees
    hidden_weight: float = 0.1  # of a point that something hides
    beside_weight: float = 1.0  # of a point beside the hand where the image has something as near as the hand
    min_visible: int = 10  # points that must fall on depth
    visible_slack: int = 20  # added to the number of visible points, so that few do not win by their share


PALM_SCAN = PalmScanOptions()


@inner
def observed_at(camera: Any, depth: Any, P: Vec3) -> tuple[int, int, float]:
    """Returns row, column and depth [m] of a point's pixel; the depth is 0 where there is none, -1 out of the image."""
    u, v = project(camera, P)
    if not (-0.5 < u < depth.shape[1] - 0.5 and -0.5 < v < depth.shape[0] - 0.5):
        return 0, 0, -1.0
    row, column = whole(v), whole(u)
    z = depth[row, column]
    return row, column, float(z) if z > 0 else 0.0


@entry
def cells_of(camera: Any, rays: Any, depth: Any, corner: Any, cells: Any) -> None:
    """Fills in `cells` (h, w, 4): depth [m] and normal along the rays `corner[:2] + corner[2] · (column, row)`. The
    depth is 0 where there is none, -1 out of the image; the normal is 0 where there is none."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            cell = cells[i, j]
            ray = (corner[0] + corner[2] * j, corner[1] + corner[2] * i, 1.0)
            row, column, cell[0] = observed_at(camera[0], depth, ray)
            store(normal_at(rays, depth, row, column) if cell[0] > 0 else (0.0, 0.0, 0.0), cell[1:])


@inner
def _best(there: Any, agree: Any, visible: float) -> tuple[float, int]:
    """Returns the best score of any distance bin, and that bin, counted from the middle one.

    there, agree: visible points and those that agree, by bin; visible: how many points are visible in all.
    """
    half = PALM_SCAN.range_bins // 2
    best = -np.inf
    where = 0
    for b in range(half - PALM_SCAN.tried_bins, half + PALM_SCAN.tried_bins + 1):
        good = 0.0
        near = 0.0
        before = 0.0
        for k in range(b - PALM_SCAN.agreeing_bins, b + PALM_SCAN.agreeing_bins + 1):
            good += agree[k]
            near += there[k]
        for k in range(b - PALM_SCAN.agreeing_bins):
            before += there[k]
        score = good - PALM_SCAN.passed_weight * (visible - near - before) - PALM_SCAN.hidden_weight * before
        if score > best:
            best = score
            where = b - half
    return best, where


@entry
def scan(
    cells: Any, corner: Any, bin_width: float, hand: Any, middles: Any, rotations: Any, found: Any
) -> None:
    """Fills in `found` (r, s, 2): the score of the best distance, and how much farther away than the middle it is [m].

    corner: as of `cells_of`. bin_width: of the bins of distances [m]. hand: points about its middle and normals
    (2, m, 3), normals of 0 for points in the air beside it. rotations (r, 3, 3), middles (s, 3) of it in the camera.
    """
    height, width, count = cells.shape[0], cells.shape[1], hand.shape[1]
    there, agree = np.empty(PALM_SCAN.range_bins), np.empty(PALM_SCAN.range_bins)
    turned = np.empty((count, 2, 3))
    half = PALM_SCAN.range_bins // 2
    finer = 1 / corner[2]
    bins = 1 / bin_width
    for r in range(len(rotations)):
        R = matrix(rotations[r])
        for m in range(count):
            for side in range(2):
                store(mul(R, vector(hand[side, m])), turned[m, side])
        for s in range(len(middles)):
            c = vector(middles[s])
            least = PALM_SCAN.facing_cosine * norm(c)
            visible = 0.0
            out = 0.0
            there[:] = 0.0
            agree[:] = 0.0
            for m in range(count):
                X, Y, Z = turned[m, 0, 0] + c[0], turned[m, 0, 1] + c[1], turned[m, 0, 2] + c[2]
                n = vector(turned[m, 1])
                beside = n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0
                if not ((beside or -(n[0] * X + n[1] * Y + n[2] * Z) > least) and Z > 0):
                    continue
                column = whole((X / Z - corner[0]) * finer)
                row = whole((Y / Z - corner[1]) * finer)
                if not (0 <= row < height and 0 <= column < width and cells[row, column, 0] > 0):
                    out += 0.0 if beside else 1.0
                    continue
                cell = cells[row, column]
                b = min(max(int((cell[0] - Z) * bins + half + 0.5), 0), PALM_SCAN.range_bins - 1)
                if beside:
                    agree[b] -= PALM_SCAN.beside_weight
                    continue
                visible += 1.0
                there[b] += 1.0
                known = cell[1] != 0.0 or cell[2] != 0.0 or cell[3] != 0.0
                same = n[0] * cell[1] + n[1] * cell[2] + n[2] * cell[3] > PALM_SCAN.normal_cosine
                agree[b] += (1.0 if same else 0.0) if known else 0.5
            found[r, s, 0] = -np.inf
            found[r, s, 1] = 0.0
            if visible >= PALM_SCAN.min_visible:
                score, away = _best(there, agree, visible)
                found[r, s, 0] = score / (visible + out + PALM_SCAN.visible_slack)
                found[r, s, 1] = away * bin_width
