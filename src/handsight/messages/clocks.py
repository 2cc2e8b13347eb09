"""One clock and one order for the measurements of all topics.

`Clocks` brings stamps to one clock. A `ReorderBuffer` sorts a recording's measurements in a window of 0.2 s, and a
`PromptBuffer` those of a live robot within 2 ms. This is the only place that decides whether a clock was set back: the
first measurement after that is marked (`Measurement.restarts`), and everything downstream relies on the mark.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Iterable
from statistics import median
from typing import NamedTuple

from handsight.messages.decode import Measurement
from handsight.messages.report import Report
from handsight.messages.topics import MessageRejected
from handsight.observation import MAX_JUMP


class ClockOptions(NamedTuple):
    """`ClockOptions` are the limits by which clocks are compared and stamps put in order."""

    comparison: float = 1.0  # clocks are compared for this long from the first joint states [s]
    other_clock: float = 0.5  # a topic whose offset differs by more has another clock [s]
    max_latency: float = 2.0  # but a camera's measurements may be this late [s]
    reorder_window: float = 0.2  # a recording's messages are sorted within this [s]
    max_wait: float = 0.002  # a live robot's joint states wait this long for wrenches and transforms [s]
    max_silence: float = 0.1  # but not for a topic that has been silent for longer [s]
    confirming: int = 3  # so many joint states in a row that are back mean that the clock was set back
    max_waiting: int = 50_000  # number of measurements that wait at most
    max_waiting_bytes: int = 1 << 28  # size of the measurements that wait at most [bytes]


CLOCKS = ClockOptions()


class Clocks:
    """A `Clocks` brings the stamps of all topics to the clock of the joint states, and reports the differences."""

    def __init__(self) -> None:
        self._known = set[str]()
        self._joint_offsets: deque[float] = deque(maxlen=15)
        self._joints_at = -float("inf")  # log time of the last joint states [s]
        self._waiting: deque[Measurement] | None = deque()
        self._waiting_bytes = 0
        self._first_joints: Measurement | None = None
        self.least = self.most = 0.0
        """The least and the largest difference of offset that was not corrected [s]."""

    def put(self, measurement: Measurement) -> Iterable[Measurement]:
        """Returns the measurements whose clock is now known, with stamps in the clock of the joint states.

        All wait until the first second of joint states is over, unless too many wait; after that, each measurement is
        returned at once.
        """
        if self._waiting is None:
            return (self._aligned(measurement),)
        self._waiting.append(measurement)
        self._waiting_bytes += measurement.size
        full = self._waiting_bytes > CLOCKS.max_waiting_bytes or len(self._waiting) > CLOCKS.max_waiting
        is_joints = measurement.topic.role == "joints"
        if self._first_joints is None and is_joints:
            self._first_joints = measurement
        if (first := self._first_joints) is None:
            if full:
                oldest = self._waiting.popleft()
                self._waiting_bytes -= oldest.size
                oldest.topic.stale += 1
            return ()
        over = measurement.log_time > first.log_time + CLOCKS.comparison
        over = over or (is_joints and measurement.stamp > first.stamp + CLOCKS.comparison)
        return self.finish() if full or over else ()

    def restart(self) -> None:
        """Forgets the offset of the joint states: their clock was set back, and later topics need the new offset."""
        self._joint_offsets.clear()

    def finish(self) -> list[Measurement]:
        """Compares the clocks by what has come, and returns all measurements that wait, as `put` does."""
        waiting, self._waiting = self._waiting or (), None
        topics = {each.topic.name: each.topic for each in waiting}
        for topic in sorted(topics.values(), key=lambda topic: topic.role != "joints"):
            self._compare([each for each in waiting if each.topic is topic])
        return [self._aligned(measurement) for measurement in waiting]

    def _aligned(self, measurement: Measurement) -> Measurement:
        """Returns the measurement with its stamp in the clock of the joint states."""
        topic = measurement.topic
        # A topic that begins later is compared with the latest joint states, not the first: a simulator's clock may
        # drift, and the clock of a recording that is played stops during a pause.
        paused, is_joints = measurement.log_time - self._joints_at > CLOCKS.comparison, topic.role == "joints"
        if paused and is_joints:
            self._joint_offsets.clear()
        if topic.name not in self._known and (is_joints or not paused):
            self._compare([measurement])
        if topic.unstamped:
            measurement.stamp = measurement.log_time
        elif is_joints:
            self._joint_offsets.append(measurement.log_time - measurement.stamp)
        if is_joints:
            self._joints_at = measurement.log_time
        measurement.stamp += topic.difference if topic.shifted else 0.0
        return measurement

    def _compare(self, first: list[Measurement]) -> None:
        """Sets `unstamped`, `difference` and `shifted` of a topic from its first messages."""
        topic = first[0].topic
        topic.unstamped = all(each.stamp == 0 for each in first)
        offset = 0.0 if topic.unstamped else median(each.log_time - each.stamp for each in first)
        if topic.role == "joints":
            self._joint_offsets.append(offset)
        self._known.add(topic.name)
        if not self._joint_offsets:
            return
        topic.difference = offset - median(self._joint_offsets)
        slow = topic.role in ("vision", "truth", "color", "depth", "detections", "mask")
        latest = CLOCKS.max_latency if slow else CLOCKS.other_clock
        topic.shifted = not -CLOCKS.other_clock <= topic.difference <= latest
        if not topic.shifted:
            self.least, self.most = min(self.least, topic.difference), max(self.most, topic.difference)


class ReorderBuffer:
    """A `ReorderBuffer` puts measurements on one clock and, within a window behind the newest joint states, in order.

    When the clock of the joint states is set back, it releases all measurements that wait, and the order begins again.
    """

    complete = -float("inf")
    """Joint states up to this stamp wait for no other message, so they become observations at once [s]."""
    now = -float("inf")
    """The time at which a live robot's message came, by `time.monotonic` [s]; to be set before `put` and `ready`."""

    def __init__(self, report: Report) -> None:
        self._report, self._clocks = report, Clocks()
        self._waiting: list[tuple[float, int, Measurement]] = []
        self._bytes, self._count = 0, itertools.count()
        self._newest = -float("inf")
        self._jumped: Measurement | None = None
        """Joint states whose stamp is far ahead, until the next ones confirm or refute it."""
        self._back: list[Measurement] = []
        """Measurements since the joint states went back, until it is confirmed that their clock was set back."""
        self._last_stamps: dict[tuple[str, tuple[str, ...]], float] = {}
        self._restart()

    def _restart(self) -> None:
        """Forgets the stamps that were released, as they are of the clock before it was set back."""
        self._released, self._restarted = -float("inf"), True
        self._last_stamps.clear()
        self._clocks.restart()

    @property
    def waits_until(self) -> float:
        """When the oldest waiting joint states will have waited enough, on the clock of `now`; infinite: none wait."""
        return float("inf")

    def put(self, measurement: Measurement) -> list[Measurement]:
        """Adds a measurement, and returns all whose order is now known, without those that are late or repeated."""
        return [each for aligned in self._clocks.put(measurement) for each in self._insert(aligned)]

    def ready(self) -> list[Measurement]:
        """Returns the measurements whose order is known by the time `now`, without another message."""
        return self._pop(self._edge())

    def finish(self) -> list[Measurement]:
        """Returns all measurements that wait; for when no more messages come, or none have come for long."""
        found = [each for aligned in self._clocks.finish() for each in self._insert(aligned)]
        waiting = self._back if self._jumped is None else [*self._back, self._jumped]
        self._back, self._jumped = [], None
        for each in waiting:
            self._push(each)
        return found + self._pop(float("inf"))

    def _insert(self, measurement: Measurement) -> list[Measurement]:
        """Adds a measurement that is in the clock of the joint states; returns those whose order is now known."""
        is_joints, found = measurement.topic.role == "joints", list[Measurement]()
        in_order, rejected = [measurement], None
        if measurement.stamp < self._newest - MAX_JUMP and (is_joints or self._back):
            self._back.append(measurement)
            joints = [each for each in self._back if each.topic.role == "joints"]
            if len(joints) < CLOCKS.confirming:
                return []
            # The clock was set back: release all that wait, and begin again with the measurements that are back.
            count, far, first = self._report.backwards or (0, 0.0, self._newest)
            self._report.backwards = count + 1, max(far, self._newest - joints[0].stamp), first
            rejected, self._jumped = self._jumped, None
            found = self._pop(float("inf"))
            self._restart()
            self._newest = max(each.stamp for each in joints)
            in_order, self._back = self._back, []
        elif is_joints:
            # Joint states that jump ahead are used only if the next ones agree; those back are late after all.
            jumped, self._jumped = self._jumped, None
            if self._newest > -float("inf") and measurement.stamp > self._newest + MAX_JUMP:
                if jumped is not None and abs(measurement.stamp - jumped.stamp) <= MAX_JUMP:
                    in_order, jumped = [jumped, measurement], None
                else:
                    in_order, self._jumped = [], measurement
            rejected = jumped
            self._newest = max([self._newest, *(each.stamp for each in in_order)])
            in_order, self._back = self._back + in_order, []
        if rejected is not None:
            rejected.topic.reject(MessageRejected("stamp far ahead of those before and after"))
        for each in in_order:
            self._push(each)
        return found + self.ready()

    def _edge(self) -> float:
        """Returns the stamp up to which the order is known [s]."""
        return self._newest - CLOCKS.reorder_window - (self._clocks.most - self._clocks.least)

    def _push(self, measurement: Measurement) -> None:
        """Keeps the measurement until it is in order, or counts it as late."""
        if measurement.stamp < max(self._released, self._edge()):
            measurement.topic.late += 1
        else:
            self._keep(measurement)

    def _keep(self, measurement: Measurement) -> None:
        heapq.heappush(self._waiting, (measurement.stamp, next(self._count), measurement))
        self._bytes += measurement.size

    def _pop(self, edge: float) -> list[Measurement]:
        """Returns the measurements up to the edge [s], and more if too many wait; of repeated ones, the first."""
        found, waiting = list[Measurement](), self._waiting
        most = CLOCKS.max_waiting_bytes
        while waiting and (waiting[0][0] <= edge or len(waiting) > CLOCKS.max_waiting or self._bytes > most):
            self._released, _, measurement = heapq.heappop(waiting)
            self._bytes -= measurement.size
            if measurement.topic.role != "tf":
                publisher = publisher_of(measurement)
                if self._last_stamps.get(publisher) == self._released:
                    measurement.topic.duplicated += 1
                    continue
                self._last_stamps[publisher] = self._released
            measurement.topic.use(self._released)
            measurement.restarts, self._restarted = self._restarted, False
            found.append(measurement)
        return found


