"""Bytes to messages: JointState, WrenchStamped and TFMessage by fast readers, all others by rosbags.

Hundreds of the first come in a second, and the fast readers take a tenth of rosbags' time. Both encodings have the same
fields in the same order, little-endian. CDR (ROS 2) begins with four bytes of encapsulation, after which each field is
aligned to its size, and its strings end with a zero byte; ROS 1 has a four-byte sequence number before each stamp. So
in both, a message's own stamp is at byte 4 and its frame id at byte 12. Only messages of exactly the expected form are
read; for any other, a fast reader raises one of `OTHER_BYTES`.
"""

import re
import struct
from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from handsight.errors import needing
from handsight.messages.definitions import definitions
from handsight.messages.topics import MessageRejected, RawMessage, RosMessage, RosType

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IDL = "=" * 80 + "\nIDL: "
"""What is before each definition in IDL, as recorders of ROS 2 write them one after the other."""
MAX_DEFINITION = 1 << 16
"""Length of the longest definition of a type that is read [characters]."""
LAYOUTS = {
    ("cdr", RosType.DETECTIONS): (RosType.DETECTIONS, "vision_msgs_foxy/msg/Detection2DArray"),
}
"""The layouts to try of a type that has one name in all versions, as a live message brings no definition; only one of
them is as long as the message."""
OTHER_BYTES = struct.error, UnicodeDecodeError
_COUNT = struct.Struct("<I")
_WRENCH = struct.Struct("<6d")
_TRANSFORM = struct.Struct("<7d")


class StampedTransform(NamedTuple):
    """The fields of one transform of a TFMessage."""

    stamp: float
    parent: str
    child: str
    numbers: Sequence[float]  # x, y, z [m], then the quaternion's x, y, z, w


class FastReader:
    """Messages of one encoding; it keeps the last JointState's names, which seldom change."""

    def __init__(self, encoding: Literal["cdr", "ros1"]) -> None:
        self._cdr = encoding == "cdr"
        self._stamp_format = "<iI" if self._cdr else "<II"
        self._named = b""
        self._names = list[str]()

    def wrench(self, data: bytes) -> tuple[float, Sequence[float]]:
        """Returns stamp [s], and force [N] and torque [N m] (6 numbers)."""
        at = self._aligned(16 + self._count(data, 12), 8)
        self._check(data, at + _WRENCH.size)
        return self._stamp(data, 4), _WRENCH.unpack_from(data, at)

    def joints(self, data: bytes) -> tuple[float, Sequence[str], Sequence[float]]:
        """Returns stamp [s], names and positions [rad or m]."""
        if not self._named or not data.startswith(self._named, 12):
            at = self._aligned(16 + self._count(data, 12), 4)
            count = self._count(data, at)
            at += 4
            names = []
            for _ in range(count):
                at, name = self._text(data, at)
                at = self._aligned(at, 4)
                names.append(name)
            self._named = data[12:at]
            self._names = names
        at, count = self._skipped(data, 12 + len(self._named))
        positions = struct.unpack_from(f"<{count}d", data, at - 8 * count)
        for _ in ("velocity", "effort"):
            at, _ = self._skipped(data, at)
        self._check(data, at)
        return self._stamp(data, 4), self._names, positions

    def transforms(self, data: bytes) -> list[StampedTransform]:
        """Returns the transforms of a TFMessage."""
        at = 4 if self._cdr else 0
        count = self._count(data, at)
        at += 4
        found = list[StampedTransform]()
        for _ in range(count):
            at = self._aligned(at, 4) if self._cdr else at + 4
            stamp = self._stamp(data, at)
            at, parent = self._text(data, at + 8)
            at, child = self._text(data, self._aligned(at, 4))
            at = self._aligned(at, 8)
            found.append(StampedTransform(stamp, parent, child, _TRANSFORM.unpack_from(data, at)))
            at += _TRANSFORM.size
        self._check(data, at)
        return found

    def _check(self, data: bytes, end: int) -> None:
        """Raises struct.error where a message should have another length, or is not in little-endian CDR."""
        if end != len(data) or (self._cdr and data[:2] != b"\0\1"):
            raise struct.error

    def _count(self, data: bytes, at: int) -> int:
        count: int = _COUNT.unpack_from(data, at)[0]
        return count

    def _stamp(self, data: bytes, at: int) -> float:
        sec, nanosec = struct.unpack_from(self._stamp_format, data, at)
        return float(sec + nanosec * 1e-9)

    def _aligned(self, at: int, size: int) -> int:
        return at + (4 - at) % size if self._cdr else at

    def _text(self, data: bytes, at: int) -> tuple[int, str]:
        """Returns the end of a string, and the string."""
        begin = at + 4
        end = begin + self._count(data, at)
        last = end - self._cdr
        if end > len(data) or last < begin or (self._cdr and data[last]):
            raise struct.error
        return end, data[begin:last].decode()

    def _skipped(self, data: bytes, at: int) -> tuple[int, int]:
        """Returns the end of a sequence of doubles, and their count."""
        count = self._count(data, at)
        end = (self._aligned(at + 4, 8) if count else at + 4) + 8 * count
        if end > len(data):
            raise struct.error
        return end, count


