"""An object to be grasped as a convex body, and how it rests on a table."""

import math
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array

if TYPE_CHECKING:
    from trimesh import Trimesh

MAX_RESTS = 6
"""Stable poses that are tried."""
SAME_SIDE = math.cos(math.radians(15))
"""Cosine between normals of one side."""


def body_of(vertices: Array) -> "Trimesh":
    """Returns the convex hull of `vertices` (k, 3) [m] by its extreme ones, within a hundredth of a smooth one's size.
    The middle of its bounds is at the origin."""
    import trimesh

    directions = np.vstack([se3.directions(400), np.eye(3), -np.eye(3)])
    extreme = np.unique((vertices @ directions.T).argmax(axis=0))
    hull: Trimesh = trimesh.convex.convex_hull(vertices[extreme])
    hull.apply_translation(-hull.bounds.mean(axis=0))
    return hull


def standing(body: "Trimesh", R: Array) -> "Trimesh":
    """Returns the body turned by R (3, 3) and standing on the table, its middle above the origin."""
    turned = body.copy()
    turned.apply_transform(se3.compose(R, np.zeros(3)))
    turned.apply_translation([0, 0, -turned.bounds[0, 2]])
    return turned


def least_rotation(first: Array, second: Array) -> Array:
    """Returns the least rotation (3, 3) that turns one direction (3,) to another, both of any length."""
    axis = np.cross(first, second)
    sine = np.linalg.norm(axis)
    if sine < 1e-9 * np.linalg.norm(first) * np.linalg.norm(second):
        axis = se3.perpendicular(first)
    return se3.rotation_exp(np.arctan2(sine, first @ second) * axis / np.linalg.norm(axis))


def rests(body: "Trimesh") -> list[Array]:
    """Returns rotations Rs_world_object (3, 3) in which the body rests: as in its file, on its largest sides, on end.
    It rests on a side if its centre of mass, projected to the side's plane, is inside all other faces."""
    found = [np.eye(3)]
    normals = body.face_normals
    offsets = face_offsets(body)
    heights = offsets - normals @ body.center_mass
    same_plane = normals @ normals.T > math.cos(math.radians(4))
    sizes = same_plane @ body.area_faces
    for i in np.argsort(-sizes, kind="stable"):
        down = normals[i]
        below = body.center_mass + heights[i] * down
        stands = (normals @ below - offsets).max() < 0.001
        if stands and all(-down @ R[2] < SAME_SIDE for R in found):
            found.append(least_rotation(down, np.array([0.0, 0, -1])))
    if len(found) <= MAX_RESTS:
        return found
    on_end = max(found[MAX_RESTS - 1 :], key=lambda R: float(np.ptp(body.vertices @ R[2])))
    return [*found[: MAX_RESTS - 1], on_end]


def face_offsets(body: "Trimesh") -> Array:
    """Returns (m,) the distances of the faces' planes from the origin along their outward normals [m]."""
    return np.asarray((body.face_normals * body.triangles[:, 0]).sum(axis=1))
