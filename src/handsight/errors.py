"""The exceptions for wrong inputs: each message names the input, what was expected and what came."""

import re
from collections.abc import Iterator
from contextlib import contextmanager


def without_addresses(text: str) -> str:
    """Returns `text` without memory addresses, so that equal problems have equal messages and are counted as one."""
    return re.sub(r"(?<=[\w)]) at 0x[0-9a-fA-F]+(?=>)", "", text)


def printable(text: str) -> str:
    """Returns `text` in one line of at most 1000 characters, with escapes such as \\x1b for unprintable ones."""
    text = without_addresses(text)
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return text if len(text) <= 1000 else text[:996] + " ..."  # a message quotes what came, which may be long


class HandsightError(Exception):
    """The base class of every error about an input; catching it catches them all."""

    def __init__(self, message: str = "") -> None:
        """The message is made `printable`, because parts of it come from files, topics and arguments."""
        super().__init__(printable(message))

    @property
    def field(self) -> str:
        """The input that the message names: what stands before its first ": "; "" where it names none."""
        name, colon, _ = str(self).partition(": ")
        return name if colon else ""


class InvalidInput(HandsightError, ValueError):
    """An argument has the wrong shape, unit or range, or is not finite."""


class InvalidTransform(InvalidInput):
    """A 4 x 4 array is not a rigid transform."""


class InvalidObject(HandsightError, ValueError):
    """No object model can be made from a mesh, a point cloud or a size."""


class InvalidFile(HandsightError, ValueError):
    """A file cannot be read as what it should be; the message starts with the file's name."""

    @property
    def field(self) -> str:
        """The field or line that the message names after the file; the file's name where it names neither.

        A field has no blank, as `skin.palm.layout`; other words after the file's name are no field.
        """
        file = super().field
        name, colon, _ = str(self).removeprefix(f"{file}: ").partition(": ")
        return name if colon and re.match(r"line \d|\S+$", name) else file


class NotWritten(InvalidFile):
    """A file or a stream cannot be written: the disk is full, the folder is missing, or permission is denied."""


class NotFound(HandsightError):
    """An object was not found by touch, or no grasp of it; the message says what is known, and what is still open."""


class MissingExtra(HandsightError, ImportError):
    """An optional dependency is not installed; the message names the `pip install` that brings it."""


@contextmanager
def needing(need: str, extra: str) -> Iterator[None]:
    """Imports in this context belong to an extra of handsight; raises MissingExtra, which says the need, without it."""
    try:
        yield
    except ImportError:
        raise MissingExtra(f"{need}: pip install 'handsight[{extra}]'") from None
