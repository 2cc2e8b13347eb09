"""What the first messages of a recording have that a rig needs: arrays of numbers, names of joints, frames."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from itertools import islice
from typing import Any, NamedTuple, Protocol

import numpy as np

from handsight.messages.paths import NUMBERS
from handsight.messages.read import deserialized, typestore
from handsight.messages.topics import MessageRejected, RawMessage, RosMessage, RosType

FIRST = 5
"""Messages of a topic that are looked at: a sensor's first ones may be empty."""
LINKS = 500
"""Messages of /tf that are looked at, as each may have one transform."""
MOST_MESSAGES = 50_000
"""Messages of a recording that are looked at."""
SHORTEST = 3
"""An array of fewer numbers, without names beside it, is none of taxels or joints."""
DEEPEST = 6
"""Fields within fields that are looked into."""
MOST_PARTS = 16
"""Messages in a list that are looked into, such as those of fingers; a longer list is of taxels."""
PICTURES = RosType.IMAGE, RosType.COMPRESSED
CLOUD = "sensor_msgs/msg/PointCloud2"
PLACES = "xyz"
"""Columns of a cloud, or fields of a list's messages, with places; those of forces end with the same letters."""


class FoundArray(NamedTuple):
    """Numbers in the messages of a topic."""

    topic: str
    path: str
    length: int
    """Its numbers, or its vectors."""
    width: int
    """Numbers in each: 1, or 3 of vectors."""
    whole: bool
    """Whether they are whole numbers, such as counts."""
    low: float
    high: float
    names: tuple[str, ...] = ()
    """The texts in the field `name` beside it, where there is one."""

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return self.length * self.width

    def __str__(self) -> str:
        """Returns what it is, for a person."""
        each = "numbers" if self.width == 1 else f"vectors of {self.width}"
        place = f"{self.path} on {self.topic}" if self.path else self.topic
        return f"{place}: {self.length} {each}, from {self.low:g} to {self.high:g}"


@dataclass(slots=True)
class Survey:
    """What is in a recording, by its first messages."""

    types: dict[str, str] = field(default_factory=dict)
    """By topic, the type of its messages."""
    arrays: dict[tuple[str, str], FoundArray] = field(default_factory=dict)
    """By topic and path."""
    unknown: set[str] = field(default_factory=set)
    """Topics whose type is neither ROS' own nor that of a driver that is known here."""
    unread: set[str] = field(default_factory=set)
    """Topics with messages that cannot be decoded, as those without a definition."""
    joint_names: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """By topic of JointStates, the names in them."""
    frames: dict[str, str] = field(default_factory=dict)
    """By topic, the frame id of its messages."""
    parents: dict[str, str] = field(default_factory=dict)
    """By child frame, its parent in the transforms."""


class Recorded(Protocol):
    """A file of a recording."""

    topics: dict[str, str]

    def messages(self, wanted: Any) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics."""


def survey(files: Iterable[Recorded]) -> Survey:
    """Returns what the first messages in a recording's files have; raises MissingExtra."""
    found = Survey()
    counts = Counter[str]()
    for file in files:
        found.types |= file.topics
        wanted = {topic for topic, kind in file.topics.items() if kind not in PICTURES}
        for raw in islice(file.messages(wanted), MOST_MESSAGES):
            counts[raw.topic] += 1
            of_links = raw.type in (RosType.TF, RosType.TF_ROS1)
            if counts[raw.topic] <= (LINKS if of_links else FIRST):
                _look(raw, found)
            elif not of_links and all(counts[topic] >= FIRST for topic in wanted):
                break
    return found


def _look(raw: RawMessage, found: Survey) -> None:
    """Adds what a message has."""
    try:
        if raw.type not in typestore(raw.encoding).types:
            found.unknown.add(raw.topic)
        message = deserialized(raw)
    except MessageRejected:
        found.unread.add(raw.topic)
        return
    if raw.type in (RosType.TF, RosType.TF_ROS1):
        for each in message.transforms:
            found.parents[each.child_frame_id.lstrip("/")] = each.header.frame_id.lstrip("/")
        return
    if hasattr(message, "header") and message.header.frame_id:
        found.frames[raw.topic] = message.header.frame_id.lstrip("/")
    if raw.type == RosType.JOINTS:
        found.joint_names[raw.topic] = tuple(message.name)
    arrays = _cloud_arrays(raw.topic, message) if raw.type == CLOUD else _arrays(raw.topic, message)
    for array in arrays:
        before = found.arrays.get((raw.topic, array.path), array)
        low = min(array.low, before.low)
        high = max(array.high, before.high)
        found.arrays[raw.topic, array.path] = array._replace(low=low, high=high)


