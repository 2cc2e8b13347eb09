"""Box, cylinder and sphere: exact distance fields, triangles for drawing, and symmetries."""

import itertools
from dataclasses import dataclass

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects.fields import ExactField, coarse_grid
from handsight.objects.geometry import Geometry, geometry_of
from handsight.objects.surface import Triangles, diameter, unit
from handsight.objects.symmetry import Symmetries


@dataclass(frozen=True, eq=False)
class Rounded(Triangles):
    """Curved surface with an exact distance field; its triangles approximate it."""

    field: ExactField  # the exact distance field
    exact_area: float  # area of the curved surface [m²]

    @property
    def area(self) -> float:
        """Of the curved surface [m²]."""
        return self.exact_area

    def draw(self, n: int, rng: np.random.Generator) -> tuple[Array, Array]:
        """Returns n random points (n, 3) [m] of the curved surface and its normals (n, 3) there."""
        points, _ = super().draw(n, rng)
        values = self.field.evaluate(points)
        return points - values.distance[:, None] * values.gradient, values.gradient


def box(sides: Array) -> tuple[Geometry, Symmetries]:
    """Returns a box with `sides` (3,) [m]; its symmetries: half turns, and quarter turns between equal sides."""
    half = sides / 2
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    turns = [np.pi * axis for axis in np.eye(3)]
    for k in range(3):
        one = sides[k - 2]
        other = sides[k - 1]
        if abs(one - other) <= 1e-9 * max(one, other):
            turns.append(np.pi / 2 * np.eye(3)[k])
    R = se3.rotation_exp(np.array(turns)).round()
    symmetries = Symmetries(rotations=se3.compose(R, np.zeros((len(turns), 3))))
    return _geometry(Triangles(corners, faces), ExactField("box", half)), symmetries


def cylinder(radius: float, height: float) -> tuple[Geometry, Symmetries]:
    """Returns a cylinder about z, `radius` and `height` [m]; its symmetries: turns about z, half turns across."""
    half_height = height / 2
    segments = 96
    angle = 2 * np.pi * np.arange(segments) / segments
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    levels = [np.column_stack([ring, np.full(segments, z)]) for z in (-half_height, half_height)]
    vertices = np.vstack([*levels, [[0, 0, -half_height], [0, 0, half_height]]])
    low = np.arange(segments)
    after = (low + 1) % segments
    high = low + segments
    up = after + segments
    bottom = np.full(segments, 2 * segments)
    parts = [(low, after, up), (low, up, high), (bottom, after, low), (bottom + 1, high, up)]
    faces = np.hstack(parts).T
    exact = ExactField("cylinder", np.array([radius, half_height, 0.0]))
    area = 2 * np.pi * radius * (radius + height)
    symmetries = Symmetries([((0, 0, 0), (0, 0, 1))], [np.diag([1.0, -1.0, -1.0, 1.0])])
    return _geometry(Rounded(vertices, faces, exact, area), exact), symmetries


def sphere(radius: float) -> tuple[Geometry, Symmetries]:
    """Returns a ball of that radius [m], drawn as an octahedron divided four times; its symmetries: all rotations."""
    vertices = np.vstack([np.eye(3), -np.eye(3)])
    faces = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)])
    for _ in range(4):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        pairs, which = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
        a, b, c = faces.T
        middles = vertices[pairs].sum(axis=1)
        vertices = np.vstack([vertices, unit(middles)])
        faces = np.hstack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]).T
    exact = ExactField("sphere", np.array([radius, 0.0, 0.0]))
    surface = Rounded(radius * vertices, faces, exact, 4 * np.pi * radius**2)
    return _geometry(surface, exact), Symmetries([((0, 0, 0), axis) for axis in np.eye(3)])


def _geometry(surface: Triangles, exact: ExactField) -> Geometry:
    """Returns the geometry of a surface whose distance field is exact."""
    vertices = surface.vertices
    size = diameter(surface.vertices)
    grid, _ = coarse_grid(vertices, size, float(np.ptp(vertices, axis=0).min()))
    return geometry_of(surface, grid.field(exact.evaluate(grid.nodes()).distance), exact, diameter=size)
