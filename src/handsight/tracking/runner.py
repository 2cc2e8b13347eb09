"""Corrections in steps: an update runs a few of them, so that none waits for a long search."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from handsight.correction.problem import Steps
from handsight.tracking.track_state import Failure, Progress, TrackState

STEP_EVERY = 0.002
"""An update runs one step for so much time since the last observation [s]: most steps take less than half of it."""
CORRECTED = (
    *("estimate", "propagated_to", "correction", "corrections", "innovations", "links_checked_at"),
    *("recovered_at", "failure"),
)
"""The fields of a state that corrections alone change."""


def steps_in(elapsed: float) -> int:
    """Returns how many steps an update may run, `elapsed` after the last observation [s]: by stamps and not by the
    clock, so that a recording is answered as it was live."""
    return max(1, round(min(elapsed, 1.0) / STEP_EVERY))


class Runner:
    """Runs corrections. It keeps the computation of the last one, which can be lost: then it is repeated."""

    def __init__(self, begin: Callable[[TrackState], Steps[TrackState]]) -> None:
        """`begin`: from the state at which a correction begins to the one at its end."""
        self._begin = begin

    def run(self, progress: Progress, count: int) -> tuple[Progress | None, TrackState | None]:
        """Returns a correction after `count` more steps; where it has ended, None and the state at its end.

        An error in its first steps is that of the observation by which it began, and is raised. After one in later
        steps the state at its end is that at its beginning, with a `failure`.
        """
        started, done = progress.started, progress.steps
        # At once, as copies of a tracker may be updated by several threads.
        kept = vars(self).pop("_kept", None)
        if kept is None or kept[0].started is not started or kept[0].steps != done:
            steps = self._begin(started)
            count = done + count
            done = 0
        else:
            steps = kept[1]
        try:
            for _ in range(count):
                next(steps)
        except StopIteration as end:
            return None, end.value
        except Exception as error:
            if not progress.steps:
                raise
            return None, replace(started, failure=Failure.of(started, error))
        after = Progress(started, done + count)
        self._kept = after, steps
        return after, None

    def __getstate__(self) -> dict[str, Any]:
        """Returns what is copied and pickled: all but a computation."""
        return {"_begin": self._begin}
