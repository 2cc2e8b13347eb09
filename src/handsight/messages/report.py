"""What came on the topics of a rig, what is wrong with it, and what is missing: a table, and its sentences."""

from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import NamedTuple, Protocol

from handsight.checks import nearest_name
from handsight.errors import printable
from handsight.messages.topics import RosType, Topic
from handsight.rig import Rig
from handsight.rig.coupled_joints import CoupledJoints
from handsight.rig.units import Units

MOST = 12
"""Sentences of one kind that are said."""
MAX_GAP = 0.1
"""A longer time between two joint states is counted as a gap [s]."""
MAX_DIFFERENCE = 0.1
"""A topic whose stamps are further off the clock of the joint states is told [s]."""
MAX_PARTS = 100
"""Parts of messages that are kept for a topic; bounded, as a broken publisher may make up new names."""
MAX_REASONS = 8
"""Reasons that are kept for a topic; bounded, as one may quote its message."""


class Fault(NamedTuple):
    """A row of the report: something that is wrong, and how often."""

    about: str
    """What its sentence begins with: a topic, a finger, a surface or a file, and `: `."""
    what: str
    number: int | None = None
    """How often; None: it is not counted."""
    total: int | None = None
    """Of how many; None: there is no such number."""
    detail: str = ""
    """What else is known of it now, while `about` and `what` stay the same."""

    @property
    def sentence(self) -> str:
        """The row for a person."""
        number = "" if self.number is None else f"{self.number} "
        total = "" if self.total is None else f"of {self.total} "
        return printable(f"{self.about}{number}{total}{self.what}{self.detail}")


@dataclass(slots=True)
class TopicReport:
    """Counts of the messages of one topic, or of the transforms of /tf.

    Once no message waits any more, `messages` is the sum of the counts from `used` to `stuck`. A message about several
    fingers or tactile surfaces counts once for each.
    """

    topic: Topic
    type: str = ""
    messages: int = 0
    used: int = 0
    """Used in order of stamp; if several come between two joint states, the observation has the newest."""
    duplicated: int = 0  # left out, as an earlier message of the same publisher had the same stamp
    nan: int = 0  # left out, as they have NaN or infinity
    late: int = 0  # left out, as they came too late to be put in order of stamp
    bad: int = 0  # left out, as they cannot be used as one of the expected types
    stale: int = (
        0  # left out, as they were too old when the next joint states came, or waited too long for them
    )
    stuck: int = 0  # left out, as their sensor is stuck or at full scale
    reasons: Counter[str] = field(default_factory=Counter)
    """Number of `nan`, `bad` and `stuck` messages, by reason."""
    last: float | None = None  # stamp of the last used message, in the clock of the joint states [s]
    gap: float = 0.0  # longest time between two used messages [s]
    gaps: int = 0  # number of times between two used messages above `MAX_GAP`
    unstamped: int = 0  # number of messages without a stamp, which are timed by when they were logged
    parts: set[str] = field(default_factory=set)
    """The fingers, surfaces or lists of joints in its messages; not the frames of /tf."""
    publishers: int = 0  # how many nodes publish on it, as far as a live robot's transport knows
    differences: deque[float] = field(default_factory=lambda: deque(maxlen=15))
    """Log time minus stamp of the last messages, minus the same of the joint states before each [s]."""

    @property
    def difference(self) -> float:
        """How far the topic's stamps are behind the clock of the joint states, by its last messages [s]."""
        return median(self.differences) if self.differences else 0.0

    @property
    def readable(self) -> int:
        """Number of messages that could be read, and whose numbers are finite."""
        return self.messages - self.nan - self.bad

    @property
    def left_out(self) -> int:
        """Number of messages that were left out, for whatever reason."""
        return self.duplicated + self.nan + self.late + self.bad + self.stale + self.stuck

    def reject(self, reason: str, *, nan: bool = False) -> None:
        """Counts a message as `nan` or `bad`, with its reason."""
        self.nan += nan
        self.bad += not nan
        self._leave_out(reason)

    def take_back(self, reason: str) -> None:
        """Counts a message that was used as `stuck`, with its reason."""
        self.used -= 1
        self.stuck += 1
        self._leave_out(reason)

    def _leave_out(self, reason: str) -> None:
        if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
            reason = "other reasons"
        self.reasons[reason] += 1

    def found(self, part: str) -> None:
        """Notes a part of a message."""
        if self.topic.role != "tf" and len(self.parts) < MAX_PARTS:
            self.parts.add(part)

    def use(self, stamp: float) -> None:
        """Counts a message of that stamp [s] as used; stamps must come in order."""
        self.used += 1
        if self.last is not None:
            gap = stamp - self.last
            self.gap = max(self.gap, gap)
            self.gaps += gap > MAX_GAP
        self.last = stamp

    def table(self) -> Iterator[Fault]:
        """Yields a row for each kind of fault."""
        name = f"{self.topic.name}: "
        kinds = [(f"messages left out: {reason}", count) for reason, count in self.reasons.items()]
        kinds.append(("messages came twice with one stamp and were used once", self.duplicated))
        kinds.append(("messages came too late to be put in order of stamp and were left out", self.late))
        kinds.append(("messages were too old when the next joint states came and were left out", self.stale))
        if not self.type.startswith("std_msgs/"):  # which have no place for a stamp
            kinds.append(("messages without a stamp, timed by when they were recorded", self.unstamped))
        for what, count in kinds:
            if count:
                yield Fault(name, what, count, self.messages)
        if self.gaps and self.topic.role == "joints":
            longest = f", the longest {self.gap:.3f} s"
            yield Fault(name, f"gaps of more than {MAX_GAP} s", self.gaps, detail=longest)
        if self.publishers > len(self.parts) > 0:
            yield Fault(name, f"{self.publishers} nodes publish the same: two hands on one topic?")
        off = self.difference
        if abs(off) > MAX_DIFFERENCE:
            offset = f"topics.offsets: {{{self.topic.name}: {self.topic.offset + off:.3f}}}"
            remedy = f"{off:+.3f} s off the joint states' clock; if it has another one, set {offset}"
            yield Fault(name, "stamps ", detail=remedy)


