"""Whether a live tracker is well: its state, what is silent, what was left out lately, how old its answers are.

Everything is judged at an instant from when messages came, so silence is noticed as well as a wrong message is.
"""

import math
from collections import Counter, deque

import numpy as np

from handsight.errors import printable
from handsight.live.answers import Status
from handsight.messages import ObservationStream
from handsight.messages.report import Fault
from handsight.messages.topics import Topic
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
"""Number of sentences in a message."""
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
        silence = now - self._times[-1] if self._times else 0.0
        return silence if silence > MIN_SILENCE and silence > MAX_MISSED / self.rate else 0.0


class Health:
    """Whether a live tracker and its input are well; all times are `time.monotonic`'s [s]."""

    def __init__(self, stream: ObservationStream, dropped: Counter[str]) -> None:
        """`dropped`: number of messages that were dropped because too many waited, by topic."""
        self.skipped = 0
        """Number of joint states that were skipped, as newer ones waited."""
        self._stream = stream
        self._dropped = dropped
        self._inputs = dict[str, Arrivals]()
        self._answers = Arrivals()
        self._latencies = deque[float](maxlen=500)
        self._notes = deque[tuple[float, str]](maxlen=5)
        self._counted = deque([(-math.inf, Counter[Fault]())])
        self._judged_at = self._published_at = -math.inf
        self._last: tuple[object, ...] = ()

    def noted(self, text: str, now: float) -> None:
        """Keeps the outcome of a request, or why an observation was refused, for the next diagnostics."""
        self._notes.append((now, printable(text)))
        self._last = ()

    def came(self, topic: Topic, now: float) -> None:
        """Counts a message that could be read."""
        if topic.role not in ONCE:
            self._inputs.setdefault(topic.name, Arrivals()).came(now)

    def answered(self, now: float, seconds: float) -> None:
        """Counts an answer, and keeps how long after its joint states had come it was ready [s]."""
        self._answers.came(now)
        self._latencies.append(seconds)

    def trust(self, tracker: Tracker, now: float) -> tuple[int, State, str]:
        """Returns the level, state and reason of the pose, which also a tracker that hears nothing gets older."""
        silence = self._answers.silence(now)
        what = f"no observation for {silence:.1f} s"
        if silence > tracker.settings.lost_after:
            return ERROR, "lost", what
        if silence:
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
        silent = [self._stream.topics[name].role for name, silence in silences.items() if silence]
        said = [
            f"{name}: silent for {silence:.1f} s, usually {self._inputs[name].rate:.3g} Hz"
            for name, silence in silences.items()
            if silence
        ]
        said += [*self._lately(now), *self._stream.lacks()]
        stale = any(role not in OCCASIONAL for role in silent)
        level = STALE if stale else WARN if said else OK
        trust, state, reason = self.trust(tracker, now)
        if (trust, state, level) == self._last and now - self._published_at < PERIOD:
            return []
        self._last = (trust, state, level)
        self._published_at = now
        said = [note for when, note in self._notes if now - when < FAULT_WINDOW] + said
        pose = Status("pose", trust, reason or "tracking", _pose_values(tracker, state))
        values = self._input_values(tracker, silences)
        values |= {f"said {k}": each for k, each in enumerate(said[:MAX_NOTES], start=1)}
        return [pose, Status("input", level, said[0] if said else "all is heard", values)]

    def _lately(self, now: float) -> list[str]:
        """Returns a sentence for each row of the report whose count has risen lately, or that has none."""
        rows = self._stream.report.table()
        rows += [
            Fault(f"{name}: ", "messages dropped: too many came", n) for name, n in self._dropped.items()
        ]
        counts = Counter({row._replace(number=0, total=None, detail=""): row.number or 0 for row in rows})
        if now - self._counted[-1][0] >= PERIOD:
            self._counted.append((now, counts))
            while now - self._counted[1][0] >= FAULT_WINDOW:
                self._counted.popleft()
        risen = counts - self._counted[0][1]
        uncounted = [row.sentence for row in rows if row.number is None]
        return [row._replace(number=count).sentence for row, count in risen.items()] + uncounted

    def _input_values(self, tracker: Tracker, silences: dict[str, float]) -> dict[str, object]:
        report = self._stream.report
        values: dict[str, object] = {
            "observations": report.observations,
            "skipped as newer ones waited": self.skipped,
            "late": tracker.late,
            "dropped": self._dropped.total(),
        }
        for name, silence in silences.items():
            values[f"{name} [Hz]"] = f"{0.0 if silence else self._inputs[name].rate:.3g}"
        values |= {
            f"{name}, left out": each.left_out for name, each in report.topics.items() if each.left_out
        }
        if self._latencies:
            middle, slow = np.quantile(self._latencies, (0.5, 0.99))
            values["answered after [ms], median"] = f"{1e3 * middle:.2f}"
            values["answered after [ms], 99 %"] = f"{1e3 * slow:.2f}"
        return values


def _pose_values(tracker: Tracker, state: State) -> dict[str, object]:
    estimate = tracker.estimate
    values: dict[str, object] = {
        "state": state,
        "object": tracker.model.name,
        "touching": ", ".join(tracker.fingertips.fingers) or "nothing",
        "position known to [mm]": f"{1e3 * tracker.sigma:.1f}",
        "open directions": "" if estimate is None else len(estimate.unobservable),
        "corrections": tracker.corrections,
    }
    values |= {f"images, {name}": count for name, count in tracker.images.items()}
    values |= {f"no contact of {name}": why for name, why in tracker.fingertips.reasons.items()}
    values |= {f"no force of {name}": "not measured" for name in tracker.slip.unmeasured}
    return values | ({"slips": tracker.slip.doubt} if tracker.slip.doubt else {})
