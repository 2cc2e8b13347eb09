"""JointState and WrenchStamped as ROS 1 writes them, read as `fast_cdr` reads those of ROS 2.

Little-endian, nothing aligned: sequence number, seconds, nanoseconds, frame id, then the fields one after the other.
For all that is not exactly as expected the answer is None, and rosbags decides.
"""

import struct
from collections.abc import Sequence

_COUNT, _STAMP, _WRENCH = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<6d")
_HEADER = 16
"""Bytes of a header before its frame id."""
_MOST_NAMES = 1000


class FastRos1Reader:
    """Reads JointState and WrenchStamped; remembers the names of the last, which seldom change."""

    def __init__(self) -> None:
        self._named, self._names = b"", list[str]()

    def wrench(self, data: bytes) -> tuple[float, Sequence[float]] | None:
        """Stamp [s], and force and torque; None: rosbags must read it."""
        try:
            at = _HEADER + _COUNT.unpack_from(data, 12)[0]
            if at + _WRENCH.size != len(data):
                return None
            return _stamp(data), _WRENCH.unpack_from(data, at)
        except struct.error:
            return None

    def joints(self, data: bytes) -> tuple[float, Sequence[str], Sequence[float]] | None:
        """Stamp [s], names and positions; None: rosbags must read it."""
        try:
            if not self._named or not data.startswith(self._named, 12):
                self._named, self._names = _names(data)
            at, count = _skipped(data, 12 + len(self._named))
            positions = struct.unpack_from(f"<{count}d", data, at - 8 * count)
            for _ in ("velocity", "effort"):
                at, _ = _skipped(data, at)
            return (_stamp(data), self._names, positions) if at == len(data) else None
        except (struct.error, UnicodeDecodeError):
            return None


def _stamp(data: bytes) -> float:
    sec, nanosec = _STAMP.unpack_from(data, 4)
    return float(sec + nanosec * 1e-9)


def _names(data: bytes) -> tuple[bytes, list[str]]:
    """The bytes from the frame id to the last of the names, and the names; struct.error where there are none."""
    at = _HEADER + _COUNT.unpack_from(data, 12)[0]
    (count,) = _COUNT.unpack_from(data, at)
    if count > _MOST_NAMES:
        raise struct.error
    at, names = at + 4, []
    for _ in range(count):
        begin = at + 4
        at = begin + _COUNT.unpack_from(data, at)[0]
        if at > len(data):
            raise struct.error
        names.append(data[begin:at].decode())
    return data[12:at], names


def _skipped(data: bytes, at: int) -> tuple[int, int]:
    """Where a sequence of doubles ends, and how many there are; struct.error where it ends beyond the data."""
    (count,) = _COUNT.unpack_from(data, at)
    end = at + 4 + 8 * count
    if end > len(data):
        raise struct.error
    return end, count
