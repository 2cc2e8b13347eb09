"""Files as they come in and go out: what is no regular file, or larger than any that was meant, is refused unread."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import BinaryIO

from handsight.errors import InvalidFile, NotWritten


def open_regular(path: str | os.PathLike[str], name: str | None = None) -> BinaryIO:
    """A regular file (or a link to one), open to read its bytes; raises InvalidFile, which begins with `name`.

    A folder, a device or a pipe is not even opened. `name`: the path where None.
    """
    name = str(path) if name is None else name
    try:
        mode = Path(path).stat().st_mode
        if S_ISREG(mode):
            return Path(path).open("rb")
    except OSError as error:
        raise InvalidFile(f"{name}: cannot be read: {error.strerror or error}") from None
    except ValueError:  # a null byte in the path
        raise InvalidFile(f"{name!r}: not a path") from None
    raise InvalidFile(f"{name}: expected a file, got {'a folder' if S_ISDIR(mode) else 'something else'}")


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
def written(name: str | os.PathLike[str]) -> Iterator[None]:
    """What the system refuses within is a NotWritten that begins with the name; that nobody reads is not."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise NotWritten(f"{name}: cannot be written: {error.strerror or error}") from None
