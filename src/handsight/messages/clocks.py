"""One clock and one order for the measurements of all topics.

`Clocks` brings stamps to one clock. A `ReorderBuffer` sorts a recording's measurements in a window of 0.2 s, and a
`PromptBuffer` those of a live robot within 2 ms. This is the only place that decides whether a clock was set back: the
first measurement after that is marked (`Measurement.restarts`), and everything downstream relies on the mark.
"""

import heapq
import itertools
from collections import deque
from collections.abc import Iterable
from math import inf
from statistics import median

from handsight.messages.decode import Measurement
from handsight.messages.report import Report
from handsight.observation import MAX_JUMP

COMPARISON = 1.0
"""Clocks are compared for this long from the first joint states [s]."""
OTHER_CLOCK = 0.5
"""A topic whose offset differs by more has another clock [s]."""
MAX_LATENCY = 2.0
"""But a camera's measurements may be this late [s]."""
SLOW = "vision", "truth", "color", "depth", "detections", "mask"
"""Roles of a camera's topics."""
REORDER_WINDOW = 0.2
"""A recording's messages are sorted within this [s]."""
MAX_WAIT = 0.002
"""A live robot's joint states wait this long for wrenches and transforms [s]."""
MAX_SILENCE = 0.1
"""But not for a topic that has been silent for longer [s]."""
MAX_WAITING = 50_000
"""Number of measurements that wait at most."""
MAX_WAITING_BYTES = 1 << 28
"""Size of the measurements that wait at most [bytes]."""


class Clocks:
    """The clock of the joint states, to which the stamps of all topics are brought; differences are reported."""

    def __init__(self) -> None:
        self._known = set[str]()
        self.joint_offsets: deque[float] = deque(maxlen=15)
        self._joints_at = -inf  # log time of the last joint states [s]
        self.least = self.most = 0.0
        """The least and the largest difference of offset that was not corrected [s]."""

    def compare(self, first: Iterable[Measurement]) -> None:
        """Compares the clocks of all topics by their first messages."""
        by_topic = dict[str, list[Measurement]]()
        for each in first:
            by_topic.setdefault(each.topic.name, []).append(each)
        for of_topic in sorted(by_topic.values(), key=lambda of_topic: of_topic[0].topic.role != "joints"):
            self._compare(of_topic)

    def aligned(self, measurement: Measurement) -> Measurement:
        """Returns the measurement with its stamp in the clock of the joint states."""
        topic = measurement.topic
        is_joints = topic.role == "joints"
        # A topic that begins later is compared with the latest joint states, not the first: a simulator's clock may
        # drift, and the clock of a recording that is played stops during a pause.
        paused = measurement.log_time - self._joints_at > COMPARISON
        if paused and is_joints:
            self.joint_offsets.clear()
        if topic.name not in self._known and (is_joints or not paused):
            self._compare([measurement])
        if topic.unstamped:
            measurement.stamp = measurement.log_time
        elif is_joints:
            self.joint_offsets.append(measurement.log_time - measurement.stamp)
        if is_joints:
            self._joints_at = measurement.log_time
        if topic.shifted:
            measurement.stamp += topic.difference
        return measurement

    def _compare(self, first: list[Measurement]) -> None:
        """Sets `unstamped`, `difference` and `shifted` of a topic from its first messages."""
        topic = first[0].topic
        topic.unstamped = all(each.stamp == 0 for each in first)
        offset = 0.0 if topic.unstamped else median(each.log_time - each.stamp for each in first)
        if topic.role == "joints":
            self.joint_offsets.append(offset)
        self._known.add(topic.name)
        if not self.joint_offsets:
            return
        topic.difference = offset - median(self.joint_offsets)
        latest = MAX_LATENCY if topic.role in SLOW else OTHER_CLOCK
        topic.shifted = not -OTHER_CLOCK <= topic.difference <= latest
        if not topic.shifted:
            self.least = min(self.least, topic.difference)
            self.most = max(self.most, topic.difference)