def _arrays(topic: str, message: Any, path: str = "", depth: int = 0) -> Iterator[FoundArray]:
    """Yields the arrays in a message, and in the messages in it."""
    if depth > DEEPEST:
        return
    for name in field_names(message):
        value = getattr(message, name)
        here = f"{path}.{name}".removeprefix(".")
        if isinstance(value, np.ndarray):
            names = getattr(message, "name", None)
            beside = tuple(names) if isinstance(names, list) else ()
            yield from _array(topic, here, value, 1, beside)
        elif isinstance(value, list) and value and is_dataclass(value[0]):
            yield from _list(topic, value, here, depth)
        elif is_dataclass(value) and name != "header":
            yield from _arrays(topic, value, here, depth + 1)


def _list(topic: str, parts: list[Any], path: str, depth: int) -> Iterator[FoundArray]:
    """Yields a list of vectors, or what is in each message of a short one."""
    names = field_names(parts[0])
    if {*PLACES} <= {*names}:
        vectors = np.array([[getattr(each, axis) for axis in PLACES] for each in parts])
        yield from _array(topic, path, vectors, 3)
        return
    for name in names:  # one number of each
        values = [getattr(each, name) for each in parts]
        if all(isinstance(value, int | float) for value in values):
            yield from _array(topic, f"{path}.{name}", np.array(values), 1, _texts(parts, "name"))
    if len(parts) > MOST_PARTS:
        return
    keys = next((name for name in names if len(set(_texts(parts, name))) == len(parts)), None)
    for k, part in enumerate(parts):
        text = "" if keys is None else getattr(part, keys)
        usable = keys is not None and text and not {*"[]="} & {*text}
        step = f"[{keys}={text}]" if usable else f"[{k}]"
        yield from _arrays(topic, part, path + step, depth + 1)


def _texts(parts: list[Any], name: str) -> tuple[str, ...]:
    """Returns a field of each message, where it is a text."""
    values = [getattr(each, name, None) for each in parts]
    return tuple(value for value in values if isinstance(value, str))


def field_names(message: Any) -> list[str]:
    """Returns the names of a message's fields that a path may have."""
    names = (each.name for each in fields(message))
    return [name for name in names if name[0].isalpha() and not name.startswith("_")]


def _array(
    topic: str, path: str, values: np.ndarray[Any, Any], width: int, names: tuple[str, ...] = ()
) -> Iterator[FoundArray]:
    """Yields an array of numbers that is long enough."""
    finite = values[np.isfinite(values)] if values.dtype.kind in "fiu" else values[:0]
    if len(values) < (1 if names else SHORTEST) or not len(finite):
        return
    low, high = float(finite.min()), float(finite.max())
    whole = values.dtype.kind in "iu"
    yield FoundArray(topic, path, len(values), width, whole, low, high, names)


def _cloud_arrays(topic: str, cloud: RosMessage) -> Iterator[FoundArray]:
    """Yields the columns of a PointCloud2 but those of places, three of one name together."""
    columns = {each.name: each for each in cloud.fields if each.name not in PLACES and each.count <= 1}
    count = int(cloud.height) * int(cloud.width)
    triples: Mapping[str, list[str]] = {
        name[:-1]: [name[:-1] + axis for axis in PLACES] for name in columns if name[-1:] == "x"
    }
    vectors = [names for names in triples.values() if all(name in columns for name in names)]
    single = [[name] for name in columns if not any(name in names for names in vectors)]
    for names in (*vectors, *single):
        whole = NUMBERS.get(columns[names[0]].datatype, "f4")[0] in "iu"
        yield FoundArray(topic, f"[{','.join(names)}]", count, len(names), whole, float("nan"), float("nan"))
