"""The base classes of all recording files: raw messages, and the chunks in which they are stored.

A file may be damaged: a length in it is trusted only up to the end of the file, and the size of unpacked data is
bounded.
"""

import math
import mmap
import os
import sys
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, ClassVar, NamedTuple, TypeVar
from zlib import crc32

from handsight.errors import InvalidFile
from handsight.files import open_regular
from handsight.messages import RawMessage
from handsight.messages.decode import rosbags_module

if TYPE_CHECKING:
    from bz2 import BZ2Decompressor

Each = TypeVar("Each")


class ChunkLimits(NamedTuple):
    """`ChunkLimits` bound the unpacked content of a recording [bytes]."""

    max_unpacked: int = 1 << 27  # unpacked size of a chunk; recorders write 1 to 16 MiB
    max_waiting_bytes: int = 1 << 28  # messages that are kept to be sorted, as chunks may overlap in time
    message_overhead: int = 300  # memory of a message besides its data
    spare_unpacked: int = 1 << 28  # unpacked size that any file may have, however short
    spare_message: int = 1 << 24  # unpacked size that any message may have, such as an image of one colour
    max_expansion: int = 200  # unpacked bytes for each of the file; robots' data shrink to a half or a tenth
    piece: int = 1 << 16  # data are unpacked in such pieces, so that those before a fault are kept
    spare_records: int = 100_000  # number of records that any file may hold, however short


CHUNKS = ChunkLimits()

