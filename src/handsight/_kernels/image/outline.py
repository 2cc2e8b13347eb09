"""Whether the visible surface ends where an object at a pose ends.

A pose that slid onto a wall, a table or a bigger object fits all that is visible of it, but the surface goes on past
its outline. Where the object truly is, what is beside it lies behind it, or hides it.
"""

from typing import Any

from handsight._kernels.image.depth_image import point_at
from handsight._kernels.image.pinhole import project
from handsight._kernels.image.vision_records import HAND
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import apply, apply_inverse, dot, mul, norm, scale, sub, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import entry

BESIDE = 0.06
"""Distance from the surface up to which points beside it are compared with it [diameters]."""
INSIDE = 2.0
"""From the outline to the visible surface that they are compared with [pixels]."""


@entry
def find_continued(camera: Any, surface: Any, image: Any, window: Any, candidate: Any) -> None:
    """Fills in `unexplained` of CANDIDATE (1,): the pixels beside it that continue its explained surface, less those
    that are behind it.

    surface: MODEL (1,), its nodes. image: rays (h, w, 2), depth (h, w) [m] and labels (h, w). window: WINDOW (1,).
    Pixels of the hand do not count.
    """
    model, nodes = surface
    rays, depth, labels = image
    here, field, bound = window[0], model[0].fine, candidate[0].bound
    pose = pose_of(candidate[0].pose)
    center, beside = apply(pose, vector(model[0].center)), bound + BESIDE * 2 * model[0].radius
    reach2 = (1.2 * model[0].radius + beside) ** 2
    count = 0
    for v in range(here.rows[0], here.rows[1], here.step):
        for u in range(here.columns[0], here.columns[1], here.step):
            if not depth[v, u] > 0 or labels[v, u] == HAND:
                continue
            P = point_at(rays, depth, v, u)
            way = sub(P, center)
            if not dot(way, way) < reach2:
                continue
            distance, gradient, _ = field_at(nodes, field, apply_inverse(pose, P))
            if not bound < distance < beside:
                continue
            # A pixel a little inside of the outline: past the surface's point that is nearest.
            g = mul(pose[0], gradient)
            x, y = project(camera[0], sub(P, scale(g, distance / max(norm(g), 1e-9))))
            length = ((x - u) ** 2 + (y - v) ** 2) ** 0.5
            if not length > 0.5:
                continue
            x, y = x + INSIDE * (x - u) / length + 0.5, y + INSIDE * (y - v) / length + 0.5
            if not (0 <= x < depth.shape[1] and 0 <= y < depth.shape[0]):
                continue
            row, column = int(y), int(x)
            if not depth[row, column] > 0 or labels[row, column] == HAND:
                continue
            Q = point_at(rays, depth, row, column)
            inside, gradient, _ = field_at(nodes, field, apply_inverse(pose, Q))
            normal = mul(pose[0], gradient)
            if abs(inside) < bound and dot(normal, Q) < -0.1 * norm(Q):
                off = dot(normal, sub(P, Q))
                count += 1 if abs(off) < bound else -1 if off < 0 else 0
    candidate[0].unexplained = max(count, 0) * here.step**2
