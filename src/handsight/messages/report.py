"""What messages came and what of them was used, as numbers and as sentences for the user."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from handsight.messages.topics import WRENCH

MAX_GAP = 0.1
"""Joint states farther apart are counted as a gap [s]."""
MAX_QUIET_DIFFERENCE = 0.1
"""Clocks farther apart are told [s]."""
MAX_REASONS = 8
"""Different reasons that are kept for a topic; a message's own words may be among them."""


class MessageRejected(Exception):
    """A message that is not used, and why; never leaves this package."""

    def __init__(self, reason: str, *, nan: bool = False) -> None:
        """`nan`: it is one that holds NaN or infinity."""
        super().__init__(reason)
        self.nan = nan


@dataclass(slots=True)
class TopicReport:
    """One topic. `messages` is the sum of the counts from `used` to `stuck`; /tf is counted by transforms."""

    topic: str
    type: str = ""
    messages: int = 0
    used: int = 0
    """Taken, in order of stamp; of several between two joint states the newest is in the observation."""
    duplicated: int = 0
    """Of the same topic and stamp as one before."""
    nan: int = 0
    """With NaN or infinity in it."""
    late: int = 0
    """Beyond the reorder window."""
    bad: int = 0
    """Could not be read as what the topic should be."""
    stale: int = 0
    """Too old when the next joint states came."""
    stuck: int = 0
    """Of a sensor that is stuck or at full scale."""
    reasons: dict[str, int] = field(default_factory=dict)
    """Why messages were not used, with how many."""
    first: float | None = None
    """Earliest stamp that was used, in the clock of the joint states [s]."""
    last: float | None = None
    """Latest [s]."""
    gap: float = 0.0
    """Longest time between two that were used [s]."""
    gaps: int = 0
    """How many were longer than 0.1 s."""
    offset: float | None = None
    """Log time minus stamp, median of the first second [s]; None: not known."""
    difference: float = 0.0
    """Of `offset` from the joint states' [s]."""
    shifted: bool = False
    """Whether the stamps were shifted by the difference: it is another clock."""
    unstamped: bool = False
    """Whether its stamps are all 0, and log time was taken."""

    @property
    def rate(self) -> float | None:
        """Of those used [Hz]; None: fewer than two."""
        if self.first is None or self.last is None or self.last <= self.first:
            return None
        return (self.used + self.stale - 1) / (self.last - self.first)

    def reject(self, error: MessageRejected) -> None:
        """Count a message as nan or bad, and why."""
        self.nan, self.bad = self.nan + error.nan, self.bad + (not error.nan)
        reason = str(error)
        if reason not in self.reasons and len(self.reasons) >= MAX_REASONS:
            reason = "other reasons"
        self.reasons[reason] = self.reasons.get(reason, 0) + 1

    def use(self, stamp: float) -> None:
        """Count a message as used."""
        self.used += 1
        if self.last is None or self.first is None:
            self.first = self.last = stamp
            return
        gap = stamp - self.last
        self.gap = max(self.gap, gap)
        self.gaps += gap > MAX_GAP
        self.last = max(self.last, stamp)

    def sentences(self) -> Iterator[str]:
        """What of this topic is worth telling."""
        for count, said in (
            (self.duplicated, "came twice with one stamp and were used once"),
            (self.late, "came too late to be put in order of stamp and were left out"),
            (self.stale, "were too old when the next joint states came and were left out"),
        ):
            if count:
                yield f"{self.topic}: {count} of {self.messages} messages {said}"
        for reason, count in self.reasons.items():
            yield f"{self.topic}: {count} of {self.messages} messages left out: {reason}"
        if self.unstamped:
            yield f"{self.topic}: no stamps (all 0); timed by when it was recorded"
        if abs(self.difference) > MAX_QUIET_DIFFERENCE:
            what = "shifted by that: another clock" if self.shifted else "left as they are"
            yield f"{self.topic}: stamps {self.difference:+.3f} s off the joint states' clock, {what}"


@dataclass(slots=True)
class Report:
    """What was heard on the topics of a rig so far."""

    joint_states: str
    """The topic whose stamps are the clock."""
    topics: dict[str, TopicReport] = field(default_factory=dict)
    """By name; those the rig listens to and that are there."""
    others: dict[str, str] = field(default_factory=dict)
    """Type by topic, of those the rig does not listen to."""
    observations: int = 0
    """How many were made."""
    placed: int = 0
    """How many have `T_world_palm`."""
    without: dict[str, int] = field(default_factory=dict)
    """By finger: observations without its wrench."""
    fingers: dict[str, str] = field(default_factory=dict)
    """By finger: what is wrong with its sensor."""
    backwards: tuple[int, float, float] | None = None
    """Joint states whose stamp is more than 1 s before an earlier one's: how many, how far back at most [s], and the
    stamp from where the first of them went back [s]."""
    ended: bool = False
    """Whether all messages have come."""

    @property
    def unknown_wrenches(self) -> tuple[str, ...]:
        """Topics of wrenches that belong to no finger of the rig."""
        return tuple(sorted(topic for topic, kind in self.others.items() if kind == WRENCH))

    @property
    def first(self) -> float | None:
        """Stamp of the first joint states [s]."""
        return self._joints.first

    @property
    def last(self) -> float | None:
        """Stamp of the last joint states [s]."""
        return self._joints.last

    @property
    def _joints(self) -> TopicReport:
        return self.topics.get(self.joint_states) or TopicReport(self.joint_states)

    def sentences(self) -> list[str]:
        """All that is worth telling a user, worst first; empty: nothing is wrong."""
        said, joints = [], self._joints
        if self.backwards:
            count, far, stamp = self.backwards
            said.append(
                f"{joints.topic}: stamps go back by up to {far:.3f} s from "
                f"{stamp:.3f} s on ({count} messages; played in a loop, or a clock that was set back?)"
            )
        said += [f"finger {finger}: {what}" for finger, what in self.fingers.items()]
        for topic in self.topics.values():
            said += topic.sentences()
        if joints.gaps:
            said.append(
                f"{joints.topic}: {joints.gaps} gaps of more than {MAX_GAP} s, the longest {joints.gap:.3f} s"
            )
        for finger, count in self.without.items():
            said.append(f"finger {finger}: no wrench in {count} of {self.observations} observations")
        said += [f"{topic}: wrenches of no finger of the rig; not used" for topic in self.unknown_wrenches]
        return said
