"""The nearest point of many triangles, by a tree of boxes around them. Twin: `handsight.objects._plain.feet`.

The tree (`handsight.objects.tree`) is complete and lies in an array: the children of box k are 2k + 1 and 2k + 2, and
the last row of boxes holds the triangles from `starts[i]` to `starts[i + 1]` each, a part. Nearest points are where
the surface is seen head on, and a box along the axes is thick there where the surface is oblique; so each part's own
boxes stand in a frame of its own, along its normal.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.threads import in_parts

FLAT = 1e-14
"""A triangle whose doubled area squared is below this part of its sides' product is taken for its edges."""
DEPTH = 64
"""More boxes than ever wait: one for each level of the tree."""
RESULT = 8
"""Numbers for each foot: distance, point (3), weights of the corners (3), triangle."""
_LEAST = 1000


@inner
def _box_gap2(boxes: Any, k: int, x: float, y: float, z: float) -> float:
    """The squared distance to box k, which is its least and its greatest corner."""
    dx = max(max(boxes[k, 0] - x, x - boxes[k, 3]), 0.0)
    dy = max(max(boxes[k, 1] - y, y - boxes[k, 4]), 0.0)
    dz = max(max(boxes[k, 2] - z, z - boxes[k, 5]), 0.0)
    return dx * dx + dy * dy + dz * dz


