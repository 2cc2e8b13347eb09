"""The worker of a running robot: what waits is decoded, assembled, followed and answered."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from typing import NamedTuple

from handsight.correction import PosePrior
from handsight.errors import HandsightError, InvalidInput
from handsight.live.answers import (
    DIAGNOSTICS,
    DIAGNOSTICS_TOPIC,
    MARKERS,
    MARKERS_TOPIC,
    POSE_TOPIC,
    Answer,
    Writer,
    pose_numbers,
)
from handsight.live.health import Health
from handsight.live.inbox import Inbox
from handsight.live.markers import Markers
from handsight.live.requests import ASKED, asked_start, asked_text, model_named
from handsight.messages import ObservationStream, RawMessage
from handsight.messages.clocks import ReorderBuffer
from handsight.messages.decode import rosbags_module
from handsight.messages.prompt import PromptBuffer
from handsight.messages.topics import POSE_COVARIANCE, TF, rig_topics
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import Tracker, TrackerSettings


class LiveOptions(NamedTuple):
    """`LiveOptions` say how often a live tracker publishes."""

    quiet: float = 1.0  # after so long without a message, what waits is processed [s]
    marker_period: float = 1 / 30  # between markers [s]
    object_period: float = 1.0  # between markers of the object itself, which /tf moves [s]


LIVE = LiveOptions()


class LiveTracker:
    """A `LiveTracker` is one object in one hand, followed as a robot speaks of them."""

    def __init__(
        self,
        rig: Rig,
        model: ObjectModel,
        *,
        encoding: str,
        equal: bool = False,
        settings: TrackerSettings | None = None,
    ) -> None:
        """`encoding` of what is answered: `cdr` (ROS 2, DDS) or `ros1`. `equal`: answer as a recording would be.

        Raises InvalidInput, MissingExtra.
        """
        if encoding not in ("cdr", "ros1"):
            raise InvalidInput(f"encoding: expected cdr or ros1, got {encoding!r}")
        rosbags_module("rosbags.typesys")
        self.rig, self.settings = rig, settings
        self.markers_wanted: Callable[[], bool] = lambda: False
        """Whether anybody looks at markers."""
        self.show: Callable[[Observation, Tracker], None] = lambda *_: None
        """Is told each observation that the tracker has taken, in the thread of `step`: a viewer's `update`."""
        self.equal, self._inbox, self._tasks = equal, Inbox(), deque[Callable[[], None]]()
        self._writer = Writer(encoding, rig.frames["palm"])
        self._markers = Markers(self._writer, rig.frames["palm"])
        self.tracker = Tracker(rig, model, settings=settings)
        """Of the object that is followed now; read it from the thread of `step`."""
        self._order = ReorderBuffer if equal else PromptBuffer
        self._waits_until = math.inf
        self._stream = self._listening()
        self.health = Health(self._stream, self._inbox.dropped)
        self._heard = self._came = time.monotonic()
        self._flushed = True
        self._markers_at = self._object_at = -math.inf

    @property
    def subscriptions(self) -> Mapping[str, tuple[str, ...]]:
        """By topic to subscribe to: the types that it may have, as ROS 2 writes them."""
        heard = {
            topic.name: topic.expected for topic in rig_topics(self.rig).values() if topic.role != "truth"
        }
        return heard | ASKED

    @property
    def publications(self) -> Mapping[str, str]:
        """By topic that is answered on: its type."""
        return {
            POSE_TOPIC: POSE_COVARIANCE,
            "/tf": TF,
            MARKERS_TOPIC: MARKERS,
            DIAGNOSTICS_TOPIC: DIAGNOSTICS,
        }

    @property
    def skipped(self) -> int:
        """Joint states that were passed over, as newer ones waited."""
        return self.health.skipped

    def put(self, message: RawMessage) -> None:
        """Takes in a message, from any thread; it only waits here."""
        if message.topic in ASKED:
            # An object may take seconds to make, which no transport's thread should wait for.
            threading.Thread(target=self._ask, args=(message,), daemon=True).start()
            return
        self._inbox.put(message, time.monotonic())

    def reset(self) -> "Future[str]":
        """Begins anew, from what vision sees next; the future's result is a sentence. From any thread."""
        return self._begin(None, None, "begun anew: vision's next pose starts")

    def set_object(self, name: str) -> "Future[str]":
        """Begins anew with another object, by the rig's name for it, the library's, or a mesh file; from any thread.

        Raises a HandsightError where there is none, and what was followed goes on.
        """
        return self._begin(
            model_named(name, self.rig), None, f"the object is {name}: vision's next pose starts"
        )

    def start(self, message: RawMessage) -> "Future[str]":
        """Begins anew from a user's pose, PoseWithCovarianceStamped in the palm, world or camera; from any thread.

        Raises InvalidInput.
        """
        start = asked_start(message, self.rig, self.tracker.T_world_palm)
        return self._begin(None, start, "begun anew from the user's pose")

    def step(self, timeout: float = 0.1) -> list[Answer]:
        """Returns what is to be published now; waits at most `timeout` [s] for something to do. From one thread."""
        arrived = self._inbox.take(max(0.0, min(timeout, self._waits_until - time.monotonic())))
        while self._tasks:
            self._tasks.popleft()()
        observations = list[Observation]()
        order = self._stream.order
        for came, message in arrived:
            if isinstance(order, PromptBuffer):
                order.now = came
            observations += self._stream.put(message)
        self._see_camera()
        if isinstance(order, PromptBuffer):
            order.now = time.monotonic()
            if order.waits_until <= order.now:
                observations += self._stream.ready()
        observations += self._flush(bool(arrived))
        self._waits_until = order.waits_until if isinstance(order, PromptBuffer) else math.inf
        answers = list[Answer]()
        for observation in self._newest(observations):
            answers += self._followed(observation)
        if arrived:
            self._came = arrived[-1][0]
        if answers:
            self.health.answered(time.monotonic() - self._came)
        if self.health.due(self.tracker):
            answers.append(
                self._writer.diagnostics(time.time(), self.health.statuses(self.tracker, self._stream))
            )
        return answers

    def _listening(self) -> ObservationStream:
        return ObservationStream(self.rig, order=self._order)

    def _begin(self, model: ObjectModel | None, start: PosePrior | None, reason: str) -> "Future[str]":
        done = Future[str]()

        def begin() -> None:
            """Done by the worker, between two observations."""
            try:
                self._follow(model or self.tracker.model, start)
            except HandsightError as error:
                done.set_exception(error)
            else:
                self.health.noted(reason)
                done.set_result(reason)

        self._tasks.append(begin)
        self._inbox.wake()
        return done

    def _follow(self, model: ObjectModel, start: PosePrior | None) -> None:
        """Starts a new tracker, which knows of the joints what the last one has learnt."""
        self.tracker = Tracker(
            self.rig, model, start=start, settings=self.settings, joint_offsets=self.tracker.joint_offsets
        )
        self._object_at = -math.inf

    def _ask(self, message: RawMessage) -> None:
        """Does what a message asks for, and says in the diagnostics what came of it."""
        try:
            if message.type not in ASKED[message.topic]:
                raise InvalidInput(f"expected a {ASKED[message.topic][0]}, got {message.type}")
            if message.topic.endswith("/reset"):
                self.reset()
            elif message.topic.endswith("/object"):
                self.set_object(asked_text(message))
            else:
                self.start(message)
        except HandsightError as error:
            self.health.noted(f"{message.topic}: {error}")

    def _see_camera(self) -> None:
        """Takes the camera's intrinsics from the first CameraInfo, where the rig has none and looks at depth images."""
        camera, info, topics = self.rig.camera, self._stream.intrinsics, self.rig.topics
        if camera is None or info is None or camera.intrinsics is not None or topics.depth is None:
            return
        self.rig = replace(self.rig, camera=camera.with_images_of(info))
        self._follow(self.tracker.model, None)

    def _flush(self, arrived: bool) -> list[Observation]:
        """Returns what waits although nothing comes any more."""
        now = time.monotonic()
        if arrived:
            self._heard, self._flushed = now, False
        if self._flushed or now - self._heard < LIVE.quiet:
            return []
        self._flushed = True
        return self._stream.flush()

    def _newest(self, observations: list[Observation]) -> list[Observation]:
        """Returns those that are answered: the newest, and all that the camera has something to say in."""
        if self.equal or len(observations) < 2:
            return observations
        kept = [
            skipped_one
            for skipped_one in observations[:-1]
            if skipped_one.vision is not None
            or (skipped_one.depth is not None and self.rig.topics.depth is not None)
        ]
        self.health.skipped += len(observations) - 1 - len(kept)
        return [*kept, observations[-1]]

    def _followed(self, observation: Observation) -> list[Answer]:
        tracker = self.tracker
        late = tracker.late
        try:
            estimate = tracker.update(observation)
        except HandsightError as error:
            self.health.refused(str(error))
            return []
        self.show(observation, tracker)
        if estimate is None or tracker.late > late:
            return []
        numbers = pose_numbers(estimate.T_palm_object)
        answers = [self._writer.pose(tracker.stamp, estimate, numbers)]
        if tracker.state != "lost":
            answers.append(self._writer.transform(tracker.stamp, numbers))
        return answers + self._drawn(tracker)

    def _drawn(self, tracker: Tracker) -> list[Answer]:
        now, answers = time.monotonic(), list[Answer]()
        if now - self._markers_at < LIVE.marker_period or not self.markers_wanted():
            return answers
        self._markers_at = now
        if now - self._object_at >= LIVE.object_period:
            self._object_at = now
            answers.append(self._markers.object(tracker.stamp, tracker.model))
        return [*answers, self._markers.around(tracker)]
