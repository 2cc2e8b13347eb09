"""Where the joints and the palm were a moment ago: what vision says arrives later than it was seen."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from handsight.checks import Array

KEPT = 1.0
"""[s]"""
MOST = 2000
"""Instants kept at most."""


class Instant(NamedTuple):
    """Joints and palm at one instant, each if it was measured."""

    stamp: float
    joint_positions: Mapping[str, float] | None
    T_world_palm: Array | None


class History:
    """The last second."""

    def __init__(self) -> None:
        self._instants = deque[Instant](maxlen=MOST)

    def put(self, instant: Instant) -> None:
        """Takes note of now; what was noted of later instants was taken back."""
        while self._instants and self._instants[-1].stamp >= instant.stamp:
            self._instants.pop()
        self._instants.append(instant)
        while self._instants[0].stamp < instant.stamp - KEPT:
            self._instants.popleft()

    def at(self, stamp: float | None) -> Instant | None:
        """The instant nearest to a stamp, the last one for None; None where the stamp is older than all of them."""
        if stamp is None or not self._instants:
            return self._instants[-1] if self._instants else None
        if stamp < self._instants[0].stamp - KEPT / 10:
            return None
        return min(self._instants, key=lambda instant: abs(instant.stamp - stamp))
