"""What a hand looks like: triangles that move with its links."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handsight.checks import Array, Indices
from handsight.hand.chains import Chains, transform_points


class LinkMesh(NamedTuple):
    """What one link looks like."""

    vertices: Array
    """(k, 3) in the link's axes [m]."""
    faces: Indices
    """(m, 3) vertices, counterclockwise from outside."""


@dataclass(frozen=True, slots=True, eq=False)
class HandShape:
    """Triangles each of which moves with one link of a hand."""

    bodies: tuple[str, ...]
    """The links that have a shape."""
    vertices_body: Array
    """(k, 3) in the axes of their link [m]."""
    body_of: Indices
    """(k,) places in `bodies`."""
    faces: Indices
    """(m, 3) vertices, counterclockwise from outside."""
    chains: Chains
    """Of `bodies`, from the palm."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints whose positions it takes to place the links."""
        return self.chains.joints

    @property
    def meshes(self) -> dict[str, LinkMesh]:
        """By link, its triangles in its own axes."""
        first = np.searchsorted(self.body_of, np.arange(len(self.bodies) + 1))
        link = self.body_of[self.faces[:, 0]]
        return {
            body: LinkMesh(self.vertices_body[first[k] : first[k + 1]], self.faces[link == k] - first[k])
            for k, body in enumerate(self.bodies)
        }

    def vertices_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """(k, 3) where the vertices are [m]; raises InvalidInput as `Hand.Ts_palm_tip` does."""
        Ts, _ = self.chains.poses(joint_positions)
        return transform_points(self.vertices_body, self.body_of, Ts)
