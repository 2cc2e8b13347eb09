"""Counts of a robot's messages, and sentences for the user about what is wrong with them or missing."""

from collections import Counter
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from handsight.checks import nearest_name
from handsight.errors import printable
from handsight.messages.topics import MAX_GAP, RosType, TopicReport
from handsight.rig import Rig
from handsight.rig.units import Units

T = TypeVar("T", TopicReport, "Report")


@dataclass(slots=True)
class Report:
    """A `Report` counts the messages that have come on the topics of a rig."""

    joint_states: str  # the topic whose stamps are the clock
    topics: dict[str, TopicReport] = field(default_factory=dict)  # the topics of the rig that exist, by name
    others: dict[str, str] = field(default_factory=dict)  # the types of all other topics, by name
    observations: int = 0
    placed: int = 0  # number of observations that have `T_world_palm`
    without: Counter[str] = field(default_factory=Counter)
    """Number of observations without a wrench or a contact message, by finger."""
    without_skin: Counter[str] = field(default_factory=Counter)
    """Number of observations without readings, by tactile array."""
    fingers: dict[str, str] = field(default_factory=dict)  # what is wrong with a sensor, by finger
    backwards: tuple[int, float, float] | None = None
    """How often the clock of the joint states was set back, the largest step back [s], and the stamp before the first
    one [s]; None: it never was."""
    units: Units | None = None  # finds values that seem to be in a wrong unit
    ended: bool = False  # whether all messages have come

    def copied(self) -> "Report":
        """Returns a copy that does not change any more."""
        return deepcopy(replace(self, units=None))

    def since(self, before: "Report") -> "Report":
        """Returns what was counted after an earlier copy; what is wrong with a sensor, only if it has changed."""
        backwards = None if self.backwards == before.backwards else self.backwards
        new = {topic: TopicReport(topic, "joints", ()) for topic in self.topics.keys() - before.topics.keys()}
        topics = {name: _counted(each, (before.topics | new)[name]) for name, each in self.topics.items()}
        fingers = {name: why for name, why in self.fingers.items() if before.fingers.get(name) != why}
        return replace(_counted(self, before), topics=topics, fingers=fingers, backwards=backwards)

    def sentences(self) -> list[str]:
        """Returns a sentence for each problem that a user should know of, worst first."""
        messages = []
        if self.backwards:
            count, far, stamp = self.backwards
            times = "once" if count == 1 else f"{count} times"
            back = f"stamps went back {times}, by up to {far:.3f} s, first from {stamp:.3f} s"
            hint = "(played in a loop, or a clock that was set back?)"
            messages.append(f"{self.joint_states}: {back} {hint}: a new track each time")
        messages += shortened(f"finger {finger}: {what}" for finger, what in self.fingers.items())
        messages += [] if self.units is None else self.units.sentences()
        for topic in self.topics.values():
            messages += topic.sentences()
        joints = self.topics.get(self.joint_states)
        if joints is not None and joints.gaps:
            longer = f"of more than {MAX_GAP} s, the longest {joints.gap:.3f} s"
            messages.append(f"{joints.name}: {joints.gaps} gaps {longer}")
        of = f"of {self.observations} observations"
        fingers, arrays = self.without.items(), self.without_skin.items()
        messages += shortened(f"finger {name}: no wrench in {count} {of}" for name, count in fingers)
        messages += shortened(f"skin {name}: no reading in {count} {of}" for name, count in arrays)
        others = sorted(name for name, kind in self.others.items() if kind == RosType.WRENCH)
        unused = shortened(f"{name}: wrenches of no finger of the rig; not used" for name in others)
        return [printable(each) for each in messages] + unused


def _counted(now: T, before: T) -> T:
    """Returns a report with all its numbers counted after an earlier one."""
    counts = [each.name for each in fields(now) if type(getattr(now, each.name)) in (int, Counter)]
    changes: dict[str, Any] = {name: getattr(now, name) - getattr(before, name) for name in counts}
    return replace(now, **changes)


def shortened(sentences: Iterable[str]) -> list[str]:
    """Returns the first twelve sentences of one kind, and then a sentence with the number of the others."""
    messages, most = list(sentences), 12
    more = len(messages) - most
    messages = [printable(each) for each in messages[:most]]
    return [*messages, f"and {more} more like that"] if more > 0 else messages


def missing(rig: Rig, report: Report, frames: set[str], joint_names: set[str]) -> list[str]:
    """Returns a sentence for each topic, frame and joint of the rig that is missing. `frames`, `joint_names`: all that
    have come."""
    topics, lacking = rig.topics, list[str]()
    calibrated = rig.camera is not None and rig.camera.intrinsics is not None
    by_tf = rig.world_from == "tf" and topics.tf is not None
    silent_tf = by_tf and not {topics.tf, f"{topics.tf}_static"} & report.topics.keys()
    for what, topic in (
        *((f"finger {finger}: no wrench", topic) for finger, topic in topics.wrenches.items()),
        *((f"finger {finger}: no contacts", topic) for finger, topic in topics.contacts.items()),
        *((f"skin {array}: no readings", topic) for array, topic in topics.skin.items()),
        ("no vision", topics.vision),
        ("no color images", topics.color),
        ("no depth images", topics.depth),
        ("no camera info", None if calibrated else topics.camera_info),
        ("no transforms", topics.tf if silent_tf else None),
    ):
        if topic is None:
            continue
        known = report.topics.get(topic)
        if known is None:
            lacking.append(f"{what} on {topic}{_nearest(topic, report.others)}")
        elif known.type not in known.expected and not known.used:
            expected = " or ".join(known.expected)
            lacking.append(f"{what} on {topic}: expected {expected}, got {known.type or 'no type'}")
        elif report.ended and not known.messages:
            lacking.append(f"{what} on {topic}: no message")
    if by_tf and not silent_tf and report.ended:
        world, palm = (rig.frames[role].lstrip("/") for role in ("world", "palm"))
        unknown = [name for name in (world, palm) if name not in frames]
        absent = report.observations - report.placed
        if unknown:
            names, near = " and ".join(map(repr, unknown)), _nearest(unknown[0], frames)
            lacking.append(f"no transform of {names} on {topics.tf}{near}")
        elif not report.placed:
            lacking.append(f"no transforms that lead from {world!r} to {palm!r} on {topics.tf}")
        elif absent:
            of = f"{absent} of {report.observations} observations"
            lacking.append(f"no transform from {world!r} to {palm!r} in {of}")
    absent_joints = [joint for joint in rig.hand.moving if report.observations and joint not in joint_names]
    if absent_joints:
        first, several = absent_joints[0], len(absent_joints) > 1
        named, near = ", ".join(map(repr, absent_joints[:4])), _nearest(first, joint_names)
        named += f" and {len(absent_joints) - 4} more" if len(absent_joints) > 4 else ""
        near = near.replace("the nearest", f"the nearest to {first!r}") if several else near
        lacking.append(f"joint{'s' if several else ''} {named}: never on {topics.joint_states}{near}")
    return [printable(each) for each in lacking]


def _nearest(name: str, known: Iterable[str]) -> str:
    near = nearest_name(name, sorted(known))
    return f"; the nearest is {near!r}" if near else ""
