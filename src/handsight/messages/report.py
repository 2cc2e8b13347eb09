"""Counts of a robot's messages, and sentences for the user about what is wrong with them or missing."""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from handsight.checks import nearest_name
from handsight.errors import printable
from handsight.messages.topics import MAX_GAP, RosType, TopicReport
from handsight.rig import Rig
from handsight.rig.coupled_joints import CoupledJoints
from handsight.rig.units import Units

MOST = 12
"""Sentences of one kind that are said."""


class RecordedFile(Protocol):
    """A file of a recording, as far as it is reported."""

    path: Path
    faults: list[str]
    """What could not be read until now, in words."""


@dataclass(slots=True)
class Report:
    """Counts of the messages that have come on the topics of a rig."""

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

    def counts(self) -> Counter[str]:
        """Returns how often something was wrong until now, by what a user should know of it."""
        found = Counter({f"{what} in an observation": count for what, count in self.without.items()})
        if self.backwards is not None:
            found[f"{self.joint_states}: stamps went back: a new track each time"] = self.backwards[0]
        for topic in self.topics.values():
            for what, count in topic.faults.items():
                found[f"{topic.name}: messages {what}"] = count
            if topic.role == "joints":
                found[f"{topic.name}: gaps of more than {MAX_GAP} s"] = topic.gaps
        return found

    def notes(self) -> list[str]:
        """Returns a sentence for each problem that is not counted."""
        messages = [] if self.units is None else self.units.sentences()
        messages += [] if self.coupled is None else self.coupled.sentences()
        for topic in self.topics.values():
            messages += topic.notes()
        others = sorted(name for name, kind in self.others.items() if kind == RosType.WRENCH)
        return messages + shortened(f"{name}: wrenches of no finger of the rig; not used" for name in others)

    def sentences(self) -> list[str]:
        """Returns a sentence for each problem that a user should know of, worst first."""
        messages = shortened(self.faults)
        if self.backwards is not None:
            count, far, stamp = self.backwards
            times = "once" if count == 1 else f"{count} times"
            back = f"stamps went back {times}, by up to {far:.3f} s, first from {stamp:.3f} s"
            hint = "(played in a loop, or a clock that was set back?)"
            messages.append(f"{self.joint_states}: {back} {hint}: a new track each time")
        for topic in self.topics.values():
            of = f"of {topic.messages} messages"
            messages += [f"{topic.name}: {count} {of} {what}" for what, count in topic.faults.items()]
            if topic.gaps and topic.role == "joints":
                longer = f"of more than {MAX_GAP} s, the longest {topic.gap:.3f} s"
                messages.append(f"{topic.name}: {topic.gaps} gaps {longer}")
        of = f"of {self.observations} observations"
        messages += shortened(f"{what} in {count} {of}" for what, count in self.without.items())
        return [printable(each) for each in messages + self.notes()]


def shortened(sentences: Iterable[str]) -> list[str]:
    """Returns the first twelve sentences of one kind, and then a sentence with the number of the others."""
    messages = list(sentences)
    more = len(messages) - MOST
    return [*messages[:MOST], f"and {more} more like that"] if more > 0 else messages


def missing(
    rig: Rig, topics: Iterable[TopicReport], report: Report, frames: set[str], joint_names: set[str]
) -> list[str]:
    """Returns a sentence for each topic, frame and joint of the rig that is missing.

    `topics`: of the rig. `frames`, `joint_names`: all that have come.
    """
    lacking = list[str]()
    known = rig.hand.couplings.completed(dict.fromkeys(joint_names, 0.0))
    absent = [joint for joint in rig.hand.moving if joint not in known]
    if report.observations and absent:  # first, as nothing else works without
        joints = rig.hand.couplings.leaders(absent)
        named = ", ".join(map(repr, joints[:MOST]))
        near = _nearest(joints[0], joint_names)
        lacking.append(f"joint {named}: never on {rig.topics.joint_states}{near}")
    tf = rig.topics.tf
    by_tf = rig.world_from == "tf" and not {tf, f"{tf}_static"}.isdisjoint(report.topics)
    for topic in topics:
        what = f"{topic.wanted} on {topic.name}"
        if not topic.wanted or (by_tf and topic.role == "tf"):
            continue
        if topic.name not in report.topics:
            lacking.append(what + _nearest(topic.name, report.others))
        elif topic.type not in topic.expected and not topic.used:
            expected = " or ".join(topic.expected)
            lacking.append(f"{what}: expected {expected}, got {topic.type or 'no type'}")
        elif report.ended and not topic.messages:
            lacking.append(f"{what}: no message")
    unplaced = report.observations - report.placed
    if by_tf and report.ended and unplaced:
        world, palm = (rig.frames[role].lstrip("/") for role in ("world", "palm"))
        unknown = next((name for name in (world, palm) if name not in frames), None)
        why = "" if unknown is None else f"; {unknown!r} never came{_there(unknown, frames)}"
        of = f"{unplaced} of {report.observations} observations"
        lacking.append(f"no transform from {world!r} to {palm!r} on {tf} in {of}{why}")
    return [printable(each) for each in lacking]


def _there(name: str, known: Collection[str]) -> str:
    """Returns the nearest of the frames that have come, else all of them, for a person."""
    named = ", ".join(shortened(sorted(known)))
    return _nearest(name, known) or (f"; there are {named}" if named else "")


def _nearest(name: str, known: Iterable[str]) -> str:
    near = nearest_name(name, sorted(known))
    return f"; the nearest is {near!r}" if near else ""
