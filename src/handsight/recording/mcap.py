"""MCAP files (https://mcap.dev/spec) with messages of ROS 1 or 2, by the package `mcap`: closed or not, cut or indexed.

A file with an index is read chunk by chunk in order of time, any other from its beginning to its end, or to where it is
damaged. The package bounds neither what a chunk unpacks to nor the strings in a record, so chunks are unpacked here.
"""

import io
from bisect import bisect_left
from collections.abc import Collection, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO
from zlib import crc32

from handsight.errors import InvalidFile
from handsight.files import open_regular
from handsight.messages import RawMessage
from handsight.messages.read import rosbags_module
from handsight.recording.source import MAX_UNPACKED, Source, seconds, unpacked

MAX_WAITING = 1 << 28
"""Size of the messages that are kept to be sorted, as chunks may overlap in time [bytes]."""
MESSAGE_OVERHEAD = 300
"""Memory of a message besides its data [bytes]."""
SPARE_UNPACKED = 1 << 28
MAX_EXPANSION = 200
"""A file's messages take at most so many bytes, and so many times its own; robots' data shrink to a half or a tenth."""
FOOTER_LENGTH = 37
"""Of the footer and the magic behind it [bytes]."""
log_time = attrgetter("log_time")


class McapSource(Source):
    """One `.mcap` file."""

    MAGIC = b"\x89MCAP0\r\n"

    def __init__(self, path: Path) -> None:
        """Reads the topics, of a file without an index by reading it all; raises MissingExtra, InvalidFile."""
        super().__init__(path, f"mcap recover {path.name}")
        self._kinds = rosbags_module("mcap.records")
        self._new_reader = rosbags_module("mcap.stream_reader").StreamReader
        self._schemas: dict[int, Any] = {}
        self._channels: dict[int, RawMessage] = {}
        """An empty message on each channel, by its number."""
        self._file = open_regular(path)
        self._size = self._file.seek(0, io.SEEK_END)
        self._index = self._read_index()
        if not self._index:
            for _ in self.stored(()):
                pass

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics in order of log time, unless too many would wait to be sorted."""
        waiting = list[RawMessage]()
        self._budget = SPARE_UNPACKED + MAX_EXPANSION * self._size
        for start, found in self.undamaged(self._chunks(wanted)):
            size = sum(len(each.data) + MESSAGE_OVERHEAD for each in waiting)
            # Messages from before this chunk's start are complete; if memory is full, all are yielded.
            count = len(waiting) if size > MAX_WAITING else bisect_left(waiting, start, key=log_time)
            yield from waiting[:count]
            del waiting[:count]
            # The sort is stable: for equal times, messages of the earlier chunk stay first.
            waiting += found
            waiting.sort(key=log_time)
        yield from waiting

    def close(self) -> None:
        """Closes the file."""
        self._file.close()

    def _read_index(self) -> list[tuple[int, int]]:
        """Returns the start [ns] and the offset of each chunk in order of time; empty: the file has no index."""
        chunks = list[tuple[int, int]]()
        try:
            (footer,) = self._records(max(self._size - FOOTER_LENGTH, len(self.MAGIC)))
            if footer.summary_start == 0:
                return chunks
            for record in self._records(footer.summary_start):
                if isinstance(record, self._kinds.ChunkIndex):
                    chunks.append((record.message_start_time, record.chunk_start_offset))
                self._message(record, ())
        except Exception:  # it was not closed, or is damaged there: reading it to its end will say so
            return []
        return sorted(chunks) if self._channels else []

    def _records(self, begin: int) -> Iterator[Any]:
        """Yields the records of the file from an offset on, chunks still packed."""
        self._file.seek(begin)
        yield from self._reader(self._file).records

    def _reader(self, stream: BinaryIO) -> Any:
        bounded = BoundedStream(stream)
        limit = MAX_UNPACKED
        return self._new_reader(bounded, skip_magic=True, emit_chunks=True, record_size_limit=limit)

    def _chunks(self, wanted: Collection[str]) -> Iterator[tuple[float, list[RawMessage]]]:
        """Yields the start [s] and the wanted messages of each chunk; a message outside chunks is one on its own."""
        records = self._records(len(self.MAGIC))
        if self._index:
            records = (next(self._records(offset)) for _, offset in self._index)
        for record in records:
            if isinstance(record, self._kinds.Chunk):
                yield seconds(record.message_start_time), self._unpacked(record, wanted)
            elif message := self._message(record, wanted):
                yield message.log_time, [message]

    def _unpacked(self, chunk: Any, wanted: Collection[str]) -> list[RawMessage]:
        """Returns the wanted messages of a chunk."""
        size = chunk.uncompressed_size
        self._budget -= size
        if size > MAX_UNPACKED or self._budget < 0:
            raise InvalidFile(f"a chunk unpacks to {size} bytes, more than a recording's does")
        data = unpacked(chunk.data, chunk.compression, size)
        if len(data) < size or chunk.uncompressed_crc not in (0, crc32(data)):
            raise InvalidFile("a chunk's size or checksum does not match")
        found = list[RawMessage]()
        stream = io.BytesIO(data)
        records = self._reader(stream).records
        while stream.tell() < len(data):
            message = self._message(next(records), wanted)
            if message is not None:
                found.append(message)
            self._budget -= MESSAGE_OVERHEAD
            if self._budget < 0:
                raise InvalidFile("more messages than a recording of its size has")
        return found

    def _message(self, record: Any, wanted: Collection[str]) -> RawMessage | None:
        """Returns a wanted message, None for another record; keeps a schema or a channel."""
        if isinstance(record, self._kinds.Message):
            channel = self._channels.get(record.channel_id)
            if channel is None or channel.topic not in wanted:
                return None
            return channel._replace(log_time=seconds(record.log_time), data=record.data)
        if isinstance(record, self._kinds.Schema):
            self._schemas[record.id] = record
        elif isinstance(record, self._kinds.Channel):
            schema = self._schemas.get(record.schema_id)
            kind = "" if schema is None else ros2_name(schema.name)
            definition = "" if schema is None else schema.data.decode("utf-8", "replace")
            empty = RawMessage(record.topic, kind, record.message_encoding, 0.0, b"", definition)
            self._channels[record.id] = empty
            self.topics[record.topic] = kind
        return None


class BoundedStream:
    """A stream of which no more is read at once than a chunk has: a damaged length must not fill the memory."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        """Returns the next bytes; raises InvalidFile for a size below 0 or beyond any chunk's."""
        if not 0 <= size <= MAX_UNPACKED:
            raise InvalidFile(f"a part of {size} bytes, more than a recording has")
        return self._stream.read(size)


def ros2_name(kind: str) -> str:
    """Returns a type's name as ROS 2 writes it: `package/msg/Name`."""
    package, _, rest = kind.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else kind
