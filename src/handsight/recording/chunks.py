"""The base of all kinds of recording files: raw messages, and the chunks that they are stored in.

Files may be hostile: no length is trusted beyond the file's own, nothing is unpacked beyond a limit.
"""

import math
import mmap
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, ClassVar, NamedTuple, TypeVar
from zlib import crc32

from handsight.errors import InvalidFile
from handsight.files import open_regular
from handsight.messages import RawMessage
from handsight.messages.decode import rosbags_module

if TYPE_CHECKING:
    from bz2 import BZ2Decompressor

Each = TypeVar("Each")


class ChunkLimits(NamedTuple):
    """`ChunkLimits` say how much a recording may unpack to."""

    max_unpacked: int = 1 << 27  # bytes that a chunk may unpack to; recorders write 1 to 16 MiB
    max_waiting_bytes: int = 1 << 28  # bytes that overlapping chunks may hold back until their turn
    message_overhead: int = 300  # about the bytes that a message takes besides its own
    spare_records: int = 100_000  # records that any file may hold
    spare_unpacked: int = 1 << 28  # bytes that any file may unpack to
    max_expansion: int = 200  # bytes for each of its own; robots' data packs to a half or a tenth
    spare_message: int = 1 << 24  # bytes that any message may unpack to: an image of one colour
    max_topics: int = 100_000  # in a file; more are passed over
    piece: int = 1 << 16  # bytes unpacked at a time: what came before a fault is kept


CHUNKS = ChunkLimits()

TOO_MANY = "expected at least a byte of the file for each message, got more messages"
UNPACKERS = {
    "zstd": ("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd", "ZstdDecompressor"),
    "lz4": ("lz4.frame", "LZ4FrameDecompressor"),
    "bz2": ("bz2", "BZ2Decompressor"),
}
"""Module and class, each with the interface of `bz2.BZ2Decompressor`, by compression."""


class Source(ABC):
    """A `Source` is an open recording file."""

    MAGIC: ClassVar[bytes]
    """First bytes of such a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[str, str] = {}
        """Type by topic, of all topics in the file."""
        self.channels: dict[object, tuple[str, str, str]] = {}
        """Topic, type and encoding by the file's key for them."""
        self.truncated: str | None = None
        """Where the file ends too early; None: it is complete."""
        self.packed = False
        """Whether each message is compressed by itself, by zstd."""
        self.damage: dict[int, str] = {}
        """What could not be read, by its byte."""

    def define(self, key: object, topic: str, kind: str, encoding: str) -> None:
        """Adds a topic and its type, as ROS 1 or ROS 2 writes it, by the file's key for them."""
        if topic not in self.topics and len(self.topics) >= CHUNKS.max_topics:
            self.damage[-1] = f"expected at most {CHUNKS.max_topics} topics, got more, which were left out"
            return
        package, _, rest = kind.partition("/")
        self.topics[topic] = f"{package}/msg/{rest}" if rest and "/" not in rest else kind
        self.channels[key] = topic, self.topics[topic], encoding

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics in order of log time; each call begins again."""
        for raw in self.stored(wanted):
            if self.packed:
                most = CHUNKS.spare_message + CHUNKS.max_expansion * len(raw.data)
                data, _ = unpacked(raw.data, "zstd", min(CHUNKS.max_unpacked, most))
                raw = raw._replace(data=data)
            yield raw

    @abstractmethod
    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages as `messages` does, each as it is stored in the file."""

    @abstractmethod
    def close(self) -> None:
        """Closes the file."""


class Chunk(NamedTuple):
    """A `Chunk` is a part of the file that is read at once."""

    start: int
    """Log time of its earliest message [ns]."""
    offset: int
    """Its first byte in the file."""
    length: int
    """Its number of bytes in the file."""
    compression: str = ""
    """none, lz4, zstd or bz2; empty: none."""
    size: int = 0
    """Its number of bytes when unpacked, as the file says."""
    crc: int = 0
    """CRC-32 of the unpacked bytes; 0: not given."""


