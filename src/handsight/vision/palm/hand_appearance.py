"""The points of a hand's skin that depth images are compared with, and triangles that decide which are visible."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import ArrayLike

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask
from handsight.errors import InvalidInput
from handsight.hand import Hand
from handsight.hand.chains import Chains, transform_points
from handsight.hand.surface import sample_by_area
from handsight.objects import Triangles
from handsight.vision.reconstruction.volume import means_by_cell

APPEARANCE_POINTS = 1200  # by which a hand is aligned with an image
MERGE_DISTANCE = 0.005  # side of the cells in which vertices are merged to draw the hand [m]
PIXEL_STRIDE = 4  # pixels of an image for each that is drawn
MAX_DEPTH = 0.006  # how far a visible point may lie behind what is drawn [m]
MIN_FACING = 0.1  # the least cosine of its normal with the direction to the camera
APPEARANCE_BESIDE = 0.02  # distance from the hand's outline at which there is air, in steps of a search [m]
CONTINUED_DEPTH = 0.015  # how far behind the hand a surface beside the outline continues it [m]


@dataclass(frozen=True, eq=False)
class HandAppearance:
    """Points and triangles of a hand, each of which moves with one link; it is computed once."""

    chains: Chains
    skin: tuple[Array, Array, Indices]
    """Points (m, 3) and outward normals (m, 3) in the axes of their link, and the link of each, in random order."""
    coarse: tuple[Array, Indices, Indices]
    """Vertices (k, 3) in the axes of their link, the link of each, and faces (f, 3)."""
    point_area: float  # what each point stands for [m²]

    @classmethod
    def of(cls, hand: Hand) -> "HandAppearance":
        """Returns the appearance of the links that the palm carries; raises InvalidInput for a file without shapes."""
        shape = hand.shape()
        points, normals, body = skin_points(hand, APPEARANCE_POINTS)
        order = np.random.default_rng(0).permutation(len(points))
        area = Triangles(shape.vertices_body, shape.faces).area
        skin = points[order], normals[order], body[order]
        # The coarse hand: the vertices of a link in one cell are merged to their mean.
        cells = np.c_[shape.body_of, np.floor(shape.vertices_body / MERGE_DISTANCE)]
        where, middles = means_by_cell(cells, shape.vertices_body)
        body = np.zeros(len(middles), dtype=np.int64)
        body[where] = shape.body_of
        faces = where[shape.faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
        coarse = middles, body, faces[first].astype(np.int64)
        return cls(shape.chains, skin, coarse, area / len(points))

    def placed(self, joint_positions: Mapping[str, float], *, sigma_joint: ArrayLike = 0.0) -> "PlacedHand":
        """Returns the hand with its joints there, each off by a constant `sigma_joint` [rad, for slides m], or by
        errors (j, m) as `Rig.joint_errors` has them. Raises InvalidInput as `Hand.Ts_palm_tip` does."""
        Ts, axes = self.chains.poses(joint_positions)
        turns = Ts.copy()
        turns[:, :3, 3] = 0
        points, normals, bodies = self.skin
        skin = np.stack([transform_points(points, bodies, Ts), transform_points(normals, bodies, turns)])
        vertices = transform_points(self.coarse[0], self.coarse[1], Ts)
        return PlacedHand(self, skin, vertices, axes, self.chains.errors(sigma_joint))


@dataclass(frozen=True, eq=False)
class PlacedHand:
    """A hand in the palm's axes, with its joints at certain positions."""

    appearance: HandAppearance
    skin: Array  # (2, m, 3) points [m] and outward normals
    vertices: Array  # (k, 3) of the coarse triangles [m]
    axes: Array  # of the joints, as `Chains.poses` has them
    joint_errors: Array  # (j, m) constant errors of the joints [rad, for slides m], each column one

    @cached_property
    def middle(self) -> Array:
        """(3,) mean of its points [m]."""
        return np.asarray(self.skin[0].mean(axis=0))

    @cached_property
    def radius(self) -> float:
        """The largest distance of a point from the middle [m]."""
        return float(np.linalg.norm(self.skin[0] - self.middle, axis=1).max())

    def middle_at(self, T_a_palm: Array) -> Array:
        """Returns the middle (..., 3) [m] at poses (..., 4, 4)."""
        return se3.apply(T_a_palm, self.middle[None])[..., 0, :]

    def by_joints(self, rows: Indices) -> Array:
        """Returns how far (k, 3, m) each of the joints' errors moves the points `rows` (k,) in the palm [m]."""
        bodies = self.appearance.skin[2][rows]
        chains = self.appearance.chains
        return chains.jacobians(self.skin[0, rows], bodies, self.axes, self.joint_errors)[:, :3]

    def outline_continued(self, camera: Camera, depth: Depth, T_camera_palm: Array) -> float:
        """Returns the share of the pixels around the hand, drawn at a pose, in which the image is about as near as it.

        Around a hand in the air most are far behind; around a hand that was found in a table none is. Pixels that
        something hides, or without depth, do not count; the share is 1 where none counts.
        """
        drawn = _drawn(self, camera, T_camera_palm.tobytes())
        near = scipy.ndimage.minimum_filter(drawn, size=3)
        around = np.isfinite(near) & ~np.isfinite(drawn)
        middle = PIXEL_STRIDE // 2
        observed = np.zeros_like(drawn)
        seen = depth[middle::PIXEL_STRIDE, middle::PIXEL_STRIDE]
        observed[: seen.shape[0], : seen.shape[1]] = seen
        counts = around & (observed > 0) & (observed > near - CONTINUED_DEPTH)
        continued = observed[counts] < near[counts] + CONTINUED_DEPTH
        return float(continued.mean()) if len(continued) else 1.0

    def beside(self, camera: Camera, T_camera_palm: Array, most: int) -> Array:
        """Returns at most `most` points (k, 3) in the air, in the palm, off the hand's outline, as near as it [m]."""
        small = _smaller(camera)
        drawn = _drawn(self, camera, T_camera_palm.tobytes())
        distance = max(self.middle_at(T_camera_palm)[2], APPEARANCE_BESIDE)
        off = max(round(APPEARANCE_BESIDE * small.matrix[0, 0] / distance), 1)
        near, nearer = (scipy.ndimage.minimum_filter(drawn, size=2 * k + 1) for k in (off, off - 1))
        beside = np.isfinite(near) & ~np.isfinite(nearer)
        z = near[beside].astype(np.float64)
        points = np.c_[small.rays[beside] * z[:, None], z]
        chosen = np.random.default_rng(0).permutation(len(points))[:most]
        return se3.apply(se3.inverse(T_camera_palm), points[chosen])

    def visible_from(self, camera: Camera, T_camera_palm: Array) -> Mask:
        """Returns (m,) which points of the hand alone are visible at a pose; out of the image, all that face it."""
        small = _smaller(camera)
        drawn = _drawn(self, camera, T_camera_palm.tobytes())
        points = se3.apply(T_camera_palm, self.skin[0])
        normals = self.skin[1] @ T_camera_palm[:3, :3].T
        way = np.linalg.norm(points, axis=1)
        facing = -np.einsum("mi,mi->m", points, normals) > MIN_FACING * way
        pixels = np.round(np.nan_to_num(small.project(points), nan=-1, posinf=-1, neginf=-1)).astype(np.int64)
        inside = ((pixels >= 0) & (pixels < small.size)).all(axis=1)
        columns, rows = pixels[inside].T
        front = np.full(len(points), np.inf)
        front[inside] = drawn[rows, columns]
        slack = MAX_DEPTH + points[:, 2] / (2 * small.matrix[0, 0])
        return np.asarray(facing & (points[:, 2] < front + slack))