class ReorderBuffer:
    """Measurements on one clock and, within a window behind the newest joint states, in order.

    When the clock of the joint states is set back, all that wait are released, and the order begins again.
    """

    complete = -inf
    """Joint states up to this stamp wait for no other message, so they become observations at once [s]."""
    now = -inf
    """The time at which a live robot's message came, by `time.monotonic` [s]; to be set before `put` and `ready`."""
    waits_until = inf
    """When the oldest waiting joint states will have waited enough, on the clock of `now`; infinite: none wait."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._clocks = Clocks()
        # What has come in the first second of joint states, by which the clocks are compared; None: that is over.
        self._first: deque[Measurement] | None = deque()
        self._begun: Measurement | None = None  # the first joint states
        self._waiting: list[tuple[float, int, Measurement]] = []
        self._bytes = 0
        self._count = itertools.count()
        self._newest = -inf
        # Joint states whose stamp jumped, and what came after them, until the next joint states confirm or refute it.
        self._held: list[Measurement] = []
        # By topic and part: several nodes may publish joint states or /tf.
        self._last_stamps = dict[tuple[str, str], float]()
        self._restart()

    def _restart(self) -> None:
        """Forgets the stamps that were released, as they are of the clock before it was set back."""
        self._released = -inf
        self._restarted = True
        self._last_stamps.clear()
        self._clocks.joint_offsets.clear()  # topics that come later need the new offset

    def arrived(self, stamp: float) -> float | None:
        """Returns when the joint states of that stamp came, on the clock of `now`, once; None: it is not known."""
        return None

    def put(self, measurement: Measurement) -> list[Measurement]:
        """Adds a measurement, and returns all whose order is now known, without those that are late or repeated.

        All wait until the first second of joint states is over, unless too many wait.
        """
        if self._first is None:
            return self._insert(self._clocks.aligned(measurement))
        self._first.append(measurement)
        self._bytes += measurement.size
        full = self._bytes > MAX_WAITING_BYTES or len(self._first) > MAX_WAITING
        is_joints = measurement.role == "joints"
        if self._begun is None and is_joints:
            self._begun = measurement
        begun = self._begun
        if begun is not None:
            over = measurement.log_time > begun.log_time + COMPARISON
            over = over or (is_joints and measurement.stamp > begun.stamp + COMPARISON)
            return self._compared() if full or over else []
        if full:
            oldest = self._first.popleft()
            self._bytes -= oldest.size
            oldest.topic.stale += 1
        return []

    def _compared(self) -> list[Measurement]:
        """Compares the clocks, if they are not yet; returns the measurements whose order is known then."""
        if self._first is None:
            return []
        first = self._first
        self._first = None
        self._bytes = 0
        self._clocks.compare(first)
        return [done for each in first for done in self._insert(self._clocks.aligned(each))]

    def ready(self) -> list[Measurement]:
        """Returns the measurements whose order is known by the time `now`, without another message."""
        return self._pop(self._edge())

    def finish(self) -> list[Measurement]:
        """Returns all measurements that wait; for when no more messages come, or none have come for long."""
        found = self._compared()
        held = self._held
        self._held = []
        for each in held:
            self._push(each)
        return found + self._pop(inf)

    def _insert(self, measurement: Measurement) -> list[Measurement]:
        """Adds a measurement that is in the clock of the joint states; returns those whose order is now known."""
        found = list[Measurement]()
        if measurement.role == "joints":
            if self._held:
                found = self._judged(measurement.stamp)
            first = self._newest == -inf
            if not first and abs(measurement.stamp - self._newest) > MAX_JUMP:
                self._held = [measurement]
                return found + self.ready()
            self._newest = max(self._newest, measurement.stamp)
        elif self._held:
            self._held.append(measurement)
            return found
        self._push(measurement)
        return found + self.ready()

    def _judged(self, stamp: float) -> list[Measurement]:
        """Uses the joint states whose stamp jumped if the next stamp [s] agrees with it, else rejects them.

        Returns all that waited before, where the clock was set back.
        """
        found = list[Measurement]()
        (jumped, *after), self._held = self._held, []
        newest = self._newest
        if abs(stamp - jumped.stamp) >= abs(stamp - newest):
            jumped.topic.reject("stamp far from those before and after", nan=False)
        else:
            if jumped.stamp < newest:
                found = self._set_back(jumped.stamp)
            self._push(jumped)
            newest = jumped.stamp
        for each in after:
            self._push(each)
        self._newest = newest
        return found

    def _set_back(self, stamp: float) -> list[Measurement]:
        """Begins the order again with a clock that was set back to a stamp [s]; returns all that waited before."""
        count, far, first = self._report.backwards or (0, 0.0, self._newest)
        self._report.backwards = count + 1, max(far, self._newest - stamp), first
        found = self._pop(inf)
        self._restart()
        self._newest = -inf
        return found

    def _edge(self) -> float:
        """Returns the stamp up to which the order is known [s]."""
        return self._newest - REORDER_WINDOW - (self._clocks.most - self._clocks.least)

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
        found = list[Measurement]()
        waiting = self._waiting
        while waiting:
            full = len(waiting) > MAX_WAITING or self._bytes > MAX_WAITING_BYTES
            if waiting[0][0] > edge and not full:
                break
            self._released, _, measurement = heapq.heappop(waiting)
            self._bytes -= measurement.size
            if measurement.topic.role != "tf":
                publisher = measurement.topic.name, measurement.part
                if self._last_stamps.get(publisher) == self._released:
                    measurement.topic.duplicated += 1
                    continue
                self._last_stamps[publisher] = self._released
            measurement.topic.use(self._released)
            measurement.restarts = self._restarted
            self._restarted = False
            found.append(measurement)
        return found


class PromptBuffer(ReorderBuffer):
    """Measurements in order within 2 ms; one that comes later is used if it is the newest.

    A joint state waits until each topic of wrenches, contacts or transforms that is due has reached its stamp. A topic
    is due if its last message is at most 0.1 s old and, by the interval between its last two, the next should have
    come. Images come late in any case: they are used with the next joint states. `now` must be set before `put` and
    `ready`.
    """

    def _restart(self) -> None:
        super()._restart()
        self.complete = -inf
        # When joint states came that were not asked for, by stamp; those beyond `complete` wait [s].
        self._came: dict[float, float] = {}
        # By topic: the newest stamp, and half of the interval to the stamp before it [s].
        self._reached: dict[str, tuple[float, float]] = {}
        self._newest_of = dict[tuple[str, str], float]()

    def arrived(self, stamp: float) -> float | None:
        came = self._came.get(stamp)
        self._came = {later: at for later, at in self._came.items() if later > stamp}
        return came

    @property
    def waits_until(self) -> float:  # type: ignore[override]
        waiting = (came for stamp, came in self._came.items() if stamp > self.complete)
        return next(waiting, inf) + MAX_WAIT

    def finish(self) -> list[Measurement]:
        found = super().finish()
        self.complete = max(self._came, default=self.complete)
        return found

    def _edge(self) -> float:
        for stamp, came in self._came.items():
            reached = self._reached.values()
            due = (newest + half < stamp <= newest + MAX_SILENCE for newest, half in reached)
            if stamp > self.complete and self.now < came + MAX_WAIT and any(due):
                break
            self.complete = max(self.complete, stamp)
        return self.complete

    def _push(self, measurement: Measurement) -> None:
        topic = measurement.topic
        stamp = measurement.stamp
        publisher = topic.name, measurement.part
        newest = self._newest_of.get(publisher, -inf)
        if stamp < newest or (measurement.role == "joints" and stamp < self.complete):
            topic.late += 1
            return
        self._newest_of[publisher] = stamp
        if measurement.role == "joints":
            self._came.setdefault(stamp, self.now)
        elif topic.role in ("wrench", "contact", "tf"):
            before, half = self._reached.get(topic.name, (stamp, 0.0))
            if stamp > before:
                half = (stamp - before) / 2
            self._reached[topic.name] = max(stamp, before), half
        self._keep(measurement)
