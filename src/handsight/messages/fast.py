"""Readers of JointState, WrenchStamped and TFMessage, far faster than rosbags, as hundreds come in a second.

Both encodings have the same fields in the same order, little-endian. CDR (ROS 2) begins with four bytes of
encapsulation, after which each field is aligned to its size, and its strings end with a zero byte; ROS 1 has a
four-byte sequence number before each stamp. So in both, a message's own stamp is at byte 4 and its frame id at byte 12.
Only messages of exactly the expected form are read; for any other, a reader raises one of `OTHER_BYTES`.
"""

import struct
from collections.abc import Sequence
from typing import Literal, NamedTuple

OTHER_BYTES = struct.error, UnicodeDecodeError
_COUNT, _WRENCH, _TRANSFORM = struct.Struct("<I"), struct.Struct("<6d"), struct.Struct("<7d")


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
