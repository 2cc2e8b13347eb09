"""The tracker of a running robot: it decodes the messages that wait, assembles observations, tracks and answers."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial

import numpy as np

from handsight.correction import PosePrior
from handsight.errors import HandsightError, InvalidInput
from handsight.live.answers import Answer, Writer
from handsight.live.health import Health
from handsight.live.markers import markers_around, object_marker
from handsight.live.requests import REQUESTS, requested_model, requested_start, requested_text
from handsight.messages import ObservationStream, RawMessage
from handsight.messages.definitions import definitions_in
from handsight.messages.pair import PromptBuffer, ReorderBuffer
from handsight.messages.topics import OwnTopic, RosType
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import State, Tracker, TrackerSettings

MAX_FULFILLING = 60.0
"""A request that takes longer is not waited for [s]."""
QUIET_AFTER = 1.0
"""After this time without a message, all that wait are processed [s]."""
MARKER_PERIOD = 1 / 30
"""Time between markers [s]."""
OBJECT_PERIOD = 1.0
"""Time between markers of the object itself, which /tf moves [s]."""
FRAMES = slice(16, -56)
"""The bytes of the frames' names in a TFMessage of one transform: they are behind its stamp, and before its pose."""


class Inbox:
    """A bounded queue of messages; when it is full, the oldest are dropped and counted."""

    def __init__(self, max_waiting: int = 20_000, max_bytes: int = 1 << 28) -> None:
        self._max_waiting = max_waiting
        self._max_bytes = max_bytes
        self.dropped = Counter[str]()
        """Number of dropped messages by topic."""
        self._waiting = deque[tuple[float, RawMessage]]()
        self._bytes = 0
        self._filled = threading.Condition()

    def put(self, message: RawMessage, now: float) -> None:
        """Adds a message that came at `now`, by `time.monotonic`; from any thread."""
        with self._filled:
            self._waiting.append((now, message))
            self._bytes += len(message.data)
            while len(self._waiting) > self._max_waiting or self._bytes > self._max_bytes:
                _, oldest = self._waiting.popleft()
                self._bytes -= len(oldest.data)
                self.dropped[oldest.topic] += 1
            self._filled.notify()

    def wake(self) -> None:
        """Ends the wait of `take`."""
        with self._filled:
            self._filled.notify()

    def take(self, timeout: float) -> list[tuple[float, RawMessage]]:
        """Returns all messages, each after the time at which it came; waits at most `timeout` [s] for the first."""
        with self._filled:
            if not self._waiting and timeout > 0:
                self._filled.wait(timeout)
            taken = self._waiting
            self._waiting = deque()
            self._bytes = 0
        return list(taken)


