"""When things were measured: one clock for all topics, and one order."""

import heapq
import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from statistics import median

from handsight.messages.decode import Measurement
from handsight.messages.report import MessageRejected, Report

COMPARED = 1.0
"""From the first joint states on, clocks are compared over [s]."""
OTHER_CLOCK = 0.5
"""Offsets farther apart are another clock [s]."""
MAX_LATENCY = 2.0
"""But what a camera measured may be this late [s]."""
SLOW = ("vision", "truth", "color", "depth")
REORDER_WINDOW = 0.2
"""Of stamps, to put messages in order [s]."""
MAX_JUMP = 1.0
"""Joint states that jump ahead by more must be confirmed by the next, and back by more are told [s]."""
MAX_WAITING = 50_000
"""Measurements."""
MAX_WAITING_BYTES = 1 << 28
MAX_PUBLISHERS = 1000


class Clocks:
    """By topic, what brings its stamps to the clock of the joint states."""

    def __init__(self) -> None:
        """Offsets are written into the topics' reports."""
        self._shifts: dict[str, float] = {}
        self._joint_offsets: deque[float] = deque(maxlen=15)
        self._begun: deque[Measurement] | None = deque()
        self._begun_bytes = 0
        self._first_joints: Measurement | None = None
        self.least = 0.0
        """Difference of offset that was left as it is, the least [s]."""
        self.most = 0.0
        """The most [s]."""

    def put(self, measurement: Measurement) -> Iterable[Measurement]:
        """Those whose clock is known with this one, their stamps in the clock of the joint states.

        None before the first second of joint states is over, as far as memory reaches; then each at once.
        """
        if self._begun is None:
            return (self._aligned(measurement),)
        self._begun.append(measurement)
        self._begun_bytes += measurement.size
        is_joints = measurement.channel.role == "joints"
        if self._first_joints is None and is_joints:
            self._first_joints = measurement
        first = self._first_joints
        full = self._begun_bytes > MAX_WAITING_BYTES or len(self._begun) > MAX_WAITING
        if first is None:
            if full:
                oldest = self._begun.popleft()
                self._begun_bytes -= oldest.size
                oldest.report.stale += 1
            return ()
        late = measurement.log_time > first.log_time + COMPARED
        return (
            self.finish()
            if full or late or (is_joints and measurement.stamp > first.stamp + COMPARED)
            else ()
        )

    def finish(self) -> list[Measurement]:
        """Those that wait, as `put`: nothing more comes in the first second."""
        begun, self._begun = self._begun or (), None
        by_topic: dict[str, list[Measurement]] = {}
        for measurement in sorted(begun, key=lambda each: each.channel.role != "joints"):
            by_topic.setdefault(measurement.channel.topic, []).append(measurement)
        for first in by_topic.values():
            self._learn(first)
        return [self._aligned(measurement) for measurement in begun]

    def _aligned(self, measurement: Measurement) -> Measurement:
        topic = measurement.channel.topic
        # What begins later is compared with the joint states of its own time: a simulator's clock may drift.
        if topic not in self._shifts:
            self._learn([measurement])
        if measurement.report.unstamped:
            measurement.stamp = measurement.log_time
        elif measurement.channel.role == "joints":
            self._joint_offsets.append(measurement.log_time - measurement.stamp)
        measurement.stamp += self._shifts[topic]
        return measurement

    def _learn(self, first: list[Measurement]) -> None:
        """Offset and shift of a topic from the first of it."""
        channel, report = first[0].channel, first[0].report
        report.unstamped = all(each.stamp == 0 for each in first)
        report.offset = 0.0 if report.unstamped else median(each.log_time - each.stamp for each in first)
        if channel.role == "joints":
            self._joint_offsets.append(report.offset)
        self._shifts[channel.topic] = 0.0
        if not self._joint_offsets:
            return
        report.difference = report.offset - median(self._joint_offsets)
        latency = MAX_LATENCY if channel.role in SLOW else OTHER_CLOCK
        if -OTHER_CLOCK <= report.difference <= latency:
            self.least, self.most = min(self.least, report.difference), max(self.most, report.difference)
        else:
            report.shifted = True
            self._shifts[channel.topic] = report.difference


class ReorderBuffer:
    """Measurements in order of stamp, through a window that the joint states move on."""

    def __init__(self, report: Report, clocks: Clocks) -> None:
        """What is left out is counted in the report."""
        self._report, self._clocks = report, clocks
        self._waiting: list[tuple[float, int, Measurement]] = []
        self._bytes, self._count = 0, itertools.count()
        self._newest, self._released = -float("inf"), -float("inf")
        self._jumped: Measurement | None = None
        self._last_stamps: dict[object, float] = {}

    def put(self, measurement: Measurement) -> Iterator[Measurement]:
        """Those that are in order with this one, without the late and the duplicated."""
        for each in self._confirmed(measurement) if measurement.channel.role == "joints" else (measurement,):
            self._push(each)
        while self._waiting and (
            self._waiting[0][0] <= self._edge()
            or len(self._waiting) > MAX_WAITING
            or self._bytes > MAX_WAITING_BYTES
        ):
            yield from self._pop()

    def finish(self) -> Iterator[Measurement]:
        """Those that wait."""
        if self._jumped is not None:
            self._push(self._jumped)
        while self._waiting:
            yield from self._pop()

    def _edge(self) -> float:
        """Stamps up to this are in order."""
        return self._newest - REORDER_WINDOW - (self._clocks.most - self._clocks.least)

    def _confirmed(self, joints: Measurement) -> tuple[Measurement, ...]:
        """The joint states, but those that jump ahead only with the next ones that agree."""
        jumped, self._jumped = self._jumped, None
        ahead = self._newest > -float("inf") and joints.stamp > self._newest + MAX_JUMP
        if jumped is not None:
            if ahead and abs(joints.stamp - jumped.stamp) <= MAX_JUMP:
                self._newest = max(joints.stamp, jumped.stamp)
                return jumped, joints
            joints.report.reject(MessageRejected("stamp far ahead of those before and after"))
        if ahead:
            self._jumped = joints
            return ()
        if joints.stamp < self._newest - MAX_JUMP:
            count, far, stamp = self._report.backwards or (0, 0.0, self._newest)
            self._report.backwards = (count + 1, max(far, self._newest - joints.stamp), stamp)
        self._newest = max(self._newest, joints.stamp)
        return (joints,)

    def _push(self, measurement: Measurement) -> None:
        if measurement.stamp < max(self._released, self._edge()):
            measurement.report.late += 1
            return
        heapq.heappush(self._waiting, (measurement.stamp, next(self._count), measurement))
        self._bytes += measurement.size

    def _pop(self) -> Iterator[Measurement]:
        """The one with the earliest stamp, unless it is a duplicate."""
        self._released, _, measurement = heapq.heappop(self._waiting)
        self._bytes -= measurement.size
        topic, role = measurement.channel.topic, measurement.channel.role
        # Several may publish transforms, or joint states, with one stamp: each its own names.
        if role != "tf":
            publisher = (topic, tuple(measurement.value)) if role == "joints" else topic
            if self._last_stamps.get(publisher) == self._released:
                measurement.report.duplicated += 1
                return
            if len(self._last_stamps) > MAX_PUBLISHERS:
                self._last_stamps.clear()
            self._last_stamps[publisher] = self._released
        measurement.report.use(self._released)
        yield measurement
