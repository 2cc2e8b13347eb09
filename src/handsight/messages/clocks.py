"""When things were measured: one clock for all topics, and one order."""

import heapq
import itertools
from collections import deque
from collections.abc import Iterable
from statistics import median
from typing import NamedTuple

from handsight.messages.decode import Measurement
from handsight.messages.report import Report
from handsight.messages.topics import MessageRejected


class ClockOptions(NamedTuple):
    """`ClockOptions` say how stamps of several clocks are put in order."""

    comparison: float = 1.0  # how long clocks are compared, from the first joint states on [s]
    other_clock: float = 0.5  # offsets farther apart are another clock's [s]
    max_latency: float = 2.0  # but what a camera measured may be this late [s]
    reorder_window: float = 0.2  # of stamps, to put messages in order [s]
    max_jump: float = 1.0
    """Joint states that jump ahead by more must be confirmed by the next, and back by more by the next two [s]."""
    confirming: int = 3  # joint states in a row that are back and say that the clock is
    max_waiting: int = 50_000  # measurements that are kept
    max_waiting_bytes: int = 1 << 28  # bytes that are kept
    max_publishers: int = 1000  # publishers whose stamps are known


CLOCKS = ClockOptions()

SLOW = ("vision", "truth", "color", "depth")
FAR_AHEAD = "stamp far ahead of those before and after"


class Clocks:
    """`Clocks` know, by topic, what brings its stamps to the clock of the joint states; the differences are in the
    reports."""

    def __init__(self) -> None:
        self._known = set[str]()
        self._joint_offsets: deque[float] = deque(maxlen=15)
        self._joints_at = -float("inf")
        """When the last joint states came [s]."""
        self._waiting: deque[Measurement] | None = deque()
        self._waiting_bytes = 0
        self._first_joints: Measurement | None = None
        self.least = self.most = 0.0
        """Of the differences of offset that were left as they are [s]."""

    def put(self, measurement: Measurement) -> Iterable[Measurement]:
        """Returns those whose clock is known with this one, their stamps in the clock of the joint states.

        None before the first second of joint states is over, as far as memory reaches; then each at once.
        """
        if self._waiting is None:
            return (self._aligned(measurement),)
        self._waiting.append(measurement)
        self._waiting_bytes += measurement.size
        full = self._waiting_bytes > CLOCKS.max_waiting_bytes or len(self._waiting) > CLOCKS.max_waiting
        is_joints = measurement.topic.role == "joints"
        if self._first_joints is None and is_joints:
            self._first_joints = measurement
        first = self._first_joints
        if first is None:
            if full:
                oldest = self._waiting.popleft()
                self._waiting_bytes -= oldest.size
                oldest.topic.stale += 1
            return ()
        over = measurement.log_time > first.log_time + CLOCKS.comparison
        over = over or (is_joints and measurement.stamp > first.stamp + CLOCKS.comparison)
        return self.finish() if full or over else ()

    def restart(self) -> None:
        """Starts anew: the joint states' clock was set back: what begins from now on is compared with those from now
        on."""
        self._joint_offsets.clear()

    def finish(self) -> list[Measurement]:
        """Returns those that wait, as `put`: nothing more comes in the first second."""
        waiting, self._waiting = self._waiting or (), None
        topics = {each.topic.name: each.topic for each in waiting}
        for topic in sorted(topics.values(), key=lambda topic: topic.role != "joints"):
            self._learn([each for each in waiting if each.topic is topic])
        return [self._aligned(measurement) for measurement in waiting]

    def _aligned(self, measurement: Measurement) -> Measurement:
        topic = measurement.topic
        # What begins later is compared with the joint states of its own time: a simulator's clock may drift, and that
        # of a recording that is played stands still while it pauses.
        paused, is_joints = measurement.log_time - self._joints_at > CLOCKS.comparison, topic.role == "joints"
        if paused and is_joints:
            self._joint_offsets.clear()
        if topic.name not in self._known and (is_joints or not paused):
            self._learn([measurement])
        if topic.unstamped:
            measurement.stamp = measurement.log_time
        elif is_joints:
            self._joint_offsets.append(measurement.log_time - measurement.stamp)
        if is_joints:
            self._joints_at = measurement.log_time
        measurement.stamp += topic.difference if topic.shifted else 0.0
        return measurement

    def _learn(self, first: list[Measurement]) -> None:
        """Learns difference and shift of a topic from the first of it."""
        topic = first[0].topic
        topic.unstamped = all(each.stamp == 0 for each in first)
        offset = 0.0 if topic.unstamped else median(each.log_time - each.stamp for each in first)
        if topic.role == "joints":
            self._joint_offsets.append(offset)
        self._known.add(topic.name)
        if not self._joint_offsets:
            return
        topic.difference = offset - median(self._joint_offsets)
        latency = CLOCKS.max_latency if topic.role in SLOW else CLOCKS.other_clock
        topic.shifted = not -CLOCKS.other_clock <= topic.difference <= latency
        if not topic.shifted:
            self.least, self.most = min(self.least, topic.difference), max(self.most, topic.difference)


