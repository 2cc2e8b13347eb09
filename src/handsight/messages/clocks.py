"""When things were measured: one clock for all topics, and one order."""

import heapq
import itertools
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from statistics import median

from handsight.messages.decode import Event
from handsight.messages.report import TopicReport

LEARNING = 1.0
"""Of the recording, from its first joint states on, that clocks are compared over [s]."""
OTHER_CLOCK = 0.5
"""Offsets farther apart are another clock [s]."""
LONGEST_LATENCY = 2.0
"""But what a camera saw may be this late [s]."""
SLOW = ("vision", "truth", "color", "depth")
WINDOW = 0.2
"""Of stamps, to put messages in order [s]."""
JUMP = 1.0
"""Joint states that jump ahead by more must be confirmed by the next, and back by more are told [s]."""
MOST_WAITING = 50_000
"""Events."""
MOST_PUBLISHERS = 1000
LARGEST_WAITING = 1 << 28
"""Bytes of events."""

Topics = dict[str, TopicReport]


class Clocks:
    """By topic, what brings its stamps to the clock of the joint states."""

    def __init__(self, topics: Topics) -> None:
        """Offsets are written into the topics' reports."""
        self._topics = topics
        self._shifts: dict[str, float] = {}
        self._joints: deque[float] = deque(maxlen=15)
        self.least = 0.0
        """Difference of offset that was left as it is, the least [s]."""
        self.most = 0.0
        """The most [s]."""

    def aligned(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events with their stamps in the clock of the joint states."""
        stream = iter(events)
        begun = self._beginning(stream)
        by_topic: dict[str, list[Event]] = {}
        for event in sorted(begun, key=lambda event: event.channel.role != "joints"):
            by_topic.setdefault(event.channel.topic, []).append(event)
        for first in by_topic.values():
            self._learn(first)
        for event in itertools.chain(begun, stream):
            topic, role = event.channel.topic, event.channel.role
            # What begins later is compared with the joint states of its own time: a simulator's clock may drift.
            if topic not in self._shifts:
                self._learn([event])
            if self._topics[topic].unstamped:
                event.stamp = event.log
            elif role == "joints":
                self._joints.append(event.log - event.stamp)
            event.stamp += self._shifts[topic]
            yield event

    def _beginning(self, stream: Iterator[Event]) -> deque[Event]:
        """Events up to a second after the first joint states, as far as memory reaches."""
        begun, size, joints = deque[Event](), 0, None
        for event in stream:
            begun.append(event)
            size += event.size
            if joints is None and event.channel.role == "joints":
                joints = event
            if joints is not None and (
                event.log > joints.log + LEARNING
                or (event.channel.role == "joints" and event.stamp > joints.stamp + LEARNING)
            ):
                break
            if size > LARGEST_WAITING or len(begun) > MOST_WAITING:
                if joints is not None:
                    break
                oldest = begun.popleft()
                size -= oldest.size
                self._topics[oldest.channel.topic].stale += 1
        return begun

    def _learn(self, first: list[Event]) -> None:
        """Offset and shift of a topic from the first of it."""
        channel = first[0].channel
        report = self._topics[channel.topic]
        report.unstamped = all(event.stamp == 0 for event in first)
        report.offset = 0.0 if report.unstamped else median(event.log - event.stamp for event in first)
        if channel.role == "joints":
            self._joints.append(report.offset)
        self._shifts[channel.topic] = 0.0
        if not self._joints:
            return
        report.difference = report.offset - median(self._joints)
        latency = LONGEST_LATENCY if channel.role in SLOW else OTHER_CLOCK
        if -OTHER_CLOCK <= report.difference <= latency:
            self.least, self.most = min(self.least, report.difference), max(self.most, report.difference)
        else:
            report.shifted = True
            self._shifts[channel.topic] = report.difference


class Order:
    """Events in order of stamp, through a window that the joint states move on."""

    def __init__(self, topics: Topics, clocks: Clocks) -> None:
        """What is left out is counted in the topics' reports."""
        self._topics, self._clocks = topics, clocks
        self._waiting: list[tuple[float, int, Event]] = []
        self._size, self._count = 0, itertools.count()
        self._newest, self._released = -float("inf"), -float("inf")
        self._jumped: Event | None = None
        self._taken: dict[object, float] = {}
        self.backwards: tuple[int, float, float] | None = None
        """As in the Report."""

    def ordered(self, events: Iterable[Event]) -> Iterator[Event]:
        """The events in order of stamp, without the late and the duplicated."""
        for event in events:
            for settled in self._settled(event) if event.channel.role == "joints" else (event,):
                self._push(settled)
            while self._waiting and (
                self._waiting[0][0] <= self._edge()
                or len(self._waiting) > MOST_WAITING
                or self._size > LARGEST_WAITING
            ):
                first = self._pop()
                if first is not None:
                    yield first
        if self._jumped is not None:
            self._push(self._jumped)
        while self._waiting:
            first = self._pop()
            if first is not None:
                yield first

    def _edge(self) -> float:
        """Stamps up to this are in order."""
        return self._newest - WINDOW - (self._clocks.most - self._clocks.least)

    def _settled(self, event: Event) -> Sequence[Event]:
        """The joint states, but those that jump ahead only with the next ones that agree."""
        report, jumped = self._topics[event.channel.topic], self._jumped
        ahead = self._newest > -float("inf") and event.stamp > self._newest + JUMP
        if jumped is not None:
            self._jumped = None
            if ahead and abs(event.stamp - jumped.stamp) <= JUMP:
                self._newest = max(event.stamp, jumped.stamp)
                return jumped, event
            report.refuse("stamp far ahead of those before and after")
        if ahead:
            self._jumped = event
            return ()
        if event.stamp < self._newest - JUMP:
            count, far, stamp = self.backwards or (0, 0.0, self._newest)
            self.backwards = (count + 1, max(far, self._newest - event.stamp), stamp)
        self._newest = max(self._newest, event.stamp)
        return (event,)

    def _push(self, event: Event) -> None:
        if event.stamp < self._released or event.stamp < self._edge():
            self._topics[event.channel.topic].late += 1
            return
        heapq.heappush(self._waiting, (event.stamp, next(self._count), event))
        self._size += event.size

    def _pop(self) -> Event | None:
        """The event with the earliest stamp; None: it is a duplicate."""
        stamp, _, event = heapq.heappop(self._waiting)
        self._size -= event.size
        self._released = stamp
        topic, role = event.channel.topic, event.channel.role
        report = self._topics[topic]
        # Several may publish transforms, or joint states, with one stamp: each its own names.
        if role != "tf":
            same = (topic, tuple(event.value)) if role == "joints" else topic
            if self._taken.get(same) == stamp:
                report.duplicated += 1
                return None
            if len(self._taken) > MOST_PUBLISHERS:
                self._taken.clear()
            self._taken[same] = stamp
        report.use(stamp)
        return event
