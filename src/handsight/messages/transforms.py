"""Transforms of messages: numbers to (4, 4), and /tf to the pose of any frame in any other."""

from collections.abc import Sequence
from math import hypot, isfinite
from typing import Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.messages.report import MessageRejected

MAX_AGE = 0.1
"""Oldest transform that still counts as now [s]."""
MAX_DEPTH = 64
"""Transforms from world to palm; beyond it the tree is a circle."""
MAX_FRAMES = 10_000


class FrameTransform(NamedTuple):
    """A transform of /tf."""

    parent: str
    child: str
    T_parent_child: Array
    """(4, 4)."""


class TransformTree:
    """The newest transform to each frame of /tf."""

    def __init__(self) -> None:
        """Empty."""
        self._to_child: dict[str, tuple[FrameTransform, float]] = {}

    def put(self, transform: FrameTransform, stamp: float) -> None:
        """Take in a transform; a static one is of infinite stamp."""
        if transform.child in self._to_child or len(self._to_child) < MAX_FRAMES:
            self._to_child[transform.child] = (transform, stamp)

    @property
    def frames(self) -> set[str]:
        """All that were named."""
        return {name for each, _ in self._to_child.values() for name in (each.parent, each.child)}

    def lookup(self, target: str, source: str, stamp: float) -> Array | None:
        """`T_target_source` (4, 4) at that time; None where the frames are not connected, or by old transforms."""
        above_source, above_target = self._ancestors(source, stamp), self._ancestors(target, stamp)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            return None
        T = above_source[common]
        return T if common == target else se3.inverse(above_target[common]) @ T

    def _ancestors(self, frame: str, stamp: float) -> dict[str, Array]:
        """`T_ancestor_frame` for the frame itself and its ancestors, nearest first."""
        T = np.eye(4)
        found = {frame: T}
        while frame in self._to_child and len(found) < MAX_DEPTH:
            transform, measured = self._to_child[frame]
            if stamp - measured > MAX_AGE or transform.parent in found:
                break
            T = transform.T_parent_child @ T
            frame = transform.parent
            found[frame] = T
        return found


def frame_transform(message: Any) -> FrameTransform:
    """The transform of a TransformStamped; raises MessageRejected."""
    p, q = message.transform.translation, message.transform.rotation
    parent, child = message.header.frame_id.lstrip("/"), message.child_frame_id.lstrip("/")
    try:
        return FrameTransform(parent, child, rigid_transform((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    except MessageRejected as error:
        raise MessageRejected(f"transform to {child[:60]!r}: {error}", nan=error.nan) from None


def rigid_transform(position: Sequence[float], quaternion_xyzw: Sequence[float]) -> Array:
    """(4, 4); raises MessageRejected. In plain floats: for one pose NumPy is ten times slower."""
    x, y, z, w = quaternion_xyzw
    length = hypot(x, y, z, w)
    if not isfinite(length + sum(map(abs, position))):
        raise MessageRejected("position or orientation is not finite", nan=True)
    if length < 1e-6:
        raise MessageRejected("expected an orientation, got a quaternion of length 0")
    x, y, z, w = x / length, y / length, z / length, w / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), position[0]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), position[1]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), position[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
