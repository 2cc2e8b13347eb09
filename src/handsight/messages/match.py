"""Which of a recording's topics are what in a rig, by the types of their messages and by their names."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from handsight.hand import Hand
from handsight.hand.guess import named_finger
from handsight.messages.definitions import CONTACTS
from handsight.messages.survey import FoundArray, Survey
from handsight.messages.topics import RosType
from handsight.rig import Topics
from handsight.rig.layouts import Places
from handsight.rig.rig import JointReading
from handsight.rig.yaml_file import YamlFile

MOST_SAID = 12
"""Names of one kind that are said."""
TOUCH = "tact|taxel|touch|skin|pressure"
"""Words in the names of topics about touch."""
POSITIONS = "pos|angle|joint|state"
"""Words in the topic or the path of joints' positions."""
FILE = Path(__file__).parents[1] / "data" / "topics.yaml"


class JointMatch(NamedTuple):
    """How a recording's joint states are read."""

    topic: str | None
    reading: JointReading | None
    """None: as those of a JointState."""
    joint_names: dict[str, str]
    """By the name of a joint in messages, that in the hand's file, where these differ."""
    guessed: list[str]
    open_ends: list[str]
    """What is left to fill in."""


class Role(msgspec.Struct):
    """What a topic is taken for."""

    what: str
    types: set[str]
    words: list[str]


class Driver(msgspec.Struct):
    """Where a driver of tactile sensors has taxels in its messages."""

    type: str
    in_hands: str
    in_its_own: str
    places: dict[str, str | float]
    words: str = ""


class Known(msgspec.Struct):
    """The keys of the file."""

    topics: dict[str, Role]
    taxels: list[Driver]


def match_topics(types: Mapping[str, str], fingers: Sequence[str]) -> tuple[Topics, dict[str, str]]:
    """Returns the topics of a rig with these fingers, and by topic what it was taken for.

    `types`: by topic, the type of its messages. A finger's wrenches, or contacts, are on the topic whose name has the
    finger's, or one of its usual names (`named_finger`); topics without such a name are taken in the order of their
    numbers, as the fingers are.
    """
    used = dict[str, str]()
    found: dict[str, Any] = {"vision": None, "tf": None}
    for key, role in YamlFile(FILE).read(Known).topics.items():
        free = sorted((t for t, kind in types.items() if kind in role.types and t not in used), key=len)
        topic = next((t for word in role.words for t in free if word in t.lower()), None)
        if topic is not None:
            found[key] = topic
            used[topic] = role.what
    for key, kinds in (("wrenches", [RosType.WRENCH]), ("contacts", CONTACTS)):
        found[key] = _by_finger([topic for topic, kind in types.items() if kind in kinds], fingers)
        used |= {topic: f"{key} of {finger}" for finger, topic in found[key].items()}
    return Topics(**found), used


