"""How long a correction may search."""

import time
from dataclasses import dataclass

import numpy as np

from handsight import checks


@dataclass(slots=True)
class Budget:
    """A `Budget` is the time at which a search has to end, and whether it has had to."""

    ends: float = np.inf
    """By `time.perf_counter` [s]."""
    cut_short: bool = False
    """Whether something was not looked at for want of time."""

    @classmethod
    def of(cls, seconds: float | None) -> "Budget":
        """Returns a budget from now on; None: as long as it takes. Raises InvalidInput."""
        if seconds is None:
            return cls()
        return cls(time.perf_counter() + checks.positive(seconds, "budget"))

    def spent(self) -> bool:
        """Returns whether it is over: what the caller then leaves out is noted."""
        if time.perf_counter() >= self.ends:
            self.cut_short = True
        return self.cut_short