class ReorderBuffer:
    """A `ReorderBuffer` puts measurements on one clock, in order of stamp, through a window that the joint states
    move on.

    Where the joint states go back for good, all that waits is let go, and the order begins anew.
    """

    complete = -float("inf")
    """Nothing up to this stamp is waited for: joint states up to it are observations [s]."""

    def __init__(self, report: Report) -> None:
        self._report, self._clocks = report, Clocks()
        self._waiting: list[tuple[float, int, Measurement]] = []
        self._bytes, self._count = 0, itertools.count()
        self._newest, self._released = -float("inf"), -float("inf")
        self._jumped: Measurement | None = None
        self._back: list[Measurement] = []  # since joint states went back, as long as that is not confirmed
        self._last_stamps: dict[tuple[str, tuple[str, ...]], float] = {}

    def put(self, measurement: Measurement) -> list[Measurement]:
        """Returns those that are in order with this one, without the late and the duplicated; some have waited till
        now."""
        found = list[Measurement]()
        for aligned in self._clocks.put(measurement):
            found += self._insert(aligned)
        return found

    def ready(self) -> list[Measurement]:
        """Returns those that are in order by now, without another."""
        return self._pop(self._edge())

    def finish(self) -> list[Measurement]:
        """Returns those that wait: no more come, or none for long."""
        found = list[Measurement]()
        for aligned in self._clocks.finish():
            found += self._insert(aligned)
        for each in self._not_back() if self._jumped is None else (*self._not_back(), self._jumped):
            self._push(each)
        self._jumped = None
        return found + self._pop(float("inf"))

    def _insert(self, measurement: Measurement) -> list[Measurement]:
        """Returns those that are in order with this one, which is in the clock of the joint states."""
        is_joints, found = measurement.topic.role == "joints", list[Measurement]()
        if measurement.stamp < self._newest - CLOCKS.max_jump and (is_joints or self._back):
            self._back.append(measurement)
            if sum(each.topic.role == "joints" for each in self._back) < CLOCKS.confirming:
                return found
            found = self._restart()
        elif is_joints:
            for each in (*self._not_back(), *self._confirmed(measurement)):
                self._push(each)
        else:
            self._push(measurement)
        return found + self._pop(self._edge())

    def _not_back(self) -> list[Measurement]:
        """Returns what seemed to begin anew, and does not: it is late."""
        back, self._back = self._back, []
        return back

    def _restart(self) -> list[Measurement]:
        """Returns all that waits; then the order begins with what is back."""
        joints = [each for each in self._back if each.topic.role == "joints"]
        count, far, stamp = self._report.backwards or (0, 0.0, self._newest)
        self._report.backwards = count + 1, max(far, self._newest - joints[0].stamp), stamp
        if self._jumped is not None:
            self._jumped.topic.reject(MessageRejected(FAR_AHEAD))
            self._jumped = None
        found = self._pop(float("inf"))
        self._forget()
        self._newest = max(each.stamp for each in joints)
        for each in self._not_back():
            self._push(each)
        return found

    def _forget(self) -> None:
        """Forgets what is over: what was released is of an earlier time."""
        self._released = -float("inf")
        self._last_stamps.clear()
        self._clocks.restart()

    def _edge(self) -> float:
        """Returns the edge: stamps up to this are in order."""
        return self._newest - CLOCKS.reorder_window - (self._clocks.most - self._clocks.least)

    def _confirmed(self, joints: Measurement) -> tuple[Measurement, ...]:
        """Returns the joint states, but those that jump ahead only with the next ones that agree."""
        jumped, self._jumped = self._jumped, None
        ahead = self._newest > -float("inf") and joints.stamp > self._newest + CLOCKS.max_jump
        if jumped is not None:
            if ahead and abs(joints.stamp - jumped.stamp) <= CLOCKS.max_jump:
                self._newest = max(joints.stamp, jumped.stamp)
                return jumped, joints
            joints.topic.reject(MessageRejected(FAR_AHEAD))
        if ahead:
            self._jumped = joints
            return ()
        self._newest = max(self._newest, joints.stamp)
        return (joints,)

    def _push(self, measurement: Measurement) -> None:
        if measurement.stamp < max(self._released, self._edge()):
            measurement.topic.late += 1
            return
        self._keep(measurement)

    def _keep(self, measurement: Measurement) -> None:
        heapq.heappush(self._waiting, (measurement.stamp, next(self._count), measurement))
        self._bytes += measurement.size

    def _pop(self, edge: float) -> list[Measurement]:
        """Returns those with stamps up to the edge, and what memory does not hold; of duplicates the first."""
        found, waiting = list[Measurement](), self._waiting
        while waiting and (
            waiting[0][0] <= edge
            or len(waiting) > CLOCKS.max_waiting
            or self._bytes > CLOCKS.max_waiting_bytes
        ):
            self._released, _, measurement = heapq.heappop(waiting)
            self._bytes -= measurement.size
            if measurement.topic.role != "tf" and self._is_duplicate(measurement):
                measurement.topic.duplicated += 1
                continue
            measurement.topic.use(self._released)
            found.append(measurement)
        return found

    def _is_duplicate(self, measurement: Measurement) -> bool:
        """Returns whether its publisher's last is of the stamp that is released now; takes note of it."""
        publisher = publisher_of(measurement)
        if self._last_stamps.get(publisher) == self._released:
            return True
        if len(self._last_stamps) > CLOCKS.max_publishers:
            self._last_stamps.clear()
        self._last_stamps[publisher] = self._released
        return False


def publisher_of(measurement: Measurement) -> tuple[str, tuple[str, ...]]:
    """Returns what is told apart of one stamp: several may publish joint states or transforms, each its own names."""
    topic, value = measurement.topic, measurement.value
    if topic.role == "joints":
        return topic.name, tuple(value)
    return topic.name, value[:2] if topic.role == "tf" else ()
