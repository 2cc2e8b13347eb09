"""What a hand looks like: triangles that move with its links."""

from collections.abc import Mapping
from dataclasses import dataclass

from handsight.checks import Array, Indices
from handsight.hand.chains import Chains, carried


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

    def vertices_palm(self, joint_positions: Mapping[str, float]) -> Array:
        """(k, 3) where the vertices are [m]; raises InvalidInput as `Hand.Ts_palm_tip` does."""
        Ts, _ = self.chains.poses(joint_positions)
        return carried(self.vertices_body, self.body_of, Ts)