@inner
def _weights(T: Any, t: int, x: float, y: float, z: float) -> Any:
    """Weights of the corners in the point of triangle t nearest to (x, y, z); an exact 0 off an edge."""
    ax, ay, az = T[t, 0, 0], T[t, 0, 1], T[t, 0, 2]
    ux, uy, uz = T[t, 1, 0] - ax, T[t, 1, 1] - ay, T[t, 1, 2] - az
    vx, vy, vz = T[t, 2, 0] - ax, T[t, 2, 1] - ay, T[t, 2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
    # Which corner, edge or the inside it is: Ericson, Real-Time Collision Detection, 5.1.5, one division at most.
    if pu <= 0 and pv <= 0:
        return 1.0, 0.0, 0.0
    qu, qv = pu - uu, pv - uv
    if qu >= 0 and qv <= qu:
        return 0.0, 1.0, 0.0
    ru, rv = pu - uv, pv - vv
    if rv >= 0 and ru <= rv:
        return 0.0, 0.0, 1.0
    # The weights times the doubled area squared.
    total, b, c = uu * vv - uv * uv, vv * pu - uv * pv, uu * pv - uv * pu
    a = total - b - c
    if c <= 0 and pu > 0 and qu <= 0:
        s = pu / uu
        return 1 - s, s, 0.0
    if b <= 0 and pv > 0 and rv <= 0:
        s = pv / vv
        return 1 - s, 0.0, s
    if a <= 0 and qv > qu and ru >= rv:
        s = (qv - qu) / ((qv - qu) + (ru - rv))
        return 0.0, 1 - s, s
    if total <= FLAT * uu * vv or min(a, min(b, c)) < 0:
        return _on_edges(uu, uv, vv, pu, pv)
    share = 1 / total
    return a * share, b * share, c * share


@inner
def _on_edges(uu: float, uv: float, vv: float, pu: float, pv: float) -> Any:
    """As `_weights`, of the edges alone, by what each squared distance has above that to the first corner."""
    s = min(pu / uu, 1.0) if pu > 0 else 0.0
    t = min(pv / vv, 1.0) if pv > 0 else 0.0
    along, size = pv - pu + uu - uv, uu - 2 * uv + vv
    r = min(along / size, 1.0) if along > 0 and size > 0 else 0.0
    first, second = s * (s * uu - 2 * pu), t * (t * vv - 2 * pv)
    third = (1 - r) * ((1 - r) * uu - 2 * pu) + r * (r * vv - 2 * pv) + 2 * r * (1 - r) * uv
    if first <= second and first <= third:
        return 1 - s, s, 0.0
    if second <= third:
        return 1 - t, 0.0, t
    return 0.0, 1 - r, r


@inner
def _tried(T: Any, t: int, x: float, y: float, z: float, out: Any) -> None:
    """Puts the foot on triangle t into `out` where that is nearer; `out[0]` is squared here."""
    a, b, c = _weights(T, t, x, y, z)
    fx = a * T[t, 0, 0] + b * T[t, 1, 0] + c * T[t, 2, 0]
    fy = a * T[t, 0, 1] + b * T[t, 1, 1] + c * T[t, 2, 1]
    fz = a * T[t, 0, 2] + b * T[t, 1, 2] + c * T[t, 2, 2]
    gap2 = (x - fx) * (x - fx) + (y - fy) * (y - fy) + (z - fz) * (z - fz)
    if gap2 < out[0]:
        out[0], out[1], out[2], out[3] = gap2, fx, fy, fz
        out[4], out[5], out[6], out[7] = a, b, c, t


@inner
def _part(frames: Any, triangles: Any, within: Any, first: int, last: int, at: Any, out: Any) -> None:
    """Tries the triangles from first to last of one part that may be nearer, in its frame `frames` (9)."""
    R, (x, y, z) = frames, at
    a = R[0] * x + R[1] * y + R[2] * z
    b = R[3] * x + R[4] * y + R[5] * z
    c = R[6] * x + R[7] * y + R[8] * z
    for t in range(first, last):
        if _box_gap2(within, t, a, b, c) < out[0]:
            _tried(triangles, t, a, b, c, out)


@entry
def feet(points: Any, within: float, tree: Any, out: Any) -> None:
    """`out` (n, 8): see RESULT; of points (n, 3) that are nowhere within [m], the distance is infinite.

    `tree`: `starts` (p + 1), `boxes` (2p - 1, 6), `frames` (p, 9); in the parts' frames `triangles` (m, 3, 3) and the
    box `around` each (m, 6).
    """
    starts, boxes, frames, triangles, around = tree
    parts = len(starts) - 1
    waiting, gaps = np.empty(DEPTH, np.int64), np.empty(DEPTH)
    before = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        found = out[i]
        found[0], found[7] = within * within, -1.0
        # Neighbours in space follow each other: the last one's part leaves little to search.
        _part(frames[before], triangles, around, starts[before], starts[before + 1], (x, y, z), found)
        waiting[0], gaps[0], count = 0, _box_gap2(boxes, 0, x, y, z), 1
        while count:
            count -= 1
            k = waiting[count]
            if gaps[count] >= found[0]:
                continue
            part = k - parts + 1
            if part >= 0:
                held = found[0]
                _part(frames[part], triangles, around, starts[part], starts[part + 1], (x, y, z), found)
                if found[0] < held:
                    before = part
                continue
            near, far = 2 * k + 1, 2 * k + 2
            near_gap, far_gap = _box_gap2(boxes, near, x, y, z), _box_gap2(boxes, far, x, y, z)
            if far_gap < near_gap:
                near, far, near_gap, far_gap = far, near, far_gap, near_gap
            waiting[count], gaps[count] = far, far_gap
            waiting[count + 1], gaps[count + 1] = near, near_gap
            count += 2
        _back(found, frames[before])


@inner
def _back(found: Any, R: Any) -> None:
    """Takes a foot in the frame R (9) of its part back to the mesh's; its distance is no square any more."""
    if found[7] < 0:
        found[0] = np.inf
        return
    a, b, c = found[1], found[2], found[3]
    found[0] = np.sqrt(found[0])
    found[1] = R[0] * a + R[3] * b + R[6] * c
    found[2] = R[1] * a + R[4] * b + R[7] * c
    found[3] = R[2] * a + R[5] * b + R[8] * c


def all_feet(points: Any, within: float, tree: Any) -> Any:
    """As `feet` (n, 8), on several threads."""
    out = np.zeros((len(points), RESULT))
    in_parts(lambda a, b: feet(points[a:b], within, tree, out[a:b]), len(points), _LEAST)
    return out


def warm() -> None:
    """Compiles every kernel, or loads it."""
    tree = np.array([0, 1]), np.zeros((1, 6)), np.zeros((1, 9)), np.zeros((1, 3, 3)), np.zeros((1, 6))
    feet(np.zeros((1, 3)), np.inf, tree, np.zeros((1, RESULT)))
