"""A YAML file as plain values that know their lines: every error is `file:line: field: expected ..., got ...`."""

import math
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from handsight import checks
from handsight.errors import InvalidFile, MissingExtra
from handsight.files import read_bytes
from handsight.msgspec_errors import FieldPath as FieldPath
from handsight.msgspec_errors import explain, field_name

LARGEST_FILE = 1 << 20
"""Bytes; a rig is a page or two."""
MOST_VALUES = 5_000
"""In a file, aliases written out: of a few lines they can make billions. A hand of twenty fingers has a thousand, and
so many take the parser a second or two."""
LONGEST_NAME = 200
"""Characters of a field's name in a message."""

Form = TypeVar("Form", bound=msgspec.Struct)


class YamlFile:
    """The values of a file whose outermost is a mapping."""

    def __init__(self, path: Path) -> None:
        """Reads the file; raises InvalidFile where it is no mapping of names to values, MissingExtra."""
        self.path = path
        self._marked = _loaded(path)
        self._count = 0
        try:
            self.values = self._plain(self._marked, ())
        except RecursionError:
            raise InvalidFile(f"{path}: expected YAML, got: too deep") from None

    def read(self, form: type[Form]) -> Form:
        """The file's values in a form; raises InvalidFile for the first that is not as the form wants it."""
        try:
            return msgspec.convert(self.values, form)
        except msgspec.ValidationError as error:
            raise self.wrong(*explain(error, form, self.values)) from None

    def wrong(self, field: FieldPath, said: str) -> InvalidFile:
        """The error that tells what is wrong with a field, at its line."""
        name = field_name(field)[:LONGEST_NAME] or "file"
        return InvalidFile(f"{self.path}:{self.line(field)}: {name}: {said}")

    def line(self, field: FieldPath) -> int:
        """The line of a field; of what it would be in, where it is not there."""
        value, line = self._marked, 1
        for step in field:
            marks = getattr(getattr(value, "lc", None), "data", None) or {}
            try:
                value = value[step]
            except (KeyError, IndexError, TypeError):
                break
            if step in marks:
                line = int(marks[step][0]) + 1
            elif hasattr(value, "lc"):  # merged in from another mapping
                line = int(value.lc.line) + 1
        return line

    def _plain(self, value: Any, field: FieldPath) -> Any:
        """YAML's own mappings, lists and numbers as Python's, aliases written out.

        Raises InvalidFile for too many, for tags, for keys that are no texts and numbers that are not finite.
        """
        self._count += 1
        if self._count > MOST_VALUES:
            raise _too_many(self.path)
        tag = getattr(getattr(value, "tag", None), "value", None)
        if tag is not None:
            raise self.wrong(field, f"expected values without tags, got {checks.brief(str(tag))}")
        if isinstance(value, dict):
            for key in value:
                if not isinstance(key, str):
                    raise self.wrong(field, f"expected names as keys, got {checks.brief(key)} (not quoted?)")
            return {str(key): self._plain(part, (*field, key)) for key, part in value.items()}
        if isinstance(value, list):
            return [self._plain(part, (*field, i)) for i, part in enumerate(value)]
        if isinstance(value, float) and not math.isfinite(value):
            raise self.wrong(field, f"expected a finite number, got {float(value)}")
        for kind in (bool, int, float, str):
            if isinstance(value, kind):
                return kind(value)
        return value


def _loaded(path: Path) -> Any:
    """The file's mapping with the lines of its keys, as ruamel.yaml's CommentedMap."""
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.comments import CommentedMap
        from ruamel.yaml.error import MarkedYAMLError, YAMLError
    except ImportError:
        raise MissingExtra("rig files need ruamel.yaml: pip install 'handsight[robot]'") from None
    try:
        text = read_bytes(path, LARGEST_FILE).decode("utf-8")
    except UnicodeDecodeError:
        raise InvalidFile(f"{path}: expected YAML in UTF-8, got other bytes") from None
    # A value takes one of these or a line; counting them takes no time.
    if (
        sum(line.count(",") + 1 for line in text.splitlines() if not line.lstrip().startswith("#"))
        > MOST_VALUES
    ):
        raise _too_many(path)
    try:
        value = YAML(typ="rt", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        raise InvalidFile(f"{path}{line}: expected YAML, got: {str(error.problem).splitlines()[0]}") from None
    except (ValueError, RecursionError, YAMLError) as error:
        raise InvalidFile(f"{path}: expected YAML, got: {str(error).splitlines()[0]:.200}") from None
    except Exception:  # ruamel's constructors trip over strange tags and merges in many ways
        raise InvalidFile(
            f"{path}: expected YAML, got tags, merges or aliases that stand for nothing"
        ) from None
    if not isinstance(value, CommentedMap):
        raise InvalidFile(f"{path}: expected a mapping of keys to values, got {checks.brief(value)}")
    return value


def _too_many(path: Path) -> InvalidFile:
    return InvalidFile(f"{path}: expected at most {MOST_VALUES} values, got more (aliases of aliases?)")