class LiveTracker:
    """An object in a hand, tracked by the messages of a running robot."""

    publications: Mapping[str, str] = {
        OwnTopic.POSE: RosType.POSE_COVARIANCE,
        OwnTopic.TF: RosType.TF,
        OwnTopic.MARKERS: RosType.MARKERS,
        OwnTopic.DIAGNOSTICS: RosType.DIAGNOSTICS,
    }
    """The types of the answers, by topic."""

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        encoding: str,
        equal: bool = False,
        settings: TrackerSettings | None = None,
    ) -> None:
        """`encoding` of the answers: `cdr` (ROS 2, DDS) or `ros1`. `equal`: answer exactly as `handsight track` would.

        Raises InvalidInput, MissingExtra.
        """
        if encoding not in ("cdr", "ros1"):
            raise InvalidInput(f"encoding: expected cdr or ros1, got {encoding!r}")
        self.rig = rig
        self.settings = settings
        self.markers_wanted: Callable[[], bool] = lambda: False
        """Returns whether anybody subscribes to the markers; to be set by the transport."""
        self.show: Callable[[Tracker], None] = lambda _: None
        """Called with the tracker after each update, in the thread of `step`; such as a viewer's `update`."""
        self.equal = equal
        self._inbox = Inbox()
        self._tasks = deque[Callable[[], None]]()
        self._writer = Writer(encoding, rig.frames["palm"])
        self.tracker = Tracker(rig, model, settings=settings)
        """The tracker of the current object; only for the thread of `step`."""
        self._stream = ObservationStream(rig, order=ReorderBuffer if equal else PromptBuffer)
        self._came = time.monotonic()
        self._accepted = threading.BoundedSemaphore(2)
        self._fulfilling = threading.Lock()
        self.health = Health(self._stream, self._inbox.dropped)
        self._flushed = True
        self._markers_at = self._object_at = -math.inf
        # Its own transforms come back over transports that cannot tell them; they differ in stamp and pose.
        self._own_link = self._writer.transform(0.0, np.eye(4)).data[FRAMES]

    @property
    def subscriptions(self) -> Mapping[str, tuple[str, ...]]:
        """The types that messages may have, as ROS 2 writes them, by the topic to subscribe to."""
        topics = self._stream.topics.values()
        return {topic.name: topic.expected for topic in topics if topic.role != "truth"} | REQUESTS

    @property
    def any_defined(self) -> frozenset[str]:
        """Those of them on which messages of any other type are read too, if they come with its definition."""
        return frozenset(topic.name for topic in self._stream.topics.values() if topic.any_defined)

    @property
    def definitions(self) -> Mapping[str, str]:
        """By type, the definitions that the rig has of messages that are none of ROS' own."""
        return definitions_in(self.rig.topics.messages)

    @property
    def skipped(self) -> int:
        """Number of joint states that were skipped, as newer ones waited."""
        return self.health.skipped

    @property
    def trust(self) -> tuple[State, str]:
        """The tracker's state and reason; "lost" where nothing has come for `TrackerSettings.lost_after`."""
        return self.health.trust(self.tracker, time.monotonic())[1:]

    def put(self, message: RawMessage) -> None:
        """Adds a message, which waits for the next `step`, but not its own /tf; from any thread."""
        if message.topic in REQUESTS:
            self._request(message)
            return
        if message.topic != OwnTopic.TF or message.data[FRAMES] != self._own_link:
            self._inbox.put(message, time.monotonic())

    def _request(self, message: RawMessage) -> None:
        """Begins to fulfil a request, unless one is being fulfilled and another one waits already."""
        if not self._accepted.acquire(blocking=False):
            self._note(f"{message.topic}: refused, as two earlier requests are not done yet")
            return
        # An object may take seconds to build, and the transport's thread must not wait for it.
        threading.Thread(target=self._fulfil, args=(message,), daemon=True).start()

    def _fulfil(self, message: RawMessage) -> None:
        """Fulfils a user's request; the diagnostics report the outcome."""
        expected = REQUESTS[message.topic]
        try:
            with self._fulfilling:
                if message.type not in expected:
                    raise InvalidInput(f"expected a {expected[0]}, got {message.type}")
                if message.topic == OwnTopic.RESET:
                    done = self.reset()
                elif message.topic == OwnTopic.OBJECT:
                    done = self.set_object(requested_text(message))
                else:
                    done = self.start(message)
                # A flood of requests would else begin as many tracks, one after the other, in one step.
                done.result(MAX_FULFILLING)
        except (HandsightError, TimeoutError) as error:
            self._note(f"{message.topic}: {str(error) or 'not done in time'}")
        finally:
            self._accepted.release()

    def _note(self, text: str) -> None:
        """Says something in the diagnostics; from any thread."""
        self.health.noted(text, time.monotonic())

    def published(self, topic: str, kind: str) -> None:
        """Notes the type `package/msg/Name` of a topic on the network, as a transport may pass on expected ones only.

        From any thread; may be repeated.
        """
        self._tasks.append(partial(self._stream.declare, topic, kind))

    def publishers(self, topic: str, count: int) -> None:
        """Notes how many publish on a topic; more than it has parts are told. From any thread; may be repeated."""
        report = self._stream.report.topics.get(topic)
        if report is not None:
            report.publishers = count

    def reset(self) -> "Future[str]":
        """Starts a new track from the next pose of vision; the future's result is a sentence. From any thread."""
        return self._start(None, None, "begun anew: vision's next pose starts")

    def set_object(self, name: str) -> "Future[str]":
        """Starts a track of another object, named as `find_model` takes it; from any thread.

        Raises a HandsightError for an unknown object; then the current track goes on.
        """
        model = requested_model(name, self.rig)
        return self._start(model, None, f"the object is {name}: vision's next pose starts")

    def start(self, message: RawMessage) -> "Future[str]":
        """Starts a new track from a user's pose: a PoseWithCovarianceStamped in the palm, the world or the camera.

        From any thread. Raises InvalidInput.
        """
        start = requested_start(message, self.rig, self.tracker.T_world_palm)
        return self._start(None, start, "begun anew from the user's pose")

    def step(self, timeout: float = 0.1) -> list[Answer]:
        """Returns the messages to publish now; waits at most `timeout` [s] for something to do. For one thread only."""
        order = self._stream.order
        arrived = self._inbox.take(max(0.0, min(timeout, order.waits_until - time.monotonic())))
        for _ in range(len(self._tasks)):  # others may be added meanwhile
            self._tasks.popleft()()
        observations = self._heard(arrived)
        if not self.equal and len(observations) > 1:
            # The newest is answered, and all with a camera's pose or depth image.
            by_depth = self.rig.topics.depth is not None
            (*older, newest) = observations
            kept = [o for o in older if o.vision is not None or (o.depth is not None and by_depth)]
            self.health.skipped += len(older) - len(kept)
            observations = [*kept, newest]
        answers = list[Answer]()
        for observation in observations:
            joints_came = order.arrived(observation.stamp)
            found = self._answers(observation)
            if found:
                now = time.monotonic()
                self.health.answered(now, now - (self._came if joints_came is None else joints_came))
            answers += found
        if statuses := self.health.statuses(self.tracker, time.monotonic()):
            answers.append(self._writer.diagnostics(statuses))
        return answers

    def _heard(self, arrived: list[tuple[float, RawMessage]]) -> list[Observation]:
        """Returns the observations that are complete with the messages that have arrived, or have waited enough."""
        observations = list[Observation]()
        order = self._stream.order
        for came, message in arrived:
            order.now = came
            report = self._stream.report.topics.get(message.topic)
            readable = 0 if report is None else report.readable
            observations += self._stream.put(message)
            report = self._stream.report.topics.get(message.topic)
            if report is not None and report.readable > readable:
                self.health.came(report.topic, came)
        rig = self._stream.calibrated(self.rig)
        if rig is not self.rig:
            self.rig = rig
            self._follow(self.tracker.model, None)
        order.now = now = time.monotonic()
        if order.waits_until <= now:
            observations += self._stream.ready()
        if arrived:
            self._came = arrived[-1][0]
            self._flushed = False
        elif not self._flushed and now - self._came >= QUIET_AFTER:
            observations += self._stream.flush()
            self._flushed = True
        return observations

    def _start(self, model: ObjectModel | None, start: PosePrior | None, message: str) -> "Future[str]":
        """Starts a new track in the next `step`; the future's result is the message."""
        done = Future[str]()

        def begin() -> None:
            """Starts the track, and says so in the future."""
            try:
                self._follow(model or self.tracker.model, start)
            except HandsightError as error:
                done.set_exception(error)
            else:
                self._note(message)
                done.set_result(message)

        self._tasks.append(begin)
        self._inbox.wake()
        return done

    def _follow(self, model: ObjectModel, start: PosePrior | None) -> None:
        """Replaces the tracker by a new one, which starts with the joint offsets that the last one has estimated."""
        offsets = self.tracker.joint_offsets
        self.tracker.close()
        self.tracker = Tracker(self.rig, model, start=start, settings=self.settings, joint_offsets=offsets)
        self._object_at = -math.inf

    def _answers(self, observation: Observation) -> list[Answer]:
        """Returns the answers to an observation: pose, transform, and markers if somebody subscribes to them."""
        tracker = self.tracker
        try:
            estimate = tracker.update(observation)
        except HandsightError as error:
            self._note(f"observation left out: {error}")
            return []
        self.show(tracker)
        if estimate is None or tracker.stamp != observation.stamp:
            return []
        answers = [self._writer.pose(tracker.stamp, estimate)]
        if tracker.state != "lost":
            answers.append(self._writer.transform(tracker.stamp, estimate.T_palm_object))
        now = time.monotonic()
        if now - self._markers_at >= MARKER_PERIOD and self.markers_wanted():
            self._markers_at = now
            markers = [*markers_around(tracker, self._writer.palm)]
            if now - self._object_at >= OBJECT_PERIOD:
                self._object_at = now
                markers.append(object_marker(tracker.stamp, tracker.model))
            answers.append(self._writer.answer(OwnTopic.MARKERS, RosType.MARKERS, markers=markers))
        return answers
