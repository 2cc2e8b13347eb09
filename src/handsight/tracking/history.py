"""Joints and palm during the last second: what a camera measured arrives later than the image was taken."""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from handsight.checks import Array

DURATION = 1.0
"""How long an instant is kept [s]."""
MAX_INSTANTS = 2000


class Instant(NamedTuple):
    """An `Instant` is joints and palm at one instant, each if it was measured."""

    stamp: float
    joint_positions: Mapping[str, float] | None
    T_world_palm: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """A `History` is the instants of the last second, and some before them, in order of their stamps."""

    instants: tuple[Instant, ...] = ()

    def after(self, instant: Instant) -> "History":
        """Returns the history with one more instant; later ones, whose stamps were taken back, are dropped."""
        kept = self.instants
        if kept and kept[-1].stamp >= instant.stamp:
            kept = kept[: bisect_left(kept, instant.stamp, key=_stamp)]
        if len(kept) >= MAX_INSTANTS or (kept and kept[0].stamp < instant.stamp - 1.25 * DURATION):
            # Now and then, for finding where they begin takes longer than adding one.
            first = bisect_left(kept, instant.stamp - DURATION, key=_stamp)
            kept = kept[max(first, len(kept) + 1 - MAX_INSTANTS) :]
        return History((*kept, instant))

    def at(self, stamp: float | None) -> Instant | None:
        """Returns the instant nearest to a stamp, the last one for None; None where the stamp is older than all."""
        if stamp is None or not self.instants:
            return self.instants[-1] if self.instants else None
        first = bisect_left(self.instants, self.instants[-1].stamp - DURATION, key=_stamp)
        if stamp < self.instants[first].stamp - DURATION / 10:
            return None
        return min(self.instants[first:], key=lambda instant: abs(instant.stamp - stamp))


def _stamp(instant: Instant) -> float:
    return instant.stamp
