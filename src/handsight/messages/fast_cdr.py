"""JointState and WrenchStamped, which come hundreds of times a second, read six times faster than by rosbags.

Little-endian CDR only, and only what is exactly as expected: for all else the answer is None, and rosbags decides.
Alignment is counted from behind the four bytes of encapsulation.
"""

import struct
from collections.abc import Sequence

_LITTLE_ENDIAN = b"\0\1"
_COUNT, _STAMP, _WRENCH = struct.Struct("<I"), struct.Struct("<iI"), struct.Struct("<6d")
_MOST_NAMES = 1000


class FastCdrReader:
    """Reads JointState and WrenchStamped; remembers the names of the last, which seldom change."""

    def __init__(self) -> None:
        self._named, self._names = b"", list[str]()

    def wrench(self, data: bytes) -> tuple[float, Sequence[float]] | None:
        """Stamp [s], and force and torque; None: rosbags must read it."""
        try:
            at = _aligned(16 + _COUNT.unpack_from(data, 12)[0], 8)
            if data[:2] != _LITTLE_ENDIAN or at + _WRENCH.size != len(data):
                return None
            return _stamp(data), _WRENCH.unpack_from(data, at)
        except struct.error:
            return None

    def joints(self, data: bytes) -> tuple[float, Sequence[str], Sequence[float]] | None:
        """Stamp [s], names and positions; None: rosbags must read it."""
        try:
            if data[:2] != _LITTLE_ENDIAN:
                return None
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


def _aligned(at: int, size: int) -> int:
    return at + (4 - at) % size


def _names(data: bytes) -> tuple[bytes, list[str]]:
    """The bytes from the frame id to the last of the names, and the names; struct.error where there are none."""
    at = _aligned(16 + _COUNT.unpack_from(data, 12)[0], 4)
    (count,) = _COUNT.unpack_from(data, at)
    if count > _MOST_NAMES:
        raise struct.error
    at, names = at + 4, []
    for _ in range(count):
        begin = at + 4
        end = begin + _COUNT.unpack_from(data, at)[0]
        if end > len(data) or end == begin or data[end - 1]:
            raise struct.error
        names.append(data[begin : end - 1].decode())
        at = _aligned(end, 4)
    return data[12:at], names


def _skipped(data: bytes, at: int) -> tuple[int, int]:
    """Where a sequence of doubles ends, and how many there are; struct.error where it ends beyond the data."""
    (count,) = _COUNT.unpack_from(data, at)
    end = (_aligned(at + 4, 8) if count else at + 4) + 8 * count
    if end > len(data):
        raise struct.error
    return end, count