class RecordedFile(Protocol):
    """A file of a recording, as far as it is reported."""

    path: Path
    faults: list[str]
    """What could not be read until now, in words."""


@dataclass(slots=True)
class Report:
    """What has come on the topics of a rig, and what is wrong with it."""

    joint_states: str  # the topic whose stamps are the clock
    topics: dict[str, TopicReport] = field(default_factory=dict)  # the topics of the rig that exist, by name
    others: dict[str, str] = field(default_factory=dict)  # the types of all other topics, by name
    observations: int = 0
    placed: int = 0  # number of observations that have `T_world_palm`
    without: Counter[str] = field(default_factory=Counter)
    """Number of observations without a finger's wrench or contact, or a surface's reading, by what is missing."""
    backwards: tuple[int, float, float] | None = None
    """How often the clock of the joint states was set back, the largest step back [s], and the stamp before the first
    one [s]; None: it never was."""
    units: Units | None = None  # finds values that seem to be in a wrong unit
    coupled: CoupledJoints | None = None  # finds coupled joints that follow another law
    ended: bool = False  # whether all messages have come
    files: Sequence[RecordedFile] = ()  # those of a recording; several if the recorder has split it

    @property
    def faults(self) -> list[str]:
        """Sentences about what could not be read of the files until now, each with the file's name."""
        return [f"{file.path}: {fault}" for file in self.files for fault in file.faults]

    def table(self) -> list[Fault]:
        """Returns a row for each kind of fault that a user should know of, worst first."""
        rows = _first(Fault("", fault) for fault in self.faults)
        if self.backwards is not None:
            count, far, stamp = self.backwards
            hint = "(played in a loop, or a clock that was set back?): a new track each time"
            first = f", by up to {far:.3f} s, first from {stamp:.3f} s {hint}"
            times = "time" if count == 1 else "times"
            rows.append(Fault(f"{self.joint_states}: stamps went back ", times, count, detail=first))
        for topic in self.topics.values():
            rows += topic.table()
        total = self.observations
        rows += _first(
            Fault(f"{what} in ", "observations", count, total) for what, count in self.without.items()
        )
        rows += [Fault("", each) for each in (self.units.sentences() if self.units else ())]
        rows += [Fault("", each) for each in (self.coupled.sentences() if self.coupled else ())]
        unknown = sorted(name for name, kind in self.others.items() if kind == RosType.WRENCH)
        return rows + _first(
            Fault(f"{name}: ", "wrenches of no finger of the rig; not used") for name in unknown
        )

    def sentences(self) -> list[str]:
        """Returns a sentence for each row of the table."""
        return [fault.sentence for fault in self.table()]


