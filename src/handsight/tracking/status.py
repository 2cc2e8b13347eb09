"""How far a track's answer is to be trusted, and why no further."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from handsight.tracking.settings import TrackerSettings

State = Literal["tracking", "uncertain", "lost"]
LOST_WITHOUT_FIT = 2.0
"""So long contacts may contradict every pose before the object counts as lost [s]."""
CONTRADICTED = "the contacts do not fit the object where it is believed to be"
SLIPS = "the object slips: every finger that holds it is at the limit of friction"
VISION_ALONE = "nothing is touched: the pose is vision's"


@dataclass(frozen=True, slots=True)
class TrackStatus:
    """A `TrackStatus` says when something was last measured, and when contacts last fitted."""

    settings: TrackerSettings
    measured_at: float = -math.inf
    """[s]"""
    fits_at: float = -math.inf
    """The first answer counts as a fit [s]."""

    def measured(self, stamp: float) -> "TrackStatus":
        """Returns the status after something was touched or seen."""
        return replace(self, measured_at=stamp)

    def answered(self, stamp: float, *, consistent: bool) -> "TrackStatus":
        """Returns the status after an answer that its contacts fit, or not."""
        return replace(self, fits_at=stamp) if consistent or self.fits_at == -math.inf else self

    def unfitted(self, stamp: float) -> bool:
        """Returns whether contacts have contradicted every pose for long."""
        return stamp - self.fits_at > LOST_WITHOUT_FIT

    def judged(self, stamp: float, sigma: float, doubt: str) -> tuple[State, str]:
        """Returns the state, and why it is no better, of an answer whose position has that `sigma` [m].

        `doubt`: what else speaks against it, though it may be right; empty: nothing.
        """
        if self.measured_at == -math.inf:
            return "lost", "nothing was touched or seen yet"
        if stamp - self.measured_at > self.settings.lost_after:
            return "lost", f"nothing touched and nothing seen for {stamp - self.measured_at:.1f} s"
        if self.unfitted(stamp):
            return "lost", f"the contacts have fitted no pose for {stamp - self.fits_at:.1f} s"
        if not doubt and sigma > self.settings.uncertain_position:
            doubt = f"the position is known to {1e3 * sigma:.0f} mm only"
        return ("uncertain", doubt) if doubt else ("tracking", "")
