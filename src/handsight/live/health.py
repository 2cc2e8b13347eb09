"""Whether a live tracker is well: what has stopped coming, what was left out lately, and how old the answer is.

Everything is judged at an instant from when messages came, so silence is noticed as well as a wrong message is.
"""

import math
import time
from collections import Counter, deque
from collections.abc import Mapping

import numpy as np

from handsight.errors import printable
from handsight.live.answers import Status
from handsight.messages import ObservationStream
from handsight.messages.topics import TopicReport
from handsight.tracking import State, Tracker

PERIOD = 1.0
"""Time between two diagnostics while nothing changes [s]."""
MIN_PERIOD = 0.1
"""Time between two judgements, and between two diagnostics if one changes [s]."""
FAULT_WINDOW = 10.0
"""Faults are reported for so long [s]."""
MAX_MISSED = 5
"""An input that has missed so many messages in a row is silent."""
MIN_SILENCE = 0.25
"""An input is not silent before so long [s]."""
MEMORY = 100
"""The usual rate is that of so many messages."""
MAX_NOTES = 20
"""Number of sentences in a message, and of different reasons for refusals."""
OK = 0
WARN = 1
ERROR = 2
STALE = 3
"""The severity of a status, as diagnostic_msgs defines it."""
OCCASIONAL = "vision", "detections", "mask", "color"
"""Roles of topics on which nothing may come, as where a detector does not find the object."""
ONCE = "tf_static", "info"
"""Roles of topics that are published once."""


class Arrivals:
    """When the last messages of one input came."""

    def __init__(self) -> None:
        self._times = deque[float](maxlen=MEMORY)

    def came(self, now: float) -> None:
        """Notes a message that came at `now` [s]."""
        self._times.append(now)

    @property
    def rate(self) -> float:
        """Messages in a second, on average over the last ones; infinite before the second message."""
        seconds = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / seconds if seconds > 0 else math.inf

    def silence(self, now: float) -> float:
        """Returns for how long nothing has come [s], where several messages were to come; else 0."""
        silence = now - self._times[-1]
        return silence if silence > max(MIN_SILENCE, MAX_MISSED / self.rate) else 0.0