def deserialized(raw: RawMessage) -> RosMessage:
    """Returns the message as rosbags decodes it; raises MessageRejected, MissingExtra."""
    store = typestore(raw.encoding)
    reason = ""
    if raw.definition and (raw.type in definitions("both") or raw.type not in store.types):
        store = defined(raw.encoding, raw.type, raw.definition)  # its own, if it is no type of ROS itself
    for layout in LAYOUTS.get((raw.encoding, raw.type), (raw.type,)):
        try:
            message: RosMessage = getattr(store, f"deserialize_{raw.encoding}")(raw.data, layout)
            return message
        except Exception as error:  # rosbags' generated code raises anything: the bytes are no such message
            reason = reason or str(error)[:80]
    raise MessageRejected(f"expected a {raw.type}, got {len(raw.data)} bytes that are none ({reason})")


@lru_cache(64)
def defined(encoding: str, kind: str, definition: str) -> "Typestore":
    """Returns rosbags' types with one that a definition gives, and those it is made of; raises MessageRejected."""
    typesys = rosbags_module("rosbags.typesys")
    if len(definition) > MAX_DEFINITION:
        raise MessageRejected(f"expected a definition of {kind} within {MAX_DEFINITION} characters")
    store = _types_of_ros(encoding)
    types = dict[str, Any]()
    try:
        if definition.startswith(IDL):  # of the type, and of each that it is made of
            for each in re.split(f"{IDL}.*", definition)[1:]:
                types |= typesys.get_types_from_idl(each)
        else:
            types |= typesys.get_types_from_msg(definition, kind)
        store.register({name: each for name, each in types.items() if name not in store.types})
    except Exception as error:  # a parser that raises anything: the text is no definition
        came = f"one that is none ({str(error)[:80]})"
        raise MessageRejected(f"expected a definition of {kind}, got {came}") from None
    return store


@lru_cache
def typestore(encoding: str) -> "Typestore":
    """Returns the known message types for an encoding, `cdr` or `ros1`; raises MessageRejected, MissingExtra."""
    store = _types_of_ros(encoding)
    types = dict[str, Any]()
    for kind, definition in (definitions("both") | definitions(encoding)).items():
        types |= rosbags_module("rosbags.typesys").get_types_from_msg(definition, kind)
    store.register({kind: each for kind, each in types.items() if kind not in store.types})
    return store


def _types_of_ros(encoding: str) -> "Typestore":
    """Returns rosbags' message types for an encoding; raises MessageRejected, MissingExtra."""
    typesys = rosbags_module("rosbags.typesys")
    stores = {"cdr": typesys.Stores.ROS2_HUMBLE, "ros1": typesys.Stores.ROS1_NOETIC}
    if encoding not in stores:
        raise MessageRejected(f"expected messages encoded as cdr or ros1, got {encoding[:20]!r}")
    store: Typestore = typesys.get_typestore(stores[encoding])
    return store


def rosbags_module(name: str) -> ModuleType:
    """Returns a module of rosbags or mcap, or of a package that they require; raises MissingExtra."""
    with needing("recordings need rosbags and mcap", "robot"):
        return import_module(name)