class ChunkedSource(Source):
    """A `ChunkedSource` is a file of chunks: all are found first, and each is read in its turn."""

    def __init__(self, path: Path) -> None:
        """Finds the chunks of a file that begins with MAGIC."""
        super().__init__(path)
        with open_regular(path) as file:
            self.data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        self._chunks, self._budget = list(self._index()), Budget(len(self.data))
        # A file that was closed repeats its topics outside the chunks; else they are only in them.
        if self.truncated or not self.topics:
            for chunk in self._chunks:
                self._read(frozenset(), chunk)

    @abstractmethod
    def _index(self) -> Iterable[Chunk]:
        """Returns the chunks in `data`, in order of bytes; sets the topics, and where the file ends too early."""

    @abstractmethod
    def _parse(self, data: bytes, wanted: Collection[str]) -> tuple[list[RawMessage], str | None]:
        """Returns the messages of an unpacked chunk on the wanted topics, and what is wrong with it (None: nothing)."""

    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields as `Source.stored`, as far as `max_waiting_bytes` reaches."""
        self._budget = Budget(len(self.data))
        runs, buffered, order = list[Run](), 0, count()
        for chunk in (*sorted(self._chunks, key=lambda chunk: chunk.start), None):
            stop = math.inf if chunk is None or buffered > CHUNKS.max_waiting_bytes else seconds(chunk.start)
            while runs and runs[0].head < stop:
                run = heappop(runs)
                next_stop = min(stop, runs[0].head if runs else math.inf)
                yield run.waiting.pop()
                while run.waiting and run.waiting[-1].log_time < next_stop:
                    yield run.waiting.pop()
                if run.waiting:
                    heappush(runs, run._replace(head=run.waiting[-1].log_time))
                else:
                    buffered -= run.size
            if chunk is not None and (found := self._read(wanted, chunk)):
                found.reverse()  # what is first can be taken off the end, and of equal times stays first
                found.sort(key=lambda raw: raw.log_time, reverse=True)
                size = sum(len(raw.data) + CHUNKS.message_overhead for raw in found)
                heappush(runs, Run(found[-1].log_time, next(order), found, size))
                buffered += size

    def _read(self, wanted: Collection[str], chunk: Chunk) -> list[RawMessage]:
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


class Run(NamedTuple):
    """A `Run` is the messages of a chunk that wait for earlier ones of other chunks."""

    head: float
    """Log time of the first [s]."""
    order: int
    """Of equal times, the chunk that began earlier goes first."""
    waiting: list[RawMessage]
    """The first at the end."""
    size: int
    """About the bytes they hold."""


class Budget:
    """A `Budget` limits what a file of so many bytes may hold: a few kilobytes can be millions of empty messages."""

    def __init__(self, size: int) -> None:
        self.records = CHUNKS.spare_records + size
        """Number of messages that may still be read: none is packed into less than a byte."""
        self._bytes = CHUNKS.spare_unpacked + CHUNKS.max_expansion * size

    def spent(self, chunk: Chunk) -> str | None:
        """Returns why the chunk is not to be read; None: it is, and counts."""
        self._bytes -= chunk.size if chunk.compression not in ("", "none") else 0
        if self._bytes < 0:
            return (
                f"expected at most {CHUNKS.max_expansion} times the file's bytes in all its chunks, got more"
            )
        return None if self.records > 0 else TOO_MANY

    def limited(self, records: Iterable[Each]) -> Iterator[Each]:
        """Yields as many of the records as may still be read."""
        left = self.records
        try:
            for after, each in zip(range(self.records - 1, -1, -1), records, strict=False):
                left = after
                yield each
        finally:
            self.records = left


def seconds(nanoseconds: int) -> float:
    """Returns seconds by the formula of messages' stamps, so that equal times are equal numbers."""
    sec, rest = divmod(nanoseconds, 10**9)
    return sec + rest * 1e-9


def unpacked(data: bytes, compression: str, size: int) -> tuple[bytes, str | None]:
    """Returns at most `size` bytes that `data` unpacks to, and what is wrong with them (None: nothing); raises
    MissingExtra."""
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
    except Exception as error:  # each library has errors of its own on broken bytes; what came before is kept
        return bytes(out), f"cannot be unpacked beyond {len(out)} of {size} bytes ({error})"
    return bytes(out), None if len(out) == size else f"expected {size} bytes, got {len(out)}"


def unpack_file(path: Path, unpacked_file: BinaryIO) -> None:
    """Writes what a file compressed by zstd unpacks to, up to its damage; raises InvalidFile for a bomb."""
    module, name = UNPACKERS["zstd"]
    new = getattr(rosbags_module(module), name)
    with open_regular(path) as file:
        most = CHUNKS.spare_unpacked + CHUNKS.max_expansion * os.fstat(file.fileno()).st_size
        try:
            for part in _unpack(new, iter(lambda: file.read(CHUNKS.piece), b""), most + 1):
                unpacked_file.write(part)
        except OSError:
            raise
        except Exception as error:  # the library's own; what came before is kept
            if not unpacked_file.tell():
                raise InvalidFile(f"{path}: expected a file compressed by zstd, got none ({error})") from None
    if unpacked_file.tell() > most:
        raise InvalidFile(
            f"{path}: expected at most {CHUNKS.max_expansion} times its bytes when unpacked, got more"
        )


def _unpack(new: Callable[[], "BZ2Decompressor"], pieces: Iterable[bytes], size: int) -> Iterator[bytes]:
    """Yields the bytes that consecutive frames unpack to, at most `size` of them; raises the library's errors."""
    unpacker = new()
    for piece in pieces:
        while piece and size > 0:
            yield (out := unpacker.decompress(piece, size))
            size, piece = size - len(out), b""
            if unpacker.eof:  # several frames may follow one another
                piece, unpacker = unpacker.unused_data or b"", new()  # lz4 has None