TOO_MANY = "expected at least a byte of the file for each message, got more messages"
UNPACKERS = {
    "zstd": ("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "ZstdDecompressor"),
    "lz4": ("lz4.frame", "LZ4FrameDecompressor"),
    "bz2": ("bz2", "BZ2Decompressor"),
}
"""Module and class by compression; each class has the interface of `bz2.BZ2Decompressor`."""


class Source(ABC):
    """A `Source` is an open recording file."""

    MAGIC: ClassVar[bytes]
    """The first bytes of such a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        """The types of all topics in the file, by topic."""
        self.channels: dict[object, tuple[str, str, str]] = {}
        """Topic, type and encoding, by the channel's key in the file."""
        self.definitions: dict[str, str] = {}
        """The definitions of types that the file carries, by type."""
        self.truncated: str | None = None
        """Where the file ends too early; None: it is complete."""
        self.packed = False
        """Whether each message is compressed on its own, with zstd."""
        self.damage: dict[int, str] = {}
        """Sentences about what could not be read, by the position of its first byte."""
        self.place: Any = None
        """Where the next message is, as a value that can be pickled; None: at the beginning."""

    def __reduce__(self) -> tuple[Any, ...]:
        """A pickled place in a recording has the paths of its files."""
        return Path, (str(self.path),)

    def define(self, key: object, topic: str, kind: str, encoding: str, definition: str = "") -> None:
        """Adds the channel with that key in the file, its type as ROS 1 or ROS 2 writes it."""
        package, _, rest = kind.partition("/")
        self.topics[topic] = kind = f"{package}/msg/{rest}" if rest and "/" not in rest else kind
        if definition:
            self.definitions[kind] = definition
        self.channels[key] = topic, self.topics[topic], encoding

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics in order of log time, from `place` on."""
        for raw in self.stored(wanted):
            if raw.type in self.definitions:
                raw = raw._replace(definition=self.definitions[raw.type])
            if self.packed:
                most = CHUNKS.spare_message + CHUNKS.max_expansion * len(raw.data)
                data, _ = unpacked(raw.data, "zstd", min(CHUNKS.max_unpacked, most))
                raw = raw._replace(data=data)
            yield raw
        self.place = None

    @abstractmethod
    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages as `messages` does, but still compressed if `packed`."""

    @abstractmethod
    def close(self) -> None:
        """Closes the file."""


class Chunk(NamedTuple):
    """A `Chunk` is a part of a file that is read in one go."""

    start: int
    """Log time of its earliest message [ns]."""
    offset: int
    """Position of its first byte in the file."""
    length: int
    """Its number of bytes in the file."""
    compression: str = ""
    """The compression: none, lz4, zstd or bz2; empty: none."""
    size: int = 0
    """Its number of bytes when unpacked, as stated in the file."""
    crc: int = 0
    """CRC-32 of the unpacked bytes; 0: not stated."""


class ChunkedSource(Source):
    """A `ChunkedSource` is a file of chunks: all are found when it is opened, and read one by one later."""

    def __init__(self, path: Path) -> None:
        """Finds the chunks of a file that begins with MAGIC."""
        super().__init__(path)
        with open_regular(path) as file:
            self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._chunks, self._budget = list(self._index()), Budget(len(self.data))
        # A file that was closed has its topics outside the chunks too; in any other they are only inside.
        if self.truncated or not self.topics:
            for chunk in self._chunks:
                self._read(frozenset(), chunk)

    @abstractmethod
    def _index(self) -> Iterable[Chunk]:
        """Returns the chunks in `data`, in order of position; defines the topics, and sets `truncated`."""

    @abstractmethod
    def _parse(self, data: bytes, wanted: Collection[str]) -> tuple[list[RawMessage], str | None]:
        """Returns the messages on the wanted topics in an unpacked chunk, and what is wrong with it (None: nothing)."""

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages in order of log time, unless overlapping chunks hold more than `max_waiting_bytes`."""
        self.place = self.place or [0, Budget(len(self.data)), list[RawMessage](), deque[RawMessage]()]
        begin, self._budget, waiting, ready = self.place
        for chunk in (*sorted(self._chunks, key=lambda chunk: chunk.start), None)[begin:]:
            # Messages from before the next chunk's start are complete; if memory is full, all are yielded.
            size = sum(len(raw.data) + CHUNKS.message_overhead for raw in waiting)
            stop = math.inf if chunk is None or size > CHUNKS.max_waiting_bytes else seconds(chunk.start)
            count = bisect_left(waiting, stop, key=lambda raw: raw.log_time)
            ready.extend(waiting[:count])
            del waiting[:count]
            while ready:
                yield ready.popleft()
            self.place[0] += 1
            if chunk is not None:
                # The sort is stable: for equal times, messages of the earlier chunk stay first.
                waiting += self._read(wanted, chunk)
                waiting.sort(key=lambda raw: raw.log_time)

    def _read(self, wanted: Collection[str], chunk: Chunk) -> list[RawMessage]:
        """Returns the messages of a chunk on the wanted topics, in the order of the file."""
        if (spent := self._budget.spent(chunk)) is not None:
            self.damage[chunk.offset] = f"chunk at byte {chunk.offset}: {spent}; left out"
            return []
        packed = self.data[chunk.offset : chunk.offset + chunk.length]
        data, fault = unpacked(packed, chunk.compression, chunk.size)
        if fault is None and chunk.crc and crc32(data) != chunk.crc:
            data, fault = b"", "its checksum does not match"
        found, wrong = self._parse(data, wanted)
        wrong = wrong if self._budget.records > 0 else TOO_MANY
        if fault or wrong:
            self.damage[chunk.offset] = f"chunk at byte {chunk.offset}: {fault or wrong}"
        return found

    def close(self) -> None:
        self.data.close()


class Budget:
    """A `Budget` limits a file's content by its size, as a few kilobytes may unpack to millions of empty messages."""

    def __init__(self, size: int) -> None:
        self.records = CHUNKS.spare_records + size
        """Number of records that may still be read, as each takes at least a byte of the file."""
        self._bytes = CHUNKS.spare_unpacked + CHUNKS.max_expansion * size

    def spent(self, chunk: Chunk) -> str | None:
        """Counts a chunk, and returns why it must not be read; None: it may."""
        self._bytes -= chunk.size if chunk.compression not in ("", "none") else 0
        if self._bytes < 0:
            most = f"{CHUNKS.max_expansion} times the file's bytes"
            return f"expected at most {most} in all its chunks, got more"
        return None if self.records > 0 else TOO_MANY

    def limited(self, records: Iterable[Each]) -> Iterator[Each]:
        """Yields records while the budget allows, and counts them."""
        for each in records:
            if self.records <= 0:
                return
            self.records -= 1
            yield each


def seconds(nanoseconds: int) -> float:
    """Returns seconds, by the same formula as for messages' stamps, so that equal times are equal numbers."""
    sec, rest = divmod(nanoseconds, 10**9)
    return sec + rest * 1e-9


def unpacked(data: bytes, compression: str, size: int) -> tuple[bytes, str | None]:
    """Returns at most `size` bytes that `data` unpacks to, and what is wrong (None: nothing); raises MissingExtra."""
    if size > CHUNKS.max_unpacked:
        return b"", f"says it unpacks to {size} bytes, at most {CHUNKS.max_unpacked} are read"
    if compression in ("", "none"):
        return data[:size], None if len(data) >= size else f"expected {size} bytes, got {len(data)}"
    if compression not in UNPACKERS:
        return b"", f"expected compression none, lz4, zstd or bz2, got {compression[:20]!r}"
    module, name = UNPACKERS[compression]
    new = getattr(rosbags_module(module), name)
    out, pieces = bytearray(), (data[at : at + CHUNKS.piece] for at in range(0, len(data), CHUNKS.piece))
    try:
        for part in _unpack(new, pieces, size):
            out += part
    except Exception as error:  # each library has its own for broken data; the data before them are kept
        return bytes(out), f"cannot be unpacked beyond {len(out)} of {size} bytes ({error})"
    return bytes(out), None if len(out) == size else f"expected {size} bytes, got {len(out)}"


def unpack_file(path: Path, unpacked_file: BinaryIO) -> None:
    """Unpacks a file compressed with zstd into another, up to the first damage.

    Raises InvalidFile for another format, and if it unpacks to far more than a recording would.
    """
    module, name = UNPACKERS["zstd"]
    new = getattr(rosbags_module(module), name)
    with open_regular(path) as file:
        most = CHUNKS.spare_unpacked + CHUNKS.max_expansion * os.fstat(file.fileno()).st_size
        try:
            for part in _unpack(new, iter(lambda: file.read(CHUNKS.piece), b""), most + 1):
                unpacked_file.write(part)
        except OSError:
            raise
        except Exception as error:  # the library's own; the data before it are kept
            if not unpacked_file.tell():
                raise InvalidFile(f"{path}: expected a file compressed by zstd, got none ({error})") from None
    if unpacked_file.tell() > most:
        expected = f"expected at most {CHUNKS.max_expansion} times its bytes when unpacked"
        raise InvalidFile(f"{path}: {expected}, got more")


def _unpack(new: Callable[[], "BZ2Decompressor"], pieces: Iterable[bytes], size: int) -> Iterator[bytes]:
    """Yields the unpacked bytes of consecutive frames, at most `size`; raises the library's errors."""
    unpacker = new()
    for piece in pieces:
        while piece and size > 0:
            yield (out := unpacker.decompress(piece, size))
            size, piece = size - len(out), b""
            if unpacker.eof:  # several frames may follow one another
                piece, unpacker = unpacker.unused_data or b"", new()  # lz4 has None
