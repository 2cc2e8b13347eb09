"""How a running tracker does, as diagnostics: in words why its state is what it is, and in numbers."""

import time
from collections import Counter, deque
from statistics import median
from typing import NamedTuple

from handsight.errors import printable
from handsight.live.answers import LEVELS, OK, WARN, Status
from handsight.messages import ObservationStream
from handsight.tracking import Tracker


class HealthOptions(NamedTuple):
    """`HealthOptions` say how often the state is published."""

    period: float = 1.0  # between two messages while nothing changes [s]
    min_period: float = 0.1  # between two messages if the state flickers [s]
    max_notes: int = 20  # notes that are kept
    note_duration: float = 10.0  # how long a note is published [s]


HEALTH = HealthOptions()


class Health:
    """A `Health` is what is told once a second, and when the state changes."""

    def __init__(self, stream: ObservationStream, dropped: Counter[str]) -> None:
        self.skipped = 0
        self._stream, self._dropped = stream, dropped
        self._refusals = Counter[str]()
        self._latencies = deque[float](maxlen=500)
        self._last_state: tuple[str, str] = ("", "")
        self._published_at, self._notes = -HEALTH.period, deque[tuple[float, str]](maxlen=5)

    def noted(self, text: str) -> None:
        """Takes note of what came of something that was asked for."""
        self._notes.append((time.monotonic(), printable(text)))
        self._last_state = ("", "")

    def refused(self, text: str) -> None:
        """Counts an observation that was wrong in itself."""
        self._refusals[
            text if text in self._refusals or len(self._refusals) < HEALTH.max_notes else "others"
        ] += 1

    def answered(self, seconds: float) -> None:
        """Takes note of how long a message took to be answered."""
        self._latencies.append(seconds)

    def due(self, tracker: Tracker) -> bool:
        """Returns whether it is time to tell, or there is something new."""
        now, passed = time.monotonic(), time.monotonic() - self._published_at
        state = tracker.state, tracker.reason if tracker.state == "lost" else ""
        if passed < (HEALTH.min_period if state[0] != self._last_state[0] else HEALTH.period):
            return False
        self._published_at, self._last_state = now, state
        return True

    def statuses(self, tracker: Tracker, stream: ObservationStream) -> list[Status]:
        """Returns statuses of the pose, and of what is heard."""
        return [self._of_pose(tracker), self._of_input(tracker, stream)]

    def _of_pose(self, tracker: Tracker) -> Status:
        estimate = tracker.estimate
        values: dict[str, object] = {
            "state": tracker.state,
            "object": tracker.model.name,
            "touching": ", ".join(tracker.fingertips.fingers) or "nothing",
            "position known to [mm]": f"{1e3 * tracker.sigma:.1f}",
            "open directions": "" if estimate is None else len(estimate.unobservable),
            "corrections": tracker.corrections,
        }
        values |= {f"no contact of {name}": why for name, why in tracker.fingertips.reasons.items()}
        return Status("pose", LEVELS[tracker.state], tracker.reason or "tracking", values)

    def _of_input(self, tracker: Tracker, stream: ObservationStream) -> Status:
        now = time.monotonic()
        text = [note for when, note in self._notes if now - when < HEALTH.note_duration]
        wrong = [
            f"{count} messages on {topic} dropped: too many came" for topic, count in self._dropped.items()
        ]
        wrong += [f"{count} observations left out: {why}" for why, count in self._refusals.items()]
        wrong += [*stream.lacks(), *stream.report.sentences()]
        if not stream.report.observations:
            wrong.insert(0, f"no joint states on {stream.report.joint_states} so far")
        latencies = sorted(self._latencies)
        values: dict[str, object] = {
            "observations": stream.report.observations,
            "skipped as newer ones waited": self.skipped,
            "late": tracker.late,
            "dropped": self._dropped.total(),
        }
        if latencies:
            values["answered after [ms], median"] = f"{1e3 * median(latencies):.2f}"
            values["answered after [ms], 99 %"] = f"{1e3 * latencies[int(0.99 * (len(latencies) - 1))]:.2f}"
        values |= {
            f"said {k}": sentence for k, sentence in enumerate([*text, *wrong][: HEALTH.max_notes], start=1)
        }
        first = next(iter(text + wrong), "all is heard")
        return Status("input", WARN if wrong else OK, first, values)
