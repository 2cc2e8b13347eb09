"""A tracker's answers as serialised messages: pose, transform, and diagnostics of its state and its input."""

import time
from collections import Counter, deque
from statistics import median
from typing import Any, NamedTuple

from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.errors import printable
from handsight.messages import ObservationStream
from handsight.messages.decode import typestore
from handsight.messages.encode import Message, header, pose_with_covariance, transform
from handsight.messages.topics import OwnTopic, RosType
from handsight.tracking import Tracker

OBJECT_FRAME = "object"
"""The object's frame id in /tf; its parent is the palm's."""


class Answer(NamedTuple):
    """An `Answer` is a message to be published."""

    topic: str
    type: str
    """As ROS 2 writes it: `package/msg/Name`."""
    data: bytes


class Writer:
    """A `Writer` serialises messages in one encoding, `cdr` or `ros1`."""

    def __init__(self, encoding: str, palm: str) -> None:
        """`palm`: the palm's frame id. Raises MissingExtra."""
        store = typestore(encoding)
        self._serialize = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
        self.palm = palm

    def answer(self, topic: str, kind: str, **fields: Any) -> Answer:
        """Returns a serialised message with that topic, type and fields."""
        return Answer(topic, kind, bytes(self._serialize(Message(**fields), kind)))

    def pose(self, stamp: float, estimate: PoseEstimate) -> Answer:
        """Returns a PoseWithCovarianceStamped in the palm; unobservable directions have a variance of 1 or more."""
        body = pose_with_covariance(estimate.T_palm_object, estimate.bounded_covariance)
        return self.answer(OwnTopic.POSE, RosType.POSE_COVARIANCE, header=header(stamp, self.palm), pose=body)

    def transform(self, stamp: float, T_palm_object: Array) -> Answer:
        """Returns the transform from the palm to the object, on /tf."""
        link = transform(T_palm_object, stamp, self.palm, OBJECT_FRAME)
        return self.answer(OwnTopic.TF, RosType.TF, transforms=[link])


class HealthOptions(NamedTuple):
    """`HealthOptions` bound how often diagnostics are published, and how much they hold."""

    period: float = 1.0  # between two messages while nothing changes [s]
    min_period: float = 0.1  # between two messages if the state changes quickly [s]
    max_notes: int = 20  # number of sentences in a message, and of different reasons for refusals
    note_duration: float = 10.0  # how long the outcome of a request is published [s]


HEALTH = HealthOptions()
OK, WARN, ERROR = 0, 1, 2
"""The severity of a status, as diagnostic_msgs defines it."""


class Health:
    """A `Health` collects what the diagnostics report, once a second and when the state changes."""

    def __init__(self, dropped: Counter[str]) -> None:
        """`dropped`: number of messages that were dropped because too many waited, by topic."""
        self.skipped = 0
        """Number of joint states that were skipped, as newer ones waited."""
        self._dropped, self._refusals = dropped, Counter[str]()
        self._latencies = deque[float](maxlen=500)
        self._last_state: tuple[str, str] = ("", "")
        self._published_at, self._notes = -HEALTH.period, deque[tuple[float, str]](maxlen=5)

    def noted(self, text: str) -> None:
        """Keeps the outcome of a user's request, for the next diagnostics."""
        self._notes.append((time.monotonic(), printable(text)))
        self._last_state = ("", "")

    def refused(self, text: str) -> None:
        """Counts an observation that the tracker refused, by reason."""
        known = text in self._refusals or len(self._refusals) < HEALTH.max_notes
        self._refusals[text if known else "others"] += 1

    def answered(self, seconds: float) -> None:
        """Keeps how long a message took to be answered [s]."""
        self._latencies.append(seconds)

    def due(self, tracker: Tracker) -> bool:
        """Returns whether to publish diagnostics now; if so, the next are due a second later."""
        now, passed = time.monotonic(), time.monotonic() - self._published_at
        state = tracker.state, tracker.reason if tracker.state == "lost" else ""
        if passed < (HEALTH.min_period if state[0] != self._last_state[0] else HEALTH.period):
            return False
        self._published_at, self._last_state = now, state
        return True

    def diagnostics(self, tracker: Tracker, stream: ObservationStream, writer: Writer) -> Answer:
        """Returns a DiagnosticArray with two statuses, of the pose and of the input."""
        estimate = tracker.estimate
        of_pose: dict[str, object] = {
            "state": tracker.state,
            "object": tracker.model.name,
            "touching": ", ".join(tracker.fingertips.fingers) or "nothing",
            "position known to [mm]": f"{1e3 * tracker.sigma:.1f}",
            "open directions": "" if estimate is None else len(estimate.unobservable),
            "corrections": tracker.corrections,
        }
        of_pose |= {f"no contact of {name}": why for name, why in tracker.fingertips.reasons.items()}
        of_pose |= {f"no force of {name}": "not measured" for name in tracker.slip.unmeasured}
        levels = {"tracking": OK, "uncertain": WARN, "lost": ERROR}
        notes = [note for when, note in self._notes if time.monotonic() - when < HEALTH.note_duration]
        wrong = [f"{n} messages on {topic} dropped: too many came" for topic, n in self._dropped.items()]
        wrong += [f"{count} observations left out: {why}" for why, count in self._refusals.items()]
        wrong += [*stream.lacks(), *stream.report.sentences()]
        if not stream.report.observations:
            wrong.insert(0, f"no joint states on {stream.report.joint_states} so far")
        of_input: dict[str, object] = {
            "observations": stream.report.observations,
            "skipped as newer ones waited": self.skipped,
            "late": tracker.late,
            "dropped": self._dropped.total(),
        }
        if latencies := sorted(self._latencies):
            slow = latencies[int(0.99 * (len(latencies) - 1))]
            of_input["answered after [ms], median"] = f"{1e3 * median(latencies):.2f}"
            of_input["answered after [ms], 99 %"] = f"{1e3 * slow:.2f}"
        sentences = [*notes, *wrong]
        of_input |= {f"said {k}": each for k, each in enumerate(sentences[: HEALTH.max_notes], start=1)}
        first = sentences[0] if sentences else "all is heard"
        body = [
            Message(
                level=level,
                name=f"handsight: {name}",
                message=text,
                hardware_id="",
                values=[Message(key=key, value=str(value)) for key, value in values.items()],
            )
            for name, level, text, values in (
                ("pose", levels[tracker.state], tracker.reason or "tracking", of_pose),
                ("input", WARN if wrong else OK, first, of_input),
            )
        ]
        return writer.answer(
            OwnTopic.DIAGNOSTICS, RosType.DIAGNOSTICS, header=header(time.time()), status=body
        )
