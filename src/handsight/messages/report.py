"""What was heard of a robot and what its rig needs and did not hear, as numbers and as sentences for the user."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from handsight.checks import nearest_name
from handsight.errors import printable
from handsight.messages.topics import TOPICS, WRENCH, TopicReport
from handsight.messages.units import Units
from handsight.rig import Rig

MAX_SENTENCES = 12
"""Sentences of one kind."""


@dataclass(slots=True)
class Report:
    """A `Report` is what was heard on the topics of a rig so far."""

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
    without: Counter[str] = field(default_factory=Counter)
    """By finger: observations without its wrench, or without word of its contact."""
    without_skin: Counter[str] = field(default_factory=Counter)
    """By tactile array: observations without its readings."""
    fingers: dict[str, str] = field(default_factory=dict)
    """By finger: what is wrong with its sensor."""
    backwards: tuple[int, float, float] | None = None
    """Joint states went back by more than 1 s for good: how often, how far at most [s], and the stamp from where they
    did so first [s]."""
    units: Units | None = None
    """What came in other units, it seems."""
    ended: bool = False
    """Whether all messages have come."""

    def sentences(self) -> list[str]:
        """Returns all that is worth telling a user, worst first; empty: nothing is wrong."""
        messages = []
        if self.backwards:
            count, far, stamp = self.backwards
            messages.append(
                f"{self.joint_states}: stamps went back {count} times, by up to {far:.3f} s, first from {stamp:.3f} s "
                "(played in a loop, or a clock that was set back?): a new track each time"
            )
        messages += few([f"finger {finger}: {what}" for finger, what in self.fingers.items()])
        messages += [] if self.units is None else self.units.sentences()
        for topic in self.topics.values():
            messages += topic.sentences()
        joints = self.topics.get(self.joint_states)
        if joints is not None and joints.gaps:
            messages.append(
                f"{joints.name}: {joints.gaps} gaps of more than {TOPICS.max_gap} s, the longest {joints.gap:.3f} s"
            )
        of = f"of {self.observations} observations"
        messages += few(
            [f"finger {finger}: no wrench in {count} {of}" for finger, count in self.without.items()]
        )
        messages += few(
            [f"skin {array}: no reading in {count} {of}" for array, count in self.without_skin.items()]
        )
        others = sorted(name for name, kind in self.others.items() if kind == WRENCH)
        return [printable(each) for each in messages] + few(
            [f"{name}: wrenches of no finger of the rig; not used" for name in others]
        )


def few(sentences: list[str]) -> list[str]:
    """Returns the first of many sentences of one kind, each in a line, and how many more there are."""
    more = len(sentences) - MAX_SENTENCES
    messages = [printable(each) for each in sentences[:MAX_SENTENCES]]
    return [*messages, f"and {more} more like that"] if more > 0 else messages


def missing(rig: Rig, report: Report, frames: set[str], joint_names: set[str]) -> list[str]:
    """Returns a sentence for each topic, frame and joint of the rig that was not heard; empty: nothing is missing.

    `frames`, `joint_names`: those that were heard.
    """
    topics, lacking = rig.topics, list[str]()
    calibrated = rig.camera is not None and rig.camera.intrinsics is not None
    for what, topic in (
        *((f"finger {finger}: no wrench", topic) for finger, topic in topics.wrenches.items()),
        *((f"finger {finger}: no contacts", topic) for finger, topic in topics.contacts.items()),
        *((f"skin {array}: no readings", topic) for array, topic in topics.skin.items()),
        ("no vision", topics.vision),
        ("no color images", topics.color),
        ("no depth images", topics.depth),
        ("no camera info", None if calibrated else topics.camera_info),
    ):
        lacking += [] if topic is None else _missing_topic(report, topic, what)
    if rig.world_from == "tf" and topics.tf is not None:
        lacking += _missing_frames(rig, report, topics.tf, frames)
    unheard = list[str]()
    for joint in rig.hand.moving if report.observations else ():
        if joint not in joint_names:
            near = _nearest(joint, joint_names)
            unheard.append(f"joint {joint!r}: never on {topics.joint_states}{near}")
    return [printable(each) for each in lacking] + few(unheard)


def _missing_topic(report: Report, topic: str, what: str) -> list[str]:
    there = report.topics.get(topic)
    if there is None:
        return [f"{what} on {topic}{_nearest(topic, report.others)}"]
    if there.type not in there.expected:
        return [f"{what} on {topic}: expected {' or '.join(there.expected)}, got {there.type or 'no type'}"]
    return [f"{what} on {topic}: no message"] if report.ended and not there.messages else []


def _missing_frames(rig: Rig, report: Report, topic: str, frames: set[str]) -> list[str]:
    if not {topic, f"{topic}_static"} & report.topics.keys():
        return _missing_topic(report, topic, "no transforms")
    if not report.ended:
        return []
    world, palm = (rig.frames[role].lstrip("/") for role in ("world", "palm"))
    unknown = [name for name in (world, palm) if name not in frames]
    if unknown:
        near = _nearest(unknown[0], frames)
        return [f"no transform of {' and '.join(map(repr, unknown))} on {topic}{near}"]
    if not report.placed:
        return [f"no transforms that lead from {world!r} to {palm!r} on {topic}"]
    absent = report.observations - report.placed
    messages = f"no transform from {world!r} to {palm!r} in {absent} of {report.observations} observations"
    return [messages] if absent else []


def _nearest(name: str, there: Iterable[str]) -> str:
    near = nearest_name(name, sorted(there))
    return f"; the nearest is {near!r}" if near else ""
