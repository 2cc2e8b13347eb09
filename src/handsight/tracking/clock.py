"""A clock that jumps: from which state an observation goes on, by its stamp.

A stamp more than a second ahead of the last one is wrong, or the sensors have paused: it is believed, and undone if the
next one is nearer to those before. A stamp more than a second back is wrong, or the clock was set back, or a recording
starts again: it is left out, but if the next one is nearer to it than to those before, a new track starts.
"""

import math
from dataclasses import dataclass, replace

from handsight.tracking.track_state import TrackState

MAX_JUMP = 1.0
"""A stamp farther from the last one, ahead or back, is a jump of the clock, which the next one must confirm [s]."""
MAX_UNCONFIRMED = 3
"""So many jumps ahead in a row can be undone."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackClock:
    """A `TrackClock` holds the jumps of a track's clock that the next stamp confirms or contradicts."""

    unconfirmed: tuple[TrackState, ...] = ()
    """The state before each of the last jumps ahead that is not confirmed yet."""
    back: float = math.inf
    """The last stamp, if it was back by more than `MAX_JUMP` [s]."""
    message: str = ""
    """Why a new track was started; empty for the first one."""
    restarted_at: float = -math.inf
    """When it was started [s]."""

    def at(self, stamp: float, state: TrackState) -> tuple["TrackClock", TrackState | None, int]:
        """Returns the clock after a stamp [s], the state to go on from, and how many observations were undone.

        The state is None where a new track starts. A stamp older than the state's is late.
        """
        unconfirmed, undone = self.unconfirmed, 0
        while (
            unconfirmed
            and stamp < state.stamp - MAX_JUMP
            and abs(stamp - unconfirmed[-1].stamp) < state.stamp - stamp
        ):
            *earlier, state = unconfirmed
            unconfirmed, undone = tuple(earlier), undone + 1
        clock = replace(self, unconfirmed=unconfirmed) if undone else self
        ahead = stamp - state.stamp
        if -MAX_JUMP <= ahead <= MAX_JUMP and clock.back == math.inf and not unconfirmed:
            return clock, state, undone  # no jump
        back = stamp if ahead < -MAX_JUMP else math.inf
        last_back = math.inf if undone else self.back
        if -ahead > max(MAX_JUMP, abs(stamp - last_back)):
            message = f"the clock went back by {-ahead:.1f} s: a new track"
            return TrackClock(message=message, restarted_at=stamp), None, undone
        if ahead > MAX_JUMP and state.stamp > -math.inf:
            unconfirmed = (*unconfirmed[1 - MAX_UNCONFIRMED :], state)
        elif ahead >= -MAX_JUMP:
            unconfirmed = ()
        return replace(clock, unconfirmed=unconfirmed, back=back), state, undone
