"""What can be wrong with an input. Each message names the argument, what was expected and what came."""

import re

MOST_CHARACTERS = 1000
"""Of a message: it quotes what came, which may be anything."""
_ADDRESS = re.compile(r"(?<=[\w)]) at 0x[0-9a-fA-F]+(?=>)")


def without_addresses(text: str) -> str:
    """`text` without where its objects are, as Python's `repr` says: messages are counted, and it is never the same."""
    return _ADDRESS.sub("", text)


def printable(text: str) -> str:
    """`text` in one line, with escapes such as \\x1b for what a terminal would obey or an encoding refuses."""
    text = without_addresses(text)
    if not text.isprintable():
        text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return text if len(text) <= MOST_CHARACTERS else text[: MOST_CHARACTERS - 4] + " ..."


class HandsightError(Exception):
    """Any input that handsight refuses; catch this to catch them all."""

    def __init__(self, message: str = "") -> None:
        """The message is kept as `printable`: parts of it come from files, topics and arguments."""
        super().__init__(printable(message))


class InvalidInput(HandsightError, ValueError):
    """An argument has the wrong shape, unit, range or is not finite."""


class InvalidTransform(InvalidInput):
    """A 4 x 4 array is not a rigid transform."""


class InvalidObject(HandsightError, ValueError):
    """A mesh, a cloud or a size from which no object model can be made."""


class InvalidFile(HandsightError, ValueError):
    """A file that cannot be read as what it should be; the message starts with its name."""


class NotWritten(InvalidFile):
    """A file or a stream that cannot be written: a full disk, a folder that is not there, no permission."""


class MissingExtra(HandsightError, ImportError):
    """An optional dependency is not installed; the message says which `pip install` brings it."""
