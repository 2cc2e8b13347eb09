"""The base class of all recording files, and unpacking within bounds, as a few kilobytes may unpack to gigabytes."""

import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, TypeVar

from handsight.errors import InvalidFile
from handsight.messages import RawMessage
from handsight.messages.read import rosbags_module

MAX_UNPACKED = 1 << 27
"""The largest chunk or message that is unpacked [bytes]; recorders write chunks of 1 to 16 MiB."""
ZSTD = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
UNPACKERS = {
    "zstd": (ZSTD, "ZstdDecompressor"),
    "lz4": ("lz4.frame", "LZ4FrameDecompressor"),
    "bz2": ("bz2", "BZ2Decompressor"),
}
"""Module and class by compression; each class has the interface of `bz2.BZ2Decompressor`."""


Part = TypeVar("Part")


class Source(ABC):
    """An open recording file."""

    MAGIC: ClassVar[bytes]
    """The first bytes of such a file."""

    def __init__(self, path: Path, tool: str) -> None:
        """`tool`: the command that mends such a file."""
        self.path = path
        self.tool = f"`{tool}` may mend it"
        self.topics: dict[str, str] = {}
        """The types of all topics in the file, by topic."""
        self.packed = False
        """Whether each message is compressed on its own, with zstd."""
        self.faults: list[str] = []
        """What could not be read until now, in words."""

    def messages(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages on the wanted topics in order of log time, up to the first damage."""
        for raw in self.stored(wanted):
            if not self.packed:
                yield raw
                continue
            data = b""
            with suppress(
                Exception
            ):  # a damaged message is empty, and is counted as one that cannot be decoded
                data = unpacked(raw.data, "zstd", MAX_UNPACKED)
            yield raw._replace(data=data)

    def undamaged(self, parts: Iterator[Part]) -> Iterator[Part]:
        """Yields parts of the file up to the first damage, which is reported; once, as a file may be read twice."""
        try:
            yield from parts
        except (
            Exception
        ) as error:  # rosbags and mcap raise anything where the bytes are not as they should be
            reason = str(error) or "it ends there, as it was cut or not closed"
            fault = f"damaged, and read only up to there: {reason}; {self.tool}"
            if fault not in self.faults:
                self.faults.append(fault)

    @abstractmethod
    def stored(self, wanted: Collection[str]) -> Iterator[RawMessage]:
        """Yields the messages as `messages` does, but still compressed if `packed`."""

    @abstractmethod
    def close(self) -> None:
        """Closes the file."""


def unpacked(data: bytes, compression: str, most: int) -> bytes:
    """Returns at most `most` bytes that `data` unpacks to; of data that were cut, those before the cut.

    Raises InvalidFile for an unknown compression, MissingExtra, and whatever a library raises for damaged data.
    """
    if compression in ("", "none"):
        return data[:most]
    if compression not in UNPACKERS:
        raise InvalidFile(f"expected compression none, lz4, zstd or bz2, got {compression[:20]!r}")
    module, name = UNPACKERS[compression]
    unpacker = getattr(rosbags_module(module), name)()
    return bytes(unpacker.decompress(data, most))


def seconds(nanoseconds: int) -> float:
    """Returns seconds, by the same formula as for messages' stamps, so that equal times are equal numbers."""
    sec, rest = divmod(nanoseconds, 10**9)
    return sec + rest * 1e-9
