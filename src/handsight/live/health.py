"""Whether a live tracker is well: what comes in against what used to, what was left out lately, how old the answer is.

Everything is judged at an instant from when messages came, so silence is noticed as well as a wrong message is.
"""

import math
import time
from collections import Counter, deque
from itertools import islice
from statistics import median
from typing import NamedTuple

from handsight.errors import printable
from handsight.live.answers import Status
from handsight.messages import ObservationStream
from handsight.messages.report import Report
from handsight.tracking import State, Tracker


class HealthOptions(NamedTuple):
    """`HealthOptions` say when an input is silent, and how often and how much diagnostics report."""

    period: float = 1.0  # between two messages while nothing changes [s]
    min_period: float = 0.1  # between two judgements, and two messages if one changes [s]
    window: float = 10.0  # faults are reported for so long [s]
    missed: int = 5  # an input that has missed so many messages in a row is silent
    min_silence: float = 0.25  # but not before so long [s]
    slow: float = 0.5  # an input with less than this share of its usual rate is slow
    memory: int = 60  # the usual rate is the median over so many seconds in which something came
    max_notes: int = 20  # number of sentences in a message, and of different reasons for refusals


HEALTH = HealthOptions()
OK, WARN, ERROR, STALE = 0, 1, 2, 3
"""The severity of a status, as diagnostic_msgs defines it."""
OCCASIONAL = "vision", "detections", "mask", "color"
"""Roles of topics on which nothing may come, as where a detector does not find the object."""
ONCE = "tf_static", "info"
"""Roles of topics that are published once."""


class Rate(NamedTuple):
    """A `Rate` compares the messages of an input per second, usually and now; `silence`: since the last one [s]."""

    expected: float
    measured: float
    silence: float

    @property
    def silent(self) -> bool:
        """Whether several messages that were to come have not come."""
        return self.silence > max(HEALTH.min_silence, HEALTH.missed / self.expected)

    @property
    def slow(self) -> bool:
        """Whether it comes at less than half of its usual rate."""
        return self.measured < HEALTH.slow * self.expected


class Arrivals:
    """An `Arrivals` counts the messages of one input by the second in which they came, for the last minute of them."""

    def __init__(self) -> None:
        self._seconds, self._last = dict[int, int](), -math.inf

    def came(self, now: float) -> None:
        """Counts a message that came at `now` [s]."""
        self._last, second = now, int(now)
        self._seconds[second] = self._seconds.get(second, 0) + 1
        if len(self._seconds) > HEALTH.memory:
            del self._seconds[next(iter(self._seconds))]

    def rate(self, now: float) -> Rate | None:
        """Returns the usual rate and that at `now` [s]; None before the first message."""
        if not self._seconds:
            return None
        # The first second and the current one are not complete.
        counts = [count for second, count in islice(self._seconds.items(), 1, None) if second < int(now)]
        expected = float(median(counts or self._seconds.values()))
        seconds = math.ceil(HEALTH.missed / expected)
        recent = sum(self._seconds.get(int(now) - k, 0) for k in range(1, seconds + 1))
        measured = recent / seconds if len(counts) >= seconds else expected
        return Rate(expected, measured, now - self._last)


