"""Whether the hand grasps something, from the fingers that touch."""

from typing import Literal

GraspChange = Literal["grasped", "regrasped", "released"]

RELEASE_AFTER = 0.2
"""Nothing may be touched for so long before the object counts as released [s]: contacts flicker as fingers close."""
LIFTED = 0.005
"""A palm that rose by so much since the grasp has lifted the object [m]."""
ENOUGH_FINGERS = 2
"""So many fingers that stay keep an object where it is while others come and go."""


class GraspState:
    """Whether one object is grasped, over time."""

    def __init__(self) -> None:
        """Nothing is grasped at first."""
        self.grasped = False
        self._fingers: frozenset[str] = frozenset()
        self._touched_at = -float("inf")
        self._height: float | None = None

    def update(self, fingers: tuple[str, ...], stamp: float) -> GraspChange | None:
        """What has changed: a grasp begun, ended, or its fingers so different that the object may have moved."""
        now = frozenset(fingers)
        if now:
            self._touched_at = stamp
        change: GraspChange | None = None
        if self.grasped and stamp - self._touched_at > RELEASE_AFTER:
            self.grasped, self._height, change = False, None, "released"
        elif now and not self.grasped:
            self.grasped, change = True, "grasped"
        elif now and now != self._fingers and len(now & self._fingers) < ENOUGH_FINGERS:
            change = "regrasped"
        if now or change == "released":
            self._fingers = now
        return change

    def on_table(self, height: float) -> bool:
        """Whether an object that stood when it was grasped still does; `height` of the palm in the world [m]."""
        if self._height is None:
            self._height = height
        return height < self._height + LIFTED
