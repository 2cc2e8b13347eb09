"""MCAP files (https://mcap.dev/spec), complete or cut, with or without a summary.

The index is built from the headers of the chunks, so that a file that was never closed is read like any other.
"""

import mmap
import struct
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from handsight.messages import RawMessage
from handsight.recording.chunks import Chunk, ChunkedSource, seconds

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 2, 3, 4, 5, 6
"""The kinds of records."""
RECORD, TEXT = struct.Struct("<BQ"), struct.Struct("<I")
MESSAGE_HEAD, CHUNK_HEAD = struct.Struct("<HIQQ"), struct.Struct("<QQQI")


class McapSource(ChunkedSource):
    """A `McapSource` is one `.mcap` file."""

    MAGIC = b"\x89MCAP0\r\n"

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, tuple[str, str]] = {}
        super().__init__(path)

    def _index(self) -> Iterator[Chunk]:
        # Consecutive messages outside chunks are read together as chunks of up to a megabyte: `run`.
        size, run = len(self.data), None
        for op, begin, end in _records(self.data, len(self.MAGIC), size):
            if run is not None and (op != MESSAGE or begin - run.offset > 1 << 20):
                yield run
                run = None
            at, stop = begin + CHUNK_HEAD.size + TEXT.size, min(end, size)
            if op == CHUNK and at <= stop:
                start, _, unpacked, crc = CHUNK_HEAD.unpack_from(self.data, begin)
                name = at + TEXT.unpack_from(self.data, at - TEXT.size)[0]
                if name + 8 <= stop:
                    length = min(int.from_bytes(self.data[name : name + 8], "little"), stop - name - 8)
                    compression = self.data[at : min(name, at + 20)].decode("ascii", "replace")
                    yield Chunk(start, name + 8, length, compression, unpacked, crc)
            if end > size:
                record = f"a record that begins at {begin - RECORD.size} and says it goes to {end}"
                self.truncated = f"the file ends at byte {size} in {record}"
                break
            if op == FOOTER:
                break
            if op == MESSAGE and end - begin >= MESSAGE_HEAD.size:
                log = MESSAGE_HEAD.unpack_from(self.data, begin)[2]
                run = run or Chunk(log, begin - RECORD.size, 0)
                length = end - run.offset
                run = run._replace(start=min(run.start, log), length=length, size=length)
            elif op in (SCHEMA, CHANNEL):
                self._take(op, self.data[begin:end])
        else:
            self.truncated = f"the file ends at byte {size} without MCAP's footer: it was not closed"
        if run is not None:
            yield run

    def _parse(self, data: bytes, wanted: Collection[str]) -> tuple[list[RawMessage], str | None]:
        found, read = [], 0
        for op, begin, end in self._budget.limited(_records(data, 0, len(data))):
            if end > len(data) or op not in (SCHEMA, CHANNEL, MESSAGE):
                break
            read = end
            if op != MESSAGE:
                self._take(op, data[begin:end])
            elif end - begin >= MESSAGE_HEAD.size:
                key, _, log, _ = MESSAGE_HEAD.unpack_from(data, begin)
                channel = self.channels.get(key)
                if channel is not None and channel[0] in wanted:
                    found.append(RawMessage(*channel, seconds(log), data[begin + MESSAGE_HEAD.size : end]))
        wrong = f"expected messages, got something else at {read} of {len(data)} bytes"
        return found, wrong if read < len(data) else None

    def _take(self, op: int, data: bytes) -> None:
        """Keeps a schema, or defines a channel; a damaged one is left out, and so are its messages."""
        with suppress(struct.error, UnicodeDecodeError):
            key = int.from_bytes(data[:2], "little")
            if op == SCHEMA:
                name, at = _text(data, 2)
                _, at = _text(data, at)
                self._schemas[key] = name, ""  # the type is known without its definition, too
                self._schemas[key] = name, _text(data, at)[0]
            else:
                topic, at = _text(data, 4)
                kind, definition = self._schemas.get(int.from_bytes(data[2:4], "little"), ("", ""))
                self.define(key, topic, kind, _text(data, at)[0], definition)


def _records(data: bytes | mmap.mmap, at: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Yields the kind, begin and end of each record's data; the last one may end beyond `stop`."""
    while at + RECORD.size <= stop:
        op, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if op == 0:  # not a valid kind: zeros behind what was written to the file
            return
        yield op, at, at + length
        at += length


def _text(data: bytes, at: int) -> tuple[str, int]:
    """Returns a string and its end; raises struct.error if it ends beyond the data."""
    begin = at + TEXT.size
    end = begin + TEXT.unpack_from(data, at)[0]
    if end > len(data):
        raise struct.error
    return data[begin:end].decode(), end
