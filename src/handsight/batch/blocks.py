"""The lines of a stream, read in blocks as they come."""

import codecs
import io
from collections.abc import Iterator

from handsight.errors import InvalidFile
from handsight.files import stream_name

LONGEST = 32_000_000
"""Largest size of a line [bytes]; decoded, it takes up to thirty times as much memory."""
BLOCK_BYTES = 256_000
Source = io.BufferedIOBase


def blocks(source: Source, *, single: bool = False) -> Iterator[list[bytes]]:
    """Yields lists of the lines that are available, without blank ones and line ends; closes the source.

    A byte order mark at the beginning is dropped. A line longer than `LONGEST` is cut to `LONGEST` + 1 bytes, so that
    a reader can refuse it. `single`: the entire source is one line. Raises InvalidFile.
    """
    marks = codecs.BOM_UTF8
    with source:
        try:
            if single:
                yield [source.read(LONGEST + 1 + len(marks)).removeprefix(marks)]
                return
            for lines in _split(source):
                lines[0] = lines[0].removeprefix(marks)
                marks = b""
                if come := [line for line in lines if line.strip() or len(line) > LONGEST]:
                    yield come
        except OSError as error:
            raise InvalidFile(f"{stream_name(source)}: {error.strerror or error}") from None


def _split(source: Source) -> Iterator[list[bytes]]:
    """Yields lists of the complete lines that are available, at least one in each; lines too long are cut."""
    partial = bytearray()
    while block := source.read1(BLOCK_BYTES):
        *lines, rest = block.split(b"\n")
        if lines:
            lines[0] = bytes(partial + lines[0])[: LONGEST + 1]
            partial.clear()
            yield lines
        partial += rest[: LONGEST + 1 - len(partial)]
    yield [bytes(partial)]
