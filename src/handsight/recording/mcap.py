"""MCAP files (https://mcap.dev/spec), whole or cut, with or without a summary.

The chunks' own headers are the index, so a file that was never closed is read as any other.
"""

import mmap
import struct
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path
from zlib import crc32

from handsight.messages.decode import RawMessage
from handsight.recording.chunks import Block, Source, merged, normal_type, seconds, unpacked

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 2, 3, 4, 5, 6
RECORD, TEXT = struct.Struct("<BQ"), struct.Struct("<I")
MESSAGE_HEAD, CHUNK_HEAD = struct.Struct("<HIQQ"), struct.Struct("<QQQI")
LONGEST_RUN = 1 << 20
"""Bytes of messages outside chunks that make one block."""


class McapSource(Source):
    """One `.mcap` file."""

    def __init__(self, path: Path) -> None:
        """Index of its chunks; `path` is known to begin as MCAP does."""
        super().__init__(path)
        with path.open("rb") as file:
            self._data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, str]] = {}
        self._blocks = list(self._index())
        # Whoever closed the file repeated its channels at the end; else they are in the chunks.
        if self.truncated or not self.topics:
            for block in self._blocks:
                self._read(frozenset(), block)

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        return merged(self._blocks, partial(self._read, wanted))

    def close(self) -> None:
        self._data.close()

    def _index(self) -> Iterator[Block]:
        size, run = len(self._data), None
        for op, begin, end in _records(self._data, len(MAGIC), size):
            if run is not None and (op != MESSAGE or begin - run.offset > LONGEST_RUN):
                yield run
                run = None
            if op == CHUNK:
                yield from self._chunk(begin, min(end, size))
            if end > size:
                self.truncated = (
                    f"the file ends at byte {size} in a record that begins at {begin - RECORD.size}"
                    f" and says it goes to {end}"
                )
                break
            if op == FOOTER:
                break
            if op == MESSAGE and end - begin >= MESSAGE_HEAD.size:
                run = self._extended(run, begin, end)
            elif op in (SCHEMA, CHANNEL):
                self._define(op, self._data[begin:end])
        else:
            self.truncated = f"the file ends at byte {size} without MCAP's footer: it was not closed"
        if run is not None:
            yield run

    def _extended(self, run: Block | None, begin: int, end: int) -> Block:
        """The run of messages outside chunks with one more."""
        log = MESSAGE_HEAD.unpack_from(self._data, begin)[2]
        offset = begin - RECORD.size if run is None else run.offset
        start = log if run is None else min(run.start, log)
        return Block(start, offset, end - offset, size=end - offset)

    def _chunk(self, begin: int, end: int) -> Iterator[Block]:
        """The chunk's block, what there is of it."""
        at = begin + CHUNK_HEAD.size + TEXT.size
        if at > end:
            return
        start, _, size, crc = CHUNK_HEAD.unpack_from(self._data, begin)
        name = at + TEXT.unpack_from(self._data, at - TEXT.size)[0]
        if name + 8 <= end:
            length = min(int.from_bytes(self._data[name : name + 8], "little"), end - name - 8)
            compression = self._data[at : min(name, at + 20)].decode("ascii", "replace")
            yield Block(start, name + 8, length, compression, size, crc)

    def _read(self, wanted: Collection[str], block: Block) -> list[RawMessage]:
        packed = self._data[block.offset : block.offset + block.length]
        data, fault = unpacked(packed, block.compression, block.size)
        if fault is None and block.crc and crc32(data) != block.crc:
            data, fault = b"", "its checksum does not match"
        found, read = [], 0
        for op, begin, end in _records(data, 0, len(data)):
            if end > len(data) or op not in (SCHEMA, CHANNEL, MESSAGE):
                break
            read = end
            if op != MESSAGE:
                self._define(op, data[begin:end])
            elif end - begin >= MESSAGE_HEAD.size:
                channel, _, log, _ = MESSAGE_HEAD.unpack_from(data, begin)
                about = self._channels.get(channel)
                if about is not None and about[0] in wanted:
                    found.append(RawMessage(*about, seconds(log), data[begin + MESSAGE_HEAD.size : end]))
        if fault is None and read < len(data):
            fault = f"expected messages, got something else at {read} of {len(data)} bytes"
        if fault is not None:
            self.damage[block.offset] = f"chunk at byte {block.offset}: {fault}"
        return found

    def _define(self, op: int, data: bytes) -> None:
        """Take in a schema or a channel; one that is no such thing is passed over, with its messages."""
        try:
            key = int.from_bytes(data[:2], "little")
            if op == SCHEMA:
                self._schemas[key], _ = _text(data, 2)
                return
            topic, at = _text(data, 4)
            encoding, _ = _text(data, at)
        except (struct.error, UnicodeDecodeError):
            return
        kind = normal_type(self._schemas.get(int.from_bytes(data[2:4], "little"), ""))
        self._channels[key] = (topic, kind, encoding)
        self.topics[topic] = kind


def _records(data: bytes | mmap.mmap, at: int, stop: int) -> Iterator[tuple[int, int, int]]:
    """Kind, first and last byte of each record; the last may say that it ends beyond `stop`."""
    while at + RECORD.size <= stop:
        op, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if op == 0:  # no such kind: a file that was made longer than what was written
            return
        yield op, at, at + length
        at += length


def _text(data: bytes, at: int) -> tuple[str, int]:
    """A string, and where it ends; struct.error where it ends beyond the data."""
    begin = at + TEXT.size
    end = begin + TEXT.unpack_from(data, at)[0]
    if end > len(data):
        raise struct.error
    return data[begin:end].decode(), end
