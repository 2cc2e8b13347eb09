"""Files and streams that a user names: read whole, written, told apart, and what they are called in a message."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from handsight.errors import InvalidFile, NotWritten

STREAMS = ("stdin", "stdout", "stderr")
"""By their numbers."""


def open_regular(path: str | os.PathLike[str], name: str | None = None) -> BinaryIO:
    """A regular file (or a link to one), open to read its bytes; raises InvalidFile, which begins with `name`.

    A folder, a device or a pipe is not even opened. `name`: the path where None.
    """
    name = str(path) if name is None else name
    try:
        mode = Path(path).stat().st_mode
        if stat.S_ISREG(mode):
            return Path(path).open("rb")
    except OSError as error:
        raise InvalidFile(f"{name}: cannot be read: {error.strerror or error}") from None
    except ValueError:  # a null byte in the path
        raise InvalidFile(f"{name!r}: not a path") from None
    raise InvalidFile(
        f"{name}: expected a file, got {'a folder' if stat.S_ISDIR(mode) else 'something else'}"
    )


def read_bytes(path: str | os.PathLike[str], most: int, name: str | None = None) -> bytes:
    """All that is in a regular file of at most so many bytes when it is opened; raises InvalidFile as `open_regular`.

    A file that grows meanwhile is read as far as it was.
    """
    with open_regular(path, name) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise InvalidFile(f"{name or path}: expected at most {most} bytes, got {size}")
        try:
            return file.read(size)
        except OSError as error:
            raise InvalidFile(f"{name or path}: cannot be read: {error.strerror or error}") from None


@contextmanager
def write_errors(name: str | os.PathLike[str]) -> Iterator[None]:
    """What the system refuses within is a NotWritten that begins with the name; that nobody reads is not."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise NotWritten(f"{name}: cannot be written: {error.strerror or error}") from None


def stream_name(stream: Any) -> str:
    """What a stream is called in a message."""
    name = getattr(stream, "name", "stream")
    if isinstance(name, int) and name in range(len(STREAMS)):
        return STREAMS[name]
    return str(name).strip("<>")


def check_not_overwritten(destination: Any, what: str, other: Any, whose: str) -> None:
    """Raises InvalidFile where writing `what` to one place would overwrite the other; places are paths and streams.

    Links to one file are one place. A terminal, a pipe or None is no place: nothing there is overwritten.
    """
    place = _file_identity(destination)
    if place is not None and place == _file_identity(other):
        name = destination if isinstance(destination, str | os.PathLike) else stream_name(destination)
        raise InvalidFile(f"{name}: {what} would overwrite {whose}")


def _file_identity(given: Any) -> tuple[Any, ...] | None:
    """What two names of the same file have in common."""
    if given is None:
        return None
    named = isinstance(given, str | os.PathLike)
    try:
        found = os.stat(given if named else given.fileno())
    except (OSError, ValueError, AttributeError):  # not yet a file, or never one
        return (os.path.realpath(Path(given)),) if named else None
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None