def _first(rows: Iterable[Fault]) -> list[Fault]:
    """Returns the first twelve rows of one kind, and then a row with the number of the others."""
    found = list(rows)
    more = len(found) - MOST
    return [*found[:MOST], Fault("", f"and {more} more like that")] if more > 0 else found


def shortened(sentences: Iterable[str]) -> list[str]:
    """Returns the first twelve sentences of one kind, and then a sentence with the number of the others."""
    messages = list(sentences)
    more = len(messages) - MOST
    return [*messages[:MOST], f"and {more} more like that"] if more > 0 else messages


def missing(
    rig: Rig, topics: Iterable[Topic], report: Report, frames: set[str], joints: set[str]
) -> list[str]:
    """Returns a sentence for each topic, frame and joint of the rig that is missing.

    `topics`: of the rig. `frames`, `joints`: the names of all that have come.
    """
    found = [*_missing_joints(rig, report, joints), *_missing_topics(rig, topics, report)]
    return [printable(each) for each in (*found, *_missing_transforms(rig, report, frames))]


def _missing_joints(rig: Rig, report: Report, joints: set[str]) -> Iterator[str]:
    """Yields a sentence about the joints that have never come."""
    known = rig.hand.couplings.completed(dict.fromkeys(joints, 0.0))
    absent = [joint for joint in rig.hand.moving if joint not in known]
    if report.observations and absent:
        leaders = rig.hand.couplings.leaders(absent)
        named = ", ".join(map(repr, leaders[:MOST]))
        yield f"joint {named}: never on {rig.topics.joint_states}{_nearest(leaders[0], joints)}"


def _missing_topics(rig: Rig, topics: Iterable[Topic], report: Report) -> Iterator[str]:
    """Yields a sentence about each topic that is not there, has another type, or says nothing."""
    by_tf = _by_tf(rig, report)
    for topic in topics:
        what = f"{topic.wanted} on {topic.name}"
        if not topic.wanted or (by_tf and topic.role == "tf"):
            continue
        came = report.topics.get(topic.name)
        if came is None:
            yield what + _nearest(topic.name, report.others)
        elif came.type not in topic.expected and not came.used:
            yield f"{what}: expected {' or '.join(topic.expected)}, got {came.type or 'no type'}"
        elif report.ended and not came.messages:
            yield f"{what}: no message"


def _missing_transforms(rig: Rig, report: Report, frames: set[str]) -> Iterator[str]:
    """Yields a sentence about observations for which /tf does not say where the palm is."""
    unplaced = report.observations - report.placed
    if not (unplaced and report.ended and _by_tf(rig, report)):
        return
    world, palm = (rig.frames[role].lstrip("/") for role in ("world", "palm"))
    unknown = next((name for name in (world, palm) if name not in frames), None)
    why = ""
    if unknown is not None:
        there = _nearest(unknown, frames)
        if frames and not there:
            there = f"; there are {', '.join(shortened(sorted(frames)))}"
        why = f"; {unknown!r} never came{there}"
    of = f"{unplaced} of {report.observations} observations"
    yield f"no transform from {world!r} to {palm!r} on {rig.topics.tf} in {of}{why}"


def _by_tf(rig: Rig, report: Report) -> bool:
    """Returns whether /tf has the palm's pose, and there is such a topic."""
    tf = rig.topics.tf
    return rig.world_from == "tf" and not {tf, f"{tf}_static"}.isdisjoint(report.topics)


def _nearest(name: str, known: Collection[str]) -> str:
    near = nearest_name(name, sorted(known))
    return f"; the nearest is {near!r}" if near else ""