class Health:
    """A `Health` judges a live tracker and its input; all times are `time.monotonic`'s [s]."""

    def __init__(self, stream: ObservationStream, dropped: Counter[str]) -> None:
        """`dropped`: number of messages that were dropped because too many waited, by topic."""
        self.skipped = 0
        """Number of joint states that were skipped, as newer ones waited."""
        self._stream, self._dropped, self._refusals = stream, dropped, Counter[str]()
        self._inputs, self._answers = dict[str, Arrivals](), Arrivals()
        self._latencies, self._notes = deque[float](maxlen=500), deque[tuple[float, str]](maxlen=5)
        self._counted = deque((self._counts(-math.inf),))
        self._judged_at = self._published_at = -math.inf
        self._last: tuple[object, ...] = ()

    def noted(self, text: str) -> None:
        """Keeps the outcome of a user's request, for the next diagnostics."""
        self._notes.append((time.monotonic(), printable(text)))
        self._last = ()

    def refused(self, text: str) -> None:
        """Counts an observation that the tracker refused, by reason."""
        known = text in self._refusals or len(self._refusals) < HEALTH.max_notes
        self._refusals[text if known else "others"] += 1

    def came(self, topic: str, now: float) -> None:
        """Counts a message that could be read."""
        self._inputs.setdefault(topic, Arrivals()).came(now)

    def answered(self, now: float, seconds: float) -> None:
        """Counts an answer, and keeps how long its message took to be answered [s]."""
        self._answers.came(now)
        self._latencies.append(seconds)

    def trust(self, tracker: Tracker, now: float) -> tuple[int, State, str]:
        """Returns the level, state and reason of the pose, which also a tracker that hears nothing gets older."""
        answers = self._answers.rate(now)
        if answers is not None and answers.silent:
            what = f"no observation for {answers.silence:.1f} s"
            if answers.silence > tracker.settings.lost_after:
                return ERROR, "lost", what
            return STALE, tracker.state, f"{what}, before {tracker.reason or tracker.state}"
        level = {"tracking": OK, "uncertain": WARN, "lost": ERROR}[tracker.state]
        return level, tracker.state, tracker.reason

    def statuses(self, tracker: Tracker, now: float) -> list[Status]:
        """Returns two statuses, of the pose and of the input, where they are to be published now; else none.

        That is once a second, and as soon as one of them gets another level or the pose another state.
        """
        if now - self._judged_at < HEALTH.min_period:
            return []
        self._judged_at, trust = now, self.trust(tracker, now)
        level, sentences, rates = self._judged(now)
        judged = *trust[:2], level
        if judged == self._last and now - self._published_at < HEALTH.period:
            return []
        self._last, self._published_at = judged, now
        return [self._of_pose(tracker, *trust), self._of_input(tracker, level, sentences, rates)]

    def _counts(self, now: float) -> tuple[float, Report, Counter[str], Counter[str]]:
        """Returns all that was counted until now."""
        return now, self._stream.report.copied(), self._dropped.copy(), self._refusals.copy()

    def _judged(self, now: float) -> tuple[int, list[str], dict[str, Rate]]:
        """Returns the level of the input, a sentence for each fault, and the rates by topic."""
        if now - self._counted[-1][0] >= HEALTH.period:
            self._counted.append(self._counts(now))
            while now - self._counted[1][0] >= HEALTH.window:
                self._counted.popleft()
        (_, before, dropped, refused), report = self._counted[0], self._stream.report
        heard = {name: arrivals.rate(now) for name, arrivals in self._inputs.items()}
        rates = {name: rate for name, rate in heard.items() if rate and report.topics[name].role not in ONCE}
        silent = [name for name, rate in rates.items() if rate.silent]
        wrong = [] if report.joint_states in rates else [f"no joint states on {report.joint_states} so far"]
        for name in [*silent, *(name for name, rate in rates.items() if rate.slow and name not in silent)]:
            rate = rates[name]
            now_is = f"silent for {rate.silence:.1f} s" if rate.silent else f"{rate.measured:.3g} Hz"
            wrong.append(f"{name}: {now_is}, usually {rate.expected:.3g} Hz")
        lost, refused = self._dropped - dropped, self._refusals - refused
        wrong += [f"{n} messages on {name} dropped: too many came" for name, n in lost.items()]
        wrong += [f"{n} observations left out: {why}" for why, n in refused.items()]
        wrong += [*self._stream.lacks(), *report.since(before).sentences()]
        stale = any(report.topics[name].role not in OCCASIONAL for name in silent)
        return STALE if stale else WARN if wrong else OK, wrong, rates

    def _of_pose(self, tracker: Tracker, level: int, state: State, reason: str) -> Status:
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
        return Status("pose", level, reason or "tracking", values)

    def _of_input(self, tracker: Tracker, level: int, wrong: list[str], rates: dict[str, Rate]) -> Status:
        values: dict[str, object] = {
            "observations": self._stream.report.observations,
            "skipped as newer ones waited": self.skipped,
            "late": tracker.late,
            "dropped": self._dropped.total(),
        }
        for name, rate in rates.items():
            values[f"{name} [Hz], measured"] = f"{0.0 if rate.silent else rate.measured:.3g}"
            values[f"{name} [Hz], expected"] = f"{rate.expected:.3g}"
        topics = self._stream.report.topics.items()
        values |= {f"{name}, left out": topic.left_out for name, topic in topics if topic.left_out}
        if latencies := sorted(self._latencies):
            slow = latencies[int(0.99 * (len(latencies) - 1))]
            values["answered after [ms], median"] = f"{1e3 * median(latencies):.2f}"
            values["answered after [ms], 99 %"] = f"{1e3 * slow:.2f}"
        notes = [note for when, note in self._notes if time.monotonic() - when < HEALTH.window]
        sentences = [*notes, *wrong]
        values |= {f"said {k}": each for k, each in enumerate(sentences[: HEALTH.max_notes], start=1)}
        return Status("input", level, sentences[0] if sentences else "all is heard", values)
