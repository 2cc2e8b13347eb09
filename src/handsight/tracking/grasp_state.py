"""Whether something is held, from the fingers that touch."""

from typing import Literal

Change = Literal["gripped", "changed", "released"]

RELEASE = 0.2
"""Nothing may be touched for so long before a grip counts as released [s]: contacts flicker as fingers close."""
LIFTED = 0.005
"""A palm that rose by so much since the grip has lifted the object [m]."""
FIRM = 2
"""So many fingers that stay hold an object while others come and go."""


class Grip:
    """The grip on one object over time."""

    def __init__(self) -> None:
        """Nothing is held at first."""
        self.held = False
        self._fingers: frozenset[str] = frozenset()
        self._touched_at = -float("inf")
        self._height: float | None = None

    def feel(self, fingers: tuple[str, ...], stamp: float) -> Change | None:
        """What has become of the grip: begun, ended, or its fingers so changed that the object may have moved."""
        now = frozenset(fingers)
        if now:
            self._touched_at = stamp
        change: Change | None = None
        if self.held and stamp - self._touched_at > RELEASE:
            self.held, self._height, change = False, None, "released"
        elif now and not self.held:
            self.held, change = True, "gripped"
        elif now and now != self._fingers and len(now & self._fingers) < FIRM:
            change = "changed"
        if now or change == "released":
            self._fingers = now
        return change

    def standing(self, height: float) -> bool:
        """Whether an object that stood when it was gripped still does; `height` of the palm in the world [m]."""
        if self._height is None:
            self._height = height
        return height < self._height + LIFTED