def match_taxels(types: Mapping[str, str], fingers: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Returns by finger, or by sensor, the keys of a rig's `skin` entry for its taxels, but not where they are.

    `types`: by topic, the type of its messages. Drivers have one topic for the hand, or one for each finger. Of plain
    arrays, those are taken whose topic's name is about touch.
    """
    for driver in YamlFile(FILE).read(Known).taxels:
        found = [t for t, kind in types.items() if kind.endswith(driver.type)]
        topics = [topic for topic in found if re.search(driver.words, topic.lower())]
        if topics:
            path = driver.in_hands
            of = dict.fromkeys(fingers, topics[0])
            if len(topics) > 1:
                path = driver.in_its_own
                of = _by_finger(topics, fingers)
            entries = dict[str, dict[str, Any]]()
            for n, (finger, topic) in enumerate(of.items()):
                field = path.format(finger=finger, number=n + 1, first=16 * n, end=16 * n + 16)
                entries[finger] = {**driver.places, "topic": topic, "field": field}
            return entries
    return {}


def match_arrays(
    arrays: Sequence[FoundArray], fingers: Sequence[str], places: Sequence[Places]
) -> dict[str, dict[str, Any]]:
    """Returns by finger, or by finger and part of it, the keys of a rig's `skin` entry for arrays of a known length.

    An array is of the finger that its path or its topic names; arrays that name none, at paths that differ by their
    indices alone, are of the fingers in order. One that is as long as those of all fingers is cut in order.
    """
    groups = dict[str, list[tuple[FoundArray, Places]]]()
    for array in arrays:
        known = next((each for each in places if _fits(array, each)), None)
        if known is not None:
            place = re.sub(r"\[[^\]]*\]|\d+", "", f"{array.topic} {array.path}")
            groups.setdefault(place, []).append((array, known))
    found = dict[str, dict[str, Any]]()
    for group in groups.values():
        for finger, (array, known) in _of_fingers(group, fingers):
            found[_entry_name(finger, array, found)] = _entry(array, known, array.path)
    cut = ((array, each) for array in arrays for each in places if _fits(array, each, len(fingers)))
    for array, known in () if found else islice(cut, 1):
        step = array.length // len(fingers)
        for k, finger in enumerate(fingers):
            found[finger] = _entry(array, known, f"{array.path}[{k * step}:{(k + 1) * step}]")
    return found


def _of_fingers(
    group: Sequence[tuple[FoundArray, Places]], fingers: Sequence[str]
) -> Iterator[tuple[str, tuple[FoundArray, Places]]]:
    """Yields the arrays of a group with their fingers: those that are named, else in order."""
    names = [named_finger(array.path) or named_finger(array.topic) or "" for array, _ in group]
    if not {*names} & {*fingers}:
        yield from zip(fingers, group, strict=False)
        return
    for name, each in zip(names, group, strict=True):
        if name in fingers:
            yield name, each


def _fits(array: FoundArray, places: Places, times: int = 1) -> bool:
    """Returns whether an array has a reading of each taxel, of so many surfaces."""
    return array.size == times * places.taxels * places.components and array.width in (1, places.components)


def _entry_name(finger: str, array: FoundArray, taken: Collection[str]) -> str:
    """Returns the finger, or its name and that of the array's field where it has several."""
    parts = re.findall(r"[A-Za-z]\w*", re.sub(r"\[[^\]]*\]", "", array.path))
    return finger if finger not in taken else f"{finger}_{parts[-1] if parts else len(taken)}"


def _entry(array: FoundArray, places: Places, path: str) -> dict[str, Any]:
    """Returns the keys of an array's entry: counts have another threshold than newtons."""
    threshold = 60 if array.whole else 0.05 if places.components == 3 else 0.1
    components = {} if "layout" in places.keys else {"components": places.components}
    return {**places.keys, **components, "threshold": threshold, "topic": array.topic, "field": path}


def may_touch(topic: str, kind: str) -> bool:
    """Returns whether a topic of arrays or clouds is about touch, by its name."""
    arrays = kind.endswith("MultiArray") or kind == "sensor_msgs/msg/PointCloud2"
    return arrays and re.search(TOUCH, topic.lower()) is not None


def match_joints(found: Survey, hand: Hand, topic: str | None) -> JointMatch:
    """Returns how a recording's joint states are read for a hand, and what is guessed and left to fill in for that.

    `topic`: of JointStates; None: there is none.
    """
    names = found.joint_names.get(topic or "", ())
    theirs = _their_names(names, hand.needed)
    if topic is not None and theirs is not None:
        guessed = [f"hand.joints: {name} of messages is {own}" for name, own in [*theirs.items()][:1]]
        return JointMatch(topic, None, theirs, guessed, [])
    for array in found.arrays.values():
        theirs = _their_names(array.names, hand.needed)
        if array.topic in found.unknown and theirs is not None and array.length == len(array.names):
            return _reading(array, (), theirs, hand)
    for array in found.arrays.values() if topic is None else ():
        if array.width == 1 and re.search(POSITIONS, f"{array.topic} {array.path}".lower()):
            for joints in (hand.needed, hand.joint_names):
                if array.length == len(joints):
                    return _reading(array, joints, {}, hand)
    if topic is None:
        return JointMatch(None, None, {}, [], ["topics.joint_states: no joint states were found"])
    theirs_said = ", ".join(names[:MOST_SAID]) or "nothing"
    expected = ", ".join(hand.needed[:MOST_SAID])
    missing = (
        f"hand.joints, or topics.joint_states.names: {topic} names {theirs_said}; the hand's file {expected}"
    )
    return JointMatch(topic, None, {}, [], [missing])


def _reading(array: FoundArray, joints: Sequence[str], joint_names: dict[str, str], hand: Hand) -> JointMatch:
    """Returns an array as positions of joints."""
    guessed = [f"joint states: {array}"]
    open_ends = list[str]()
    if joints:
        order = "the order of the hand's file, as no names are beside the numbers: check it"
        guessed.append(f"topics.joint_states.names: {order}")
    limits = hand.limits[np.isfinite(hand.limits).all(axis=1)]
    most = float(np.abs(limits).max(initial=0.0))
    if most and max(abs(array.low), abs(array.high)) > 2 * most + 1:
        numbers = f"its numbers are {array.low:g} to {array.high:g}, and joints move within {most:.3g} rad"
        open_ends.append(f"topics.joint_states.scale and offset: {numbers}")
    reading = JointReading(field=array.path, names=tuple(joints))
    return JointMatch(array.topic, reading, joint_names, guessed, open_ends)


def _their_names(names: Sequence[str], needed: Sequence[str]) -> dict[str, str] | None:
    """Returns by name in messages that of a joint of the hand's file, where all differ by one beginning.

    It is empty where none differs, and None where the messages have not all joints.
    """
    if not needed or {*needed} <= {*names}:
        return {} if needed else None
    for name in names:
        if name.endswith(needed[0]):
            added = name.removesuffix(needed[0])
            renamed = {added + joint: joint for joint in needed}
        elif name and needed[0].endswith(name):
            lacking = needed[0].removesuffix(name)
            renamed = {joint.removeprefix(lacking): joint for joint in needed}
        else:
            continue
        if {*renamed} <= {*names}:
            return renamed
    return None


def match_frames(found: Survey, palm: str, vision: str | None) -> tuple[dict[str, str], list[str], list[str]]:
    """Returns the frames of a rig by role, what was guessed of them, and what is left to fill in.

    `palm`: the palm's link. `vision`: the topic of the object's poses.
    """
    frames = dict[str, str]()
    guessed = list[str]()
    open_ends = list[str]()
    known = sorted({*found.parents, *found.parents.values()}, key=lambda name: (len(name), name))
    palms = [name for name in known if re.split(r"[/]", name)[-1] == palm or name.endswith(f"_{palm}")]
    if palms:
        above = [palms[0]]
        while above[-1] in found.parents and found.parents[above[-1]] not in above:
            above.append(found.parents[above[-1]])
        frames = {"palm": above[0], "world": above[-1]}
        guessed.append(
            f"frames: in /tf the palm is {above[0]}, and the world {above[-1]}, which hangs on none"
        )
    elif known:
        there = ", ".join(known[:MOST_SAID])
        open_ends.append(
            f"frames.palm and frames.world: none of the frames in /tf is {palm}; there are {there}"
        )
    camera = found.frames.get(vision or "")
    if camera is not None and camera not in frames.values():
        frames["camera"] = camera
        guessed.append(f"frames.camera: {camera}, as {vision} says")
    return frames, guessed, open_ends


def _by_finger(topics: Sequence[str], fingers: Sequence[str]) -> dict[str, str]:
    """Returns the topic of each finger, or sensor of a finger.

    It is the topic that has its name between slashes, else one that names the same finger, else the next by number.
    """
    found = dict[str, str]()
    for finger in fingers:
        free = [topic for topic in topics if topic not in found.values()]
        exact = [topic for topic in free if finger.lower() in topic.lower().split("/")]
        same = [topic for topic in free if named_finger(topic) == named_finger(finger) is not None]
        if exact or same:
            found[finger] = [*exact, *same][0]
    rest = [topic for topic in topics if topic not in found.values()]
    rest.sort(key=lambda topic: [int(number) for number in re.findall(r"\d+", topic)] or [0])
    missing = [finger for finger in fingers if finger not in found]
    found |= dict(zip(missing, rest, strict=False))
    return {finger: found[finger] for finger in fingers if finger in found}