class PromptBuffer(ReorderBuffer):
    """A `PromptBuffer` puts measurements in order within 2 ms; one that comes later is used if it is the newest.

    A joint state waits until each topic of wrenches, contacts or transforms that is due has reached its stamp. A topic
    is due if its last message is at most 0.1 s old and, by the interval between its last two, the next should have
    come. Images come late in any case: they are used with the next joint states. `now` must be set before `put` and
    `ready`.
    """

    def _restart(self) -> None:
        super()._restart()
        self.complete = -float("inf")
        # Joint states' stamps, and the time until which they wait [s].
        self._pending = deque[tuple[float, float]]()
        # By topic: the newest stamp, and half of the interval to the stamp before it [s].
        self._reached: dict[str, tuple[float, float]] = {}
        self._newest_of: dict[tuple[str, tuple[str, ...]], float] = {}

    @property
    def waits_until(self) -> float:
        return self._pending[0][1] if self._pending else float("inf")

    def finish(self) -> list[Measurement]:
        found = super().finish()
        if self._pending:
            self.complete = max(stamp for stamp, _ in self._pending)
            self._pending.clear()
        return found

    def _edge(self) -> float:
        while self._pending:
            (stamp, until), reached = self._pending[0], self._reached.values()
            due = (newest + half < stamp <= newest + CLOCKS.max_silence for newest, half in reached)
            if self.now < until and any(due):
                break
            self.complete = max(self.complete, stamp)
            self._pending.popleft()
        return self.complete

    def _push(self, measurement: Measurement) -> None:
        topic, stamp, key = measurement.topic, measurement.stamp, publisher_of(measurement)
        newest = self._newest_of.get(key, -float("inf"))
        if stamp < newest or (topic.role == "joints" and stamp < self.complete):
            topic.late += 1
            return
        self._newest_of[key] = stamp
        if topic.role == "joints":
            self._pending.append((stamp, self.now + CLOCKS.max_wait))
        elif topic.role in ("wrench", "contact", "tf"):
            before, half = self._reached.get(topic.name, (stamp, 0.0))
            self._reached[topic.name] = max(stamp, before), (stamp - before) / 2 if stamp > before else half
        self._keep(measurement)


def publisher_of(measurement: Measurement) -> tuple[str, tuple[str, ...]]:
    """Returns the topic, and names that identify the publisher: several nodes may publish joint states or /tf."""
    topic, value = measurement.topic, measurement.value
    if topic.role == "joints":
        return topic.name, tuple(value)
    return topic.name, value[:2] if topic.role == "tf" else (measurement.part,)
