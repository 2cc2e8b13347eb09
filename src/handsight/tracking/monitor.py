"""What a tracker remembers to judge its answers by."""

import math
from dataclasses import dataclass
from typing import Literal

from handsight.observation import seconds
from handsight.tracking.misfit import NO_INNOVATIONS, Innovations

State = Literal["tracking", "uncertain", "lost"]
NO_POSE = "no pose yet: neither a start nor vision"
LOST_WITHOUT_FIT = 2.0  # how long contacts may contradict every pose before the object is lost [s]


@dataclass(frozen=True, slots=True)
class Failure:
    """Says why a correction has ended without an answer."""

    stamp: float
    """Of the observation by which it began [s]."""
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Monitor:
    """Says how well evidence has fitted lately, and how far the answer can be trusted; see `judge.py`."""

    label: State = "lost"
    """How far the answer can be trusted."""
    reason: str = NO_POSE
    """Why it cannot be trusted further; empty while tracking."""
    innovations: Innovations = NO_INNOVATIONS
    """How well each kind of evidence has fitted the model over the last second."""
    measured_at: float = -math.inf
    """When something was last touched or detected by vision [s]."""
    fits_at: float = -math.inf
    """When contacts last fitted the estimate; the first estimate counts as a fit [s]."""
    corrections: int = 0
    """How often the pose was corrected."""
    failure: Failure | None = None
    """Why the last correction has no answer; None where it has one."""

    def lost_at(self, stamp: float) -> bool:
        """Returns whether contacts have fitted no pose for so long that the object is lost."""
        return seconds(stamp, self.fits_at) > LOST_WITHOUT_FIT


NOTHING_YET = Monitor()
