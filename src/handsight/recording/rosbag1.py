"""Bags of ROS 1, complete or cut, with or without an index (http://wiki.ros.org/Bags/Format/2.0)."""

import mmap
import struct
from collections.abc import Collection, Iterator

from handsight.messages import RawMessage
from handsight.recording.chunks import Chunk, ChunkedSource

MESSAGE, BAG, INDEX, CHUNK, CONNECTION = b"\2", b"\3", b"\4", b"\5", b"\7"
LENGTH, TIME, ENTRY = struct.Struct("<I"), struct.Struct("<II"), struct.Struct("<III")

Fields = dict[bytes, bytes]


class Rosbag1Source(ChunkedSource):
    """A `Rosbag1Source` is one `.bag` file."""

    MAGIC = b"#ROSBAG V2.0\n"

    def _index(self) -> list[Chunk]:
        size, chunks, closed, at = len(self.data), list[Chunk](), False, len(self.MAGIC)
        first = True  # whether the next index record is the first behind its chunk
        for fields, begin, at in _records(self.data, len(self.MAGIC), size):
            op = fields.get(b"op")
            if op == BAG:
                # The index's position replaces a placeholder of 0 when the bag is closed.
                closed = 0 < int.from_bytes(fields.get(b"index_pos", b"")[:8], "little") < size
            elif op == CHUNK:
                # Until its index is read, a chunk has the start of the chunk before it.
                start, length = chunks[-1].start if chunks else 0, min(at, size) - begin
                compression = fields.get(b"compression", b"")[:20].decode("ascii", "replace")
                unpacked = int.from_bytes(fields.get(b"size", b"")[:8], "little")
                chunks.append(Chunk(start, begin, length, compression, unpacked))
                first = True
            elif op == INDEX and chunks and at <= size:
                entries = ENTRY.iter_unpack(self.data[begin : at - (at - begin) % ENTRY.size])
                times = (sec * 10**9 + nanosec for sec, nanosec, _ in entries)
                earliest = min(times, default=chunks[-1].start)
                chunks[-1] = chunks[-1]._replace(start=earliest if first else min(earliest, chunks[-1].start))
                first = False
            elif op == CONNECTION and at <= size:
                self._take(fields, self.data[begin:at])
        if at != size:
            self.truncated = f"the file ends at byte {size} in the middle of a record"
        elif not closed:
            self.truncated = f"the file ends at byte {size} without an index: it was not closed"
        return chunks

    def _parse(self, data: bytes, wanted: Collection[str]) -> tuple[list[RawMessage], str | None]:
        found, end = [], 0
        for fields, begin, end in self._budget.limited(_records(data, 0, len(data))):
            op = fields.get(b"op")
            if end > len(data):
                break
            if op == CONNECTION:
                self._take(fields, data[begin:end])
            elif op == MESSAGE:
                channel, time = self.channels.get(fields.get(b"conn")), fields.get(b"time", b"")
                if channel is not None and channel[0] in wanted and len(time) == TIME.size:
                    sec, nanosec = TIME.unpack(time)
                    found.append(RawMessage(*channel, sec + nanosec * 1e-9, data[begin:end]))
        wrong = "expected complete messages, got a record that ends beyond the chunk"
        return found, wrong if end != len(data) else None

    def _take(self, fields: Fields, data: bytes) -> None:
        """Defines a connection; a damaged one is left out, and so are its messages."""
        about = _fields(data)
        if b"conn" in fields and b"topic" in fields and b"type" in about:
            topic, kind = (name.decode("utf-8", "replace") for name in (fields[b"topic"], about[b"type"]))
            definition = about.get(b"message_definition", b"").decode("utf-8", "replace")
            self.define(fields[b"conn"], topic, kind, "ros1", definition)


def _records(data: bytes | mmap.mmap, at: int, stop: int) -> Iterator[tuple[Fields, int, int]]:
    """Yields the header, begin and end of each record's data; the last one may end beyond `stop`."""
    while at + LENGTH.size <= stop:
        begin = at + LENGTH.size + LENGTH.unpack_from(data, at)[0]
        if begin + LENGTH.size > stop or begin - at > 1 << 20:  # no header is longer than a megabyte
            yield {}, stop, stop + 1
            return
        fields = _fields(data[at + LENGTH.size : begin])
        at = begin + LENGTH.size + LENGTH.unpack_from(data, begin)[0]
        yield fields, begin + LENGTH.size, at


def _fields(header: bytes) -> Fields:
    """Returns the `name=value` pairs of a header, up to the first damaged one."""
    fields, at = {}, 0
    while at + LENGTH.size <= len(header):
        end = at + LENGTH.size + LENGTH.unpack_from(header, at)[0]
        name, equals, value = header[at + LENGTH.size : end].partition(b"=")
        if end > len(header) or not equals:
            break
        fields[name] = value
        at = end
    return fields
