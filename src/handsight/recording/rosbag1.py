"""Bags of ROS 1 (format 2.0), complete or cut, indexed or not: http://wiki.ros.org/Bags/Format/2.0."""

import mmap
import struct
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

from handsight.messages import RawMessage
from handsight.recording.chunks import Chunk, ChunkedSource, normal_type

MESSAGE, BAG, INDEX, CHUNK, CONNECTION = 2, 3, 4, 5, 7
LENGTH, TIME, ENTRY = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<III")
MAX_HEADER = 1 << 20
"""Bytes; a connection's header holds the definition of its type, and that is its data."""

Fields = dict[bytes, bytes]


class Rosbag1Source(ChunkedSource):
    """One `.bag` file."""

    MAGIC = b"#ROSBAG V2.0\n"

    def __init__(self, path: Path) -> None:
        self._connections: dict[bytes, tuple[str, str]] = {}
        super().__init__(path)

    def _index(self) -> list[Chunk]:
        size, chunks, starts = len(self.data), list[Chunk](), list[int]()
        closed, at = False, len(self.MAGIC)
        for fields, begin, at in _records(self.data, len(self.MAGIC), size):
            op = _op(fields)
            if op == BAG:
                # Written last, over a placeholder: a recorder that died left 0.
                closed = 0 < int.from_bytes(fields.get(b"index_pos", b"")[:8], "little") < size
            elif op == CHUNK:
                # Without an index behind it, a chunk comes after the one before.
                chunks.append(self._chunk(fields, begin, min(at, size), chunks[-1].start if chunks else 0))
                starts.clear()
            elif op == INDEX and chunks and at <= size:
                starts += _earliest(self.data[begin:at])
                if starts:
                    chunks[-1] = replace(chunks[-1], start=min(starts))
            elif op == CONNECTION and at <= size:
                self._define(fields, self.data[begin:at])
        if at != size:
            self.truncated = f"the file ends at byte {size} in the middle of a record"
        elif not closed:
            self.truncated = f"the file ends at byte {size} without an index: it was not closed"
        return chunks

    def _chunk(self, fields: Fields, begin: int, end: int, start: int) -> Chunk:
        compression = fields.get(b"compression", b"")[:20].decode("ascii", "replace")
        size = int.from_bytes(fields.get(b"size", b"")[:8], "little")
        return Chunk(start, begin, end - begin, compression, size)

    def _parse(self, data: bytes, wanted: Collection[str]) -> tuple[list[RawMessage], str | None]:
        found, end = [], 0
        for fields, begin, end in _records(data, 0, len(data)):
            op = _op(fields)
            if end > len(data):
                break
            if op == CONNECTION:
                self._define(fields, data[begin:end])
            elif op == MESSAGE:
                connection = self._connections.get(fields.get(b"conn", b""))
                time = fields.get(b"time", b"")
                if connection is not None and connection[0] in wanted and len(time) == TIME.size:
                    sec, nanosec = TIME.unpack(time)
                    log = sec + nanosec * 1e-9
                    found.append(RawMessage(*connection, "ros1", log, data[begin:end]))
        wrong = "expected whole messages, got a record that ends beyond the chunk"
        return found, wrong if end != len(data) else None

    def _define(self, fields: Fields, data: bytes) -> None:
        """Take in a connection; one that is no such thing is passed over, with its messages."""
        about = _fields(data)
        if b"conn" in fields and b"topic" in fields and b"type" in about:
            topic = fields[b"topic"].decode("utf-8", "replace")
            kind = normal_type(about[b"type"].decode("utf-8", "replace"))
            self._connections[fields[b"conn"]] = (topic, kind)
            self.topics[topic] = kind


def _records(data: bytes | mmap.mmap, at: int, stop: int) -> Iterator[tuple[Fields, int, int]]:
    """Header, first and last byte of each record's data; the last may say that it ends beyond `stop`."""
    while at + LENGTH.size <= stop:
        begin = at + LENGTH.size + LENGTH.unpack_from(data, at)[0]
        if begin + LENGTH.size > stop or begin - at > MAX_HEADER:
            yield {}, stop, stop + 1
            return
        fields = _fields(data[at + LENGTH.size : begin])
        at = begin + LENGTH.size + LENGTH.unpack_from(data, begin)[0]
        yield fields, begin + LENGTH.size, at


def _fields(header: bytes) -> Fields:
    """`name=value` pairs, up to the first that is none."""
    fields, at = {}, 0
    while at + LENGTH.size <= len(header):
        end = at + LENGTH.size + LENGTH.unpack_from(header, at)[0]
        name, equals, value = header[at + LENGTH.size : end].partition(b"=")
        if end > len(header) or not equals:
            break
        fields[name] = value
        at = end
    return fields


def _op(fields: Fields) -> int:
    return int.from_bytes(fields.get(b"op", b"")[:1], "little")


def _earliest(index: bytes) -> list[int]:
    """The earliest time [ns] in the index of a connection's messages in a chunk; empty: it has none."""
    stop = len(index) - len(index) % ENTRY.size
    times = (sec * 10**9 + nanosec for sec, nanosec, _ in ENTRY.iter_unpack(index[:stop]))
    earliest = min(times, default=None)
    return [] if earliest is None else [earliest]
