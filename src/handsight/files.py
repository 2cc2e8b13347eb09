"""Files and streams named by a user: bounded reading, atomic writing, and their names in messages."""

import contextlib
import io
import os
import secrets
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TextIO

from handsight.errors import InvalidFile, NotWritten

STREAMS = ("stdin", "stdout", "stderr")
"""Names of the standard streams, in the order of their file descriptors."""


def open_regular(path: str | os.PathLike[str], name: str | None = None) -> BinaryIO:
    """Returns a regular file, or a link to one, opened for reading bytes; raises InvalidFile.

    A folder, a device or a pipe is refused without opening it. Messages begin with `name`; None: with the path.
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
    came = "a folder" if stat.S_ISDIR(mode) else "something else"
    raise InvalidFile(f"{name}: expected a file, got {came}")


def read_bytes(path: str | os.PathLike[str], most: int, name: str | None = None) -> bytes:
    """Returns the content of a regular file of at most `most` bytes; raises InvalidFile.

    If the file grows meanwhile, only the part that was there when it was opened is returned. `name`: as for
    `open_regular`.
    """
    with open_regular(path, name) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise InvalidFile(f"{name or path}: expected at most {most} bytes, got {size}")
        try:
            return file.read(size)
        except OSError as error:
            raise InvalidFile(f"{name or path}: cannot be read: {error.strerror or error}") from None


def read_text(path: str | os.PathLike[str], most: int, expected: str = "text in UTF-8") -> str:
    """Returns the text of a regular file of at most `most` bytes, without a byte order mark; raises InvalidFile, which
    says what was `expected`."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidFile(f"{path}: expected {expected}, got other bytes") from None


@contextlib.contextmanager
def write_errors(name: str | os.PathLike[str]) -> Iterator[None]:
    """Converts an OSError raised inside to a NotWritten that begins with the name; a BrokenPipeError stays as it is."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise NotWritten(f"{name}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def atomic_file(path: Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Yields a new file that replaces `path` once it is complete; after an error or Ctrl-C, `path` is unchanged.

    A link stays a link, to the new content. `mode`: the permissions before the umask. Several processes may write the
    same path. Raises OSError.
    """
    final = Path(os.path.realpath(path))
    temporary = final.with_name(f".{final.name}-{secrets.token_hex(8)}.part")
    try:
        with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            yield file
        # Without it, a machine that loses power may keep the name and lose the content.
        with open(temporary, "rb+") as complete:
            os.fsync(complete.fileno())
        os.replace(temporary, final)
    finally:  # it still exists only after an error
        with contextlib.suppress(OSError):
            os.unlink(temporary)


@contextlib.contextmanager
def binary_file(destination: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Yields an `atomic_file`; a pipe or a device, which nothing replaces, is written at once. Raises NotWritten."""
    path = Path(destination)
    with write_errors(destination), atomic_file(path) if _replaceable(path) else path.open("wb") as file:
        yield file


@contextlib.contextmanager
def text_file(destination: str | os.PathLike[str]) -> Iterator[TextIO]:
    """Yields the same as `binary_file`, for text in UTF-8; raises NotWritten."""
    with (
        binary_file(destination) as binary,
        io.TextIOWrapper(binary, encoding="utf-8", newline="") as file,
    ):
        yield file


@contextlib.contextmanager
def growing_file(destination: Path) -> Iterator[TextIO]:
    """Yields a text file for what is answered bit by bit; raises NotWritten.

    It is `part_of(destination)` until it is complete. After an error or Ctrl-C it stays there, unless it is empty; its
    last line may be cut where it could not be written. `destination` is unchanged then.
    """
    growing = part_of(destination)
    final = Path(os.path.realpath(destination))
    with write_errors(destination):
        try:
            with growing.open("w", encoding="utf-8") as file:
                yield file
            if growing != final:
                growing.replace(final)
        finally:
            if growing != final and growing.exists() and not growing.stat().st_size:
                growing.unlink()


def part_of(path: Path) -> Path:
    """Returns the name of a file while it grows: PATH.part; a pipe or a device has no other name."""
    real = Path(os.path.realpath(path))
    return real.with_name(f"{real.name}.part") if _replaceable(real) else real


def _replaceable(path: Path) -> bool:
    return path.is_file() or not path.exists()


def stream_name(stream: object) -> str:
    """Returns the name of a stream, for a message."""
    name = getattr(stream, "name", "stream")
    if isinstance(name, int) and name in range(len(STREAMS)):
        return STREAMS[name]
    return str(name).strip("<>")


def check_not_overwritten(destination: object, what: str, other: object, whose: str) -> None:
    """Raises InvalidFile if writing `what` to `destination` would overwrite the file `other`, which has `whose`.

    `destination` and `other` are paths, streams or None; links to the same file count as equal. Writing to a terminal,
    to a pipe or to None overwrites nothing.
    """
    identity = _file_identity(destination)
    if identity is not None and identity == _file_identity(other):
        name = destination if isinstance(destination, str | os.PathLike) else stream_name(destination)
        raise InvalidFile(f"{name}: {what} would overwrite {whose}")


def _file_identity(place: object) -> tuple[str] | tuple[int, int] | None:
    """Returns a value that is the same for all paths and streams of one file; None where there is no file."""
    try:
        found = os.stat(place if isinstance(place, str | os.PathLike) else place.fileno())  # type: ignore[attr-defined]
    except (OSError, ValueError, AttributeError):  # not yet a file, or never one
        return (os.path.realpath(Path(place)),) if isinstance(place, str | os.PathLike) else None
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None
