"""A clock that jumps: the state that an observation continues, by its stamp.

A stamp more than a second ahead of the last one may be wrong, or the sensors may have paused. The observation is used,
and undone if the next stamp is nearer to those before the jump. A stamp more than a second back may be wrong, or the
clock was set back, or a recording starts again. The observation is left out; but if the next stamp is nearer to it than
to those before the jump, a new track starts.
"""

import math
from dataclasses import dataclass, replace

from handsight.observation import MAX_JUMP
from handsight.tracking.track_state import TrackState

MAX_UNCONFIRMED = 3
"""The most jumps ahead in a row that can be undone."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackClock:
    """A `TrackClock` holds the jumps of a track's clock that the next stamp will confirm or contradict."""

    unconfirmed: tuple[TrackState, ...] = ()
    """The states before the last jumps ahead, those that are not confirmed yet."""
    back: float = math.inf
    """The last stamp, if it was back by more than `MAX_JUMP` [s]; else infinite."""
    message: str = ""
    """Why a new track was started; empty during the first track."""
    restarted_at: float = -math.inf
    """When the new track was started [s]."""

    def at(self, stamp: float, state: TrackState) -> tuple["TrackClock", TrackState | None, int]:
        """Returns the clock after a stamp [s], the state to continue, and how many observations were undone.

        `state` is the track's last state. The state to continue is None where a new track starts; an observation whose
        stamp is older than that state is late.
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
