"""The transforms of /tf, and the pose of one frame in another along them."""

from math import inf

import numpy as np

from handsight import se3
from handsight.checks import MAX_DISTANCE, Array

MAX_AGE = 0.1
"""The greatest age of a transform [s]."""
MAX_FRAMES = 10_000
"""Number of frames that are kept."""


class TransformTree:
    """The newest transform of each child frame of /tf."""

    def __init__(self) -> None:
        # By child frame: its parent, `T_parent_child` and the stamp [s].
        self._to_child: dict[str, tuple[str, Array, float]] = {}

    def put(self, transform: tuple[str, str, Array], stamp: float) -> None:
        """Adds a parent, a child and `T_parent_child` (4, 4); the stamp of a static transform is infinite [s]."""
        parent, child, T_parent_child = transform
        if child in self._to_child or len(self._to_child) < MAX_FRAMES:
            self._to_child[child] = parent, T_parent_child, stamp

    def keep_static(self) -> None:
        """Forgets all transforms but the static ones."""
        self._to_child = {child: each for child, each in self._to_child.items() if each[2] == inf}

    @property
    def frames(self) -> set[str]:
        """The names of all frames."""
        return {parent for parent, _, _ in self._to_child.values()} | self._to_child.keys()

    def lookup(self, target: str, source: str, stamp: float) -> Array | None:
        """Returns `T_target_source` (4, 4) at a stamp [s]; None: no recent enough transforms connect the frames."""
        above_source = self._ancestors(source, stamp)
        above_target = self._ancestors(target, stamp)
        common = next((frame for frame in above_source if frame in above_target), None)
        if common is None:
            return None
        T = above_source[common]
        if common != target:
            T = se3.inverse(above_target[common]) @ T
        # Each transform is within bounds, but their product may not be.
        return T if np.abs(T[:3, 3]).max() <= MAX_DISTANCE else None

    def _ancestors(self, frame: str, stamp: float) -> dict[str, Array]:
        """Returns `T_ancestor_frame` (4, 4) by ancestor, beginning with the frame itself, nearest first."""
        T = np.eye(4)
        found = {frame: T}
        while frame in self._to_child:
            parent, T_parent_frame, measured = self._to_child[frame]
            if stamp - measured > MAX_AGE or parent in found:  # too old, or a cycle
                break
            frame = parent
            T = T_parent_frame @ T
            found[frame] = T
        return found
