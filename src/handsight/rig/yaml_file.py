"""A YAML file as plain values that know their lines: every error is `file:line: field: expected ..., got ...`."""

import math
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from handsight import checks
from handsight.errors import InvalidFile, MissingExtra
from handsight.explain import Path as FieldPath
from handsight.explain import explain, named

LARGEST_FILE = 1 << 20
"""Bytes; a rig is a page or two."""
MOST_VALUES = 50_000
"""In a file, aliases written out: of a few lines they can make billions."""

Form = TypeVar("Form", bound=msgspec.Struct)


class YamlFile:
    """The values of a file whose outermost is a mapping."""

    def __init__(self, path: Path) -> None:
        """Reads the file; raises InvalidFile where it is no mapping of names to values, MissingExtra."""
        self.path = path
        self._marked = _loaded(path)
        try:
            size = _size(self._marked, path, {})
        except RecursionError:
            raise InvalidFile(f"{path}: expected YAML, got: too deep") from None
        if size > MOST_VALUES:
            raise InvalidFile(
                f"{path}: expected at most {MOST_VALUES} values, got more (aliases of aliases?)"
            )
        self.values = self._plain(self._marked, ())

    def read(self, form: type[Form]) -> Form:
        """The file's values in a form; raises InvalidFile for the first that is not as the form wants it."""
        try:
            return msgspec.convert(self.values, form)
        except msgspec.ValidationError as error:
            raise self.wrong(*explain(error, form, self.values)) from None

    def wrong(self, field: FieldPath, said: str) -> InvalidFile:
        """The error that tells what is wrong with a field, at its line."""
        return InvalidFile(f"{self.path}:{self.line(field)}: {named(field) or 'file'}: {said}")

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
        """YAML's own mappings, lists and numbers as Python's; raises InvalidFile for numbers that are not finite."""
        if isinstance(value, dict):
            return {str(key): self._plain(part, (*field, key)) for key, part in value.items()}
        if isinstance(value, list):
            return [self._plain(part, (*field, i)) for i, part in enumerate(value)]
        if isinstance(value, bool):
            return value
        if isinstance(value, int) and value.bit_length() > 64:
            raise self.wrong(
                field, f"expected a finite number, got a whole number of {value.bit_length()} bits"
            )
        if isinstance(value, float) and not math.isfinite(value):
            raise self.wrong(field, f"expected a finite number, got {float(value)}")
        for kind in (int, float, str):
            if isinstance(value, kind):
                return kind(value)
        return value


def _loaded(path: Path) -> Any:
    """The file's mapping with the lines of its keys, as ruamel.yaml's CommentedMap."""
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.comments import CommentedMap
        from ruamel.yaml.error import MarkedYAMLError
    except ImportError:
        raise MissingExtra("rig files need ruamel.yaml: pip install 'handsight[robot]'") from None
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InvalidFile(f"{path}: {error.strerror}") from None
    if len(data) > LARGEST_FILE:
        raise InvalidFile(f"{path}: expected a rig of at most {LARGEST_FILE} bytes, got {len(data)}")
    try:
        value = YAML(typ="rt", pure=True).load(data.decode("utf-8"))
    except UnicodeDecodeError:
        raise InvalidFile(f"{path}: expected YAML in UTF-8, got other bytes") from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f":{mark.line + 1}" if mark is not None else ""
        raise InvalidFile(f"{path}{line}: expected YAML, got: {str(error.problem).splitlines()[0]}") from None
    except Exception as error:  # ruamel's constructors trip over strange tags and merges in many ways
        said = str(error) or "too deep"
        raise InvalidFile(f"{path}: expected YAML, got: {said.splitlines()[0]:.200}") from None
    if not isinstance(value, CommentedMap):
        raise InvalidFile(f"{path}: expected a mapping of keys to values, got {checks.brief(value)}")
    return value


def _size(value: Any, path: Path, known: dict[int, int], line: int = 1) -> int:
    """How many values it holds, aliases written out; raises InvalidFile for tags, and for keys that are no texts.

    `line`: of what it is in, for single values, of which ruamel keeps none.
    """
    if isinstance(value, dict | list):
        line = int(getattr(getattr(value, "lc", None), "line", line - 1)) + 1
    tag = getattr(getattr(value, "tag", None), "value", None)
    if tag is not None:
        raise InvalidFile(f"{path}:{line}: expected values without tags, got {checks.brief(str(tag))}")
    if not isinstance(value, dict | list):
        return 1
    if id(value) not in known:
        known[id(value)] = MOST_VALUES  # for as long as it is not known: what holds itself has no end
        for key in value if isinstance(value, dict) else ():
            if not isinstance(key, str):
                said = f"expected names as keys, got {checks.brief(key)} (not quoted?)"
                raise InvalidFile(f"{path}:{line}: {said}")
        parts = list(value.values() if isinstance(value, dict) else value)
        known[id(value)] = 1 + sum(_size(part, path, known, line) for part in parts)
    return known[id(value)]