class Health:
    """Whether a live tracker and its input are well; all times are `time.monotonic`'s [s]."""

    def __init__(self, stream: ObservationStream, dropped: Counter[str]) -> None:
        """`dropped`: number of messages that were dropped because too many waited, by topic."""
        self.skipped = 0
        """Number of joint states that were skipped, as newer ones waited."""
        self._stream = stream
        self._dropped = dropped
        self._refusals = Counter[str]()
        self._inputs = dict[str, Arrivals]()
        self._answers = Arrivals()
        self._latencies = deque[float](maxlen=500)
        self._notes = deque[tuple[float, str]](maxlen=5)
        self._counted = deque([(-math.inf, Counter[str]())])
        self._judged_at = self._published_at = -math.inf
        self._last: tuple[object, ...] = ()

    def noted(self, text: str) -> None:
        """Keeps the outcome of a user's request, for the next diagnostics."""
        self._notes.append((time.monotonic(), printable(text)))
        self._last = ()

    def refused(self, text: str) -> None:
        """Counts an observation that the tracker refused, by reason."""
        known = text in self._refusals or len(self._refusals) < MAX_NOTES
        self._refusals[text if known else "others"] += 1

    def came(self, topic: TopicReport, now: float) -> None:
        """Counts a message that could be read."""
        if topic.role not in ONCE:
            self._inputs.setdefault(topic.name, Arrivals()).came(now)

    def answered(self, now: float, seconds: float) -> None:
        """Counts an answer, and keeps how long after its joint states had come it was ready [s]."""
        self._answers.came(now)
        self._latencies.append(seconds)

    def trust(self, tracker: Tracker, now: float) -> tuple[int, State, str]:
        """Returns the level, state and reason of the pose, which also a tracker that hears nothing gets older."""
        silence = self._answers.silence(now) if self._latencies else 0.0
        if silence:
            what = f"no observation for {silence:.1f} s"
            if silence > tracker.settings.lost_after:
                return ERROR, "lost", what
            return STALE, tracker.state, f"{what}, before {tracker.reason or tracker.state}"
        level = {"tracking": OK, "uncertain": WARN, "lost": ERROR}[tracker.state]
        return level, tracker.state, tracker.reason

    def statuses(self, tracker: Tracker, now: float) -> list[Status]:
        """Returns two statuses, of the pose and of the input, where they are to be published now; else none.

        That is once a second, and as soon as one of them gets another level or the pose another state.
        """
        if now - self._judged_at < MIN_PERIOD:
            return []
        self._judged_at = now
        silences = {name: arrivals.silence(now) for name, arrivals in self._inputs.items()}
        level, wrong = self._judged(now, silences)
        trust, state, reason = self.trust(tracker, now)
        judged = (trust, state, level)
        if judged == self._last and now - self._published_at < PERIOD:
            return []
        self._last = judged
        self._published_at = now
        notes = [note for when, note in self._notes if time.monotonic() - when < FAULT_WINDOW]
        said = [*notes, *wrong]
        pose = Status("pose", trust, reason or "tracking", self._of_pose(tracker, state))
        values = self._of_input(tracker, silences, said)
        return [pose, Status("input", level, said[0] if said else "all is heard", values)]

    def _judged(self, now: float, silences: Mapping[str, float]) -> tuple[int, list[str]]:
        """Returns the level of the input, and a sentence for each fault."""
        report = self._stream.report
        counts = report.counts()
        counts |= Counter({f"observation left out: {why}": count for why, count in self._refusals.items()})
        counts |= Counter(
            {f"{name}: messages dropped: too many came": n for name, n in self._dropped.items()}
        )
        if now - self._counted[-1][0] >= PERIOD:
            self._counted.append((now, counts))
            while now - self._counted[1][0] >= FAULT_WINDOW:
                self._counted.popleft()
        _, before = self._counted[0]
        wrong = list[str]()
        level = OK
        for name, silence in silences.items():
            if silence:
                usually = f"usually {self._inputs[name].rate:.3g} Hz"
                wrong.append(f"{name}: silent for {silence:.1f} s, {usually}")
                if report.topics[name].role not in OCCASIONAL:
                    level = STALE
        wrong += [printable(f"{what} ({count} times)") for what, count in (counts - before).items()]
        wrong += [*self._stream.lacks(), *report.notes()]
        if wrong and level == OK:
            level = WARN
        return level, wrong

    def _of_pose(self, tracker: Tracker, state: State) -> dict[str, object]:
        estimate = tracker.estimate
        return {
            "state": state,
            "object": tracker.model.name,
            "touching": ", ".join(tracker.fingertips.fingers) or "nothing",
            "position known to [mm]": f"{1e3 * tracker.sigma:.1f}",
            "open directions": "" if estimate is None else len(estimate.unobservable),
            "corrections": tracker.corrections,
            **{f"images, {name}": count for name, count in tracker.images.items()},
            **{f"no contact of {name}": why for name, why in tracker.fingertips.reasons.items()},
            **{f"no force of {name}": "not measured" for name in tracker.slip.unmeasured},
            **({"slips": tracker.slip.doubt} if tracker.slip.doubt else {}),
        }

    def _of_input(
        self, tracker: Tracker, silences: Mapping[str, float], said: list[str]
    ) -> dict[str, object]:
        values: dict[str, object] = {
            "observations": self._stream.report.observations,
            "skipped as newer ones waited": self.skipped,
            "late": tracker.late,
            "dropped": self._dropped.total(),
        }
        for name, silence in silences.items():
            values[f"{name} [Hz]"] = f"{0.0 if silence else self._inputs[name].rate:.3g}"
        topics = self._stream.report.topics.items()
        values |= {f"{name}, left out": topic.left_out for name, topic in topics if topic.left_out}
        if self._latencies:
            middle, slow = np.quantile(self._latencies, (0.5, 0.99))
            values["answered after [ms], median"] = f"{1e3 * middle:.2f}"
            values["answered after [ms], 99 %"] = f"{1e3 * slow:.2f}"
        return values | {f"said {k}": each for k, each in enumerate(said[:MAX_NOTES], start=1)}
