"""The tracker of a running robot: it decodes the messages that wait, assembles observations, tracks and answers."""

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import NamedTuple

from handsight.correction import PosePrior
from handsight.errors import HandsightError, InvalidInput
from handsight.live.answers import Answer, Writer
from handsight.live.health import Health
from handsight.live.markers import Markers
from handsight.live.requests import REQUESTS, requested_model, requested_start, requested_text
from handsight.messages import ObservationStream, RawMessage
from handsight.messages.clocks import PromptBuffer, ReorderBuffer
from handsight.messages.topics import OwnTopic, RosType, rig_topics
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import State, Tracker, TrackerSettings


class LiveOptions(NamedTuple):
    """`LiveOptions` are the periods of a live tracker, and how much it remembers."""

    quiet: float = 1.0  # after this time without a message, all that wait are processed [s]
    marker_period: float = 1 / 30  # between markers [s]
    object_period: float = 1.0  # between markers of the object itself, which /tf moves [s]
    own_transforms: int = 200  # the last ones of its own that it knows again


LIVE = LiveOptions()


class Inbox:
    """An `Inbox` is a bounded queue of messages; when it is full, the oldest are dropped and counted."""

    def __init__(self, max_waiting: int = 20_000, max_bytes: int = 1 << 28) -> None:
        self._max_waiting, self._max_bytes = max_waiting, max_bytes
        self.dropped = Counter[str]()
        """Number of dropped messages by topic."""
        self._waiting, self._bytes = deque[tuple[float, RawMessage]](), 0
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
            taken, self._waiting, self._bytes = self._waiting, deque(), 0
        return list(taken)


class LiveTracker:
    """A `LiveTracker` tracks an object in a hand by the messages of a running robot."""

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
        self.rig, self.settings = rig, settings
        self.markers_wanted: Callable[[], bool] = lambda: False
        """Returns whether anybody subscribes to the markers; to be set by the transport."""
        self.show: Callable[[Observation, Tracker], None] = lambda *_: None
        """Called with each observation after its update, in the thread of `step`; such as a viewer's `update`."""
        self.equal, self._inbox, self._tasks = equal, Inbox(), deque[Callable[[], None]]()
        self._writer = Writer(encoding, rig.frames["palm"])
        self._markers = Markers(self._writer)
        self.tracker = Tracker(rig, model, settings=settings)
        """The tracker of the current object; only for the thread of `step`."""
        self._stream = ObservationStream(rig, order=ReorderBuffer if equal else PromptBuffer)
        self._came = time.monotonic()
        self.health = Health(self._stream, self._inbox.dropped)
        self._flushed = True
        self._markers_at = self._object_at = -math.inf
        # The last ones, as not every transport can distinguish them; a dictionary, as another thread asks.
        self._own_transforms = dict[bytes, None]()

    @property
    def subscriptions(self) -> Mapping[str, tuple[str, ...]]:
        """The types that messages may have, as ROS 2 writes them, by the topic to subscribe to."""
        topics = rig_topics(self.rig).values()
        return {topic.name: topic.expected for topic in topics if topic.role != "truth"} | REQUESTS

    @property
    def any_defined(self) -> frozenset[str]:
        """Those of them on which messages of any other type are read too, if they come with its definition."""
        return frozenset(topic.name for topic in rig_topics(self.rig).values() if topic.any_defined)

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
            # An object may take seconds to build, and the transport's thread must not wait for it.
            threading.Thread(target=self._fulfil, args=(message,), daemon=True).start()
            return
        if message.topic != OwnTopic.TF or message.data not in self._own_transforms:
            self._inbox.put(message, time.monotonic())

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
        order, now = self._stream.order, time.monotonic()
        arrived = self._inbox.take(max(0.0, min(timeout, order.waits_until - now)))
        while self._tasks:
            self._tasks.popleft()()
        observations = list[Observation]()
        for came, message in arrived:
            order.now, topic = came, self._stream.topics.get(message.topic)
            readable = 0 if topic is None else topic.readable
            observations += self._stream.put(message)
            if topic is not None and topic.readable > readable:
                self.health.came(topic.name, came)
        if (rig := self._stream.calibrated(self.rig)) is not self.rig:
            self.rig = rig
            self._follow(self.tracker.model, None)
        order.now = now = time.monotonic()
        if order.waits_until <= now:
            observations += self._stream.ready()
        if arrived:
            self._came, self._flushed = arrived[-1][0], False
        elif not self._flushed and now - self._came >= LIVE.quiet:
            observations += self._stream.flush()
            self._flushed = True
        if not self.equal and len(observations) > 1:
            # The newest is answered, and all with a camera's pose or depth image.
            by_depth, (*older, newest) = self.rig.topics.depth is not None, observations
            kept = [o for o in older if o.vision is not None or (o.depth is not None and by_depth)]
            self.health.skipped += len(older) - len(kept)
            observations = [*kept, newest]
        answers = [answer for each in observations for answer in self._answers(each)]
        if answers:
            self.health.answered(now := time.monotonic(), now - self._came)
        if statuses := self.health.statuses(self.tracker, time.monotonic()):
            answers.append(self._writer.diagnostics(statuses))
        return answers

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
                self.health.noted(message)
                done.set_result(message)

        self._tasks.append(begin)
        self._inbox.wake()
        return done

    def _follow(self, model: ObjectModel, start: PosePrior | None) -> None:
        """Replaces the tracker by a new one, which starts with the joint offsets that the last one has estimated."""
        offsets = self.tracker.joint_offsets
        self.tracker = Tracker(self.rig, model, start=start, settings=self.settings, joint_offsets=offsets)
        self._object_at = -math.inf

    def _fulfil(self, message: RawMessage) -> None:
        """Fulfils a user's request; the diagnostics report the outcome."""
        try:
            if message.type not in REQUESTS[message.topic]:
                raise InvalidInput(f"expected a {REQUESTS[message.topic][0]}, got {message.type}")
            if message.topic == OwnTopic.RESET:
                self.reset()
            elif message.topic == OwnTopic.OBJECT:
                self.set_object(requested_text(message))
            else:
                self.start(message)
        except HandsightError as error:
            self.health.noted(f"{message.topic}: {error}")

    def _answers(self, observation: Observation) -> list[Answer]:
        """Returns the answers to an observation: pose, transform, and markers if somebody subscribes to them."""
        tracker, late = self.tracker, self.tracker.late
        try:
            estimate = tracker.update(observation)
        except HandsightError as error:
            self.health.refused(str(error))
            return []
        self.show(observation, tracker)
        if estimate is None or tracker.late > late:
            return []
        answers = [self._writer.pose(tracker.stamp, estimate)]
        if tracker.state != "lost":
            answers.append(self._writer.transform(tracker.stamp, estimate.T_palm_object))
            self._own_transforms[answers[-1].data] = None
            if len(self._own_transforms) > LIVE.own_transforms:
                del self._own_transforms[next(iter(self._own_transforms))]
        now = time.monotonic()
        if now - self._markers_at >= LIVE.marker_period and self.markers_wanted():
            self._markers_at = now
            if now - self._object_at >= LIVE.object_period:
                self._object_at = now
                answers.append(self._markers.object(tracker.stamp, tracker.model))
            answers.append(self._markers.around(tracker))
        return answers
