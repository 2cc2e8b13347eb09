"""Files and streams that a user names: which of them are the same, and what they are called."""

import os
import stat
from pathlib import Path
from typing import Any

from handsight.errors import InvalidFile

STREAMS = ("stdin", "stdout", "stderr")
"""By their numbers."""


def called(stream: Any) -> str:
    """What a stream is called in a message."""
    name = getattr(stream, "name", "stream")
    if isinstance(name, int) and name in range(len(STREAMS)):
        return STREAMS[name]
    return str(name).strip("<>")


def apart(written: Any, what: str, other: Any, whose: str) -> None:
    """Raises InvalidFile where writing `what` to one place would overwrite the other; places are paths and streams.

    Links to one file are one place. A terminal, a pipe or None is no place: nothing there is overwritten.
    """
    place = _place(written)
    if place is not None and place == _place(other):
        name = written if isinstance(written, str | os.PathLike) else called(written)
        raise InvalidFile(f"{name}: {what} would overwrite {whose}")


def _place(given: Any) -> tuple[Any, ...] | None:
    """What two names of the same file have in common."""
    if given is None:
        return None
    named = isinstance(given, str | os.PathLike)
    try:
        found = os.stat(given if named else given.fileno())
    except (OSError, ValueError, AttributeError):  # not yet a file, or never one
        return (os.path.realpath(Path(given)),) if named else None
    return (found.st_dev, found.st_ino) if stat.S_ISREG(found.st_mode) else None