def skin_points(hand: Hand, count: int) -> tuple[Array, Array, Indices]:
    """Returns points (m, 3) and outward normals (m, 3) in the axes of their link, and the link of each in
    `hand.shape()`.

    m = `count` points are spread by area. Raises InvalidInput where the hand's file has no shapes.
    """
    shape = hand.shape()
    if not len(shape.faces):
        raise InvalidInput(f"hand: expected shapes of its links in {hand.file}, got none")
    by_link = [mesh.vertices[mesh.faces] for mesh in shape.meshes.values()]
    body, points, normals = sample_by_area(by_link, count, 0)
    return points, normals, body.astype(np.int64)


@lru_cache(maxsize=8)
def _smaller(camera: Camera) -> Camera:
    """Returns the camera with a quarter of the pixels to a side."""
    K = camera.matrix.copy()
    stride = PIXEL_STRIDE
    K[:2] /= stride
    K[:2, 2] -= 0.5 - 0.5 / stride
    return Camera(K, (-(-camera.size[0] // stride), -(-camera.size[1] // stride)), camera.lens)


@lru_cache(maxsize=4)  # at one pose the hand is drawn for its outline and for its visible points
def _drawn(hand: PlacedHand, camera: Camera, T_camera_palm: bytes) -> Depth:
    """Returns the depth of the coarse triangles [m] in the smaller camera; inf beside them."""
    T = np.frombuffer(T_camera_palm).reshape(4, 4)
    return _smaller(camera).draw(se3.apply(T, hand.vertices), hand.appearance.coarse[2]).depth
