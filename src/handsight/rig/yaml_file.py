"""A YAML file as plain values that know their lines: errors read `file:line: field: expected ..., got ...`."""

import math
import re
from pathlib import Path
from typing import TypeVar

import msgspec

from handsight import checks
from handsight.errors import InvalidFile, needing
from handsight.files import read_bytes
from handsight.msgspec_errors import FieldPath, explain, field_name

MAX_BYTES = 1 << 20  # of a file; a rig is a page or two
MAX_VALUES = 5_000
"""Values of a file, aliases written out, of which a few lines can make billions. A hand of twenty fingers has a
thousand, and the parser takes a second or two for 5000."""
MAX_NAME_LENGTH = 200  # characters of a field's name in a message
Form = TypeVar("Form", bound=msgspec.Struct)


class YamlFile:
    """Values of a YAML file, and the line of each."""

    values: dict[str, object]
    """The mapping as Python's own types, aliases written out."""

    def __init__(self, path: Path, text: str | None = None) -> None:
        """Reads the file, or a text that is its content; raises InvalidFile where it is not a mapping of names to
        values, MissingExtra."""
        with needing("YAML files need ruamel.yaml", "robot"):
            from ruamel.yaml import YAML
            from ruamel.yaml.comments import CommentedMap
            from ruamel.yaml.error import MarkedYAMLError, YAMLError
        try:
            text = read_bytes(path, MAX_BYTES).decode("utf-8") if text is None else text
        except UnicodeDecodeError:
            raise InvalidFile(f"{path}: expected YAML in UTF-8, got other bytes") from None
        # Each value takes a comma or a line; counting these takes no time.
        lines = (line for line in text.splitlines() if not line.lstrip().startswith("#"))
        if sum(line.count(",") + 1 for line in lines) > MAX_VALUES:
            raise _too_many(path)
        try:
            marked = YAML(typ="rt", pure=True).load(text)
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            problem = str(error.problem).splitlines()[0]
            line = f":{mark.line + 1}" if mark is not None else ""
            raise InvalidFile(f"{path}{line}: expected YAML, got: {problem}") from None
        except (ValueError, RecursionError, YAMLError) as error:
            raise InvalidFile(f"{path}: expected YAML, got: {str(error).splitlines()[0]:.200}") from None
        except Exception:  # ruamel.yaml fails in many ways for strange tags and merges
            raise InvalidFile(
                f"{path}: expected YAML, got tags, merges or aliases that stand for nothing"
            ) from None
        if not isinstance(marked, CommentedMap):
            raise InvalidFile(f"{path}: expected a mapping of keys to values, got {checks.brief(marked)}")
        self.path = path
        self._marked = marked
        self._count = 0
        try:
            self.values = self._plain(marked, ())  # type: ignore[assignment]
        except RecursionError:
            raise InvalidFile(f"{path}: expected YAML, got: too deep") from None

    def read(self, form: type[Form]) -> Form:
        """Returns the values in a form; raises InvalidFile for the first value that the form does not allow."""
        try:
            return msgspec.convert(self.values, form)
        except msgspec.ValidationError:
            raise self.error(*explain(form, self.values)) from None

    def error(self, field: FieldPath, message: str) -> InvalidFile:
        """Returns the error of a message about a field, with its line."""
        name = field_name(field)[:MAX_NAME_LENGTH] or "file"
        return InvalidFile(f"{self.path}:{self.line(field)}: {name}: {message}")

    def line(self, field: FieldPath) -> int:
        """Returns the line of a field, or of the mapping that it is missing in."""
        value = self._marked
        line = 1
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

    def _plain(self, value: object, field: FieldPath) -> object:
        """Returns mappings, lists and numbers of the YAML library as Python's own, aliases written out.

        Raises InvalidFile for too many values, tags, keys that are not texts, and numbers that are not finite.
        """
        self._count += 1
        if self._count > MAX_VALUES:
            raise _too_many(self.path)
        tag = getattr(getattr(value, "tag", None), "value", None)
        if tag is not None:
            raise self.error(field, f"expected values without tags, got {checks.brief(str(tag))}")
        if isinstance(value, dict):
            for key in value:
                self._plain(key, field)
                if not isinstance(key, str):
                    raise self.error(field, f"expected names as keys, got {checks.brief(key)} (not quoted?)")
            return {str(key): self._plain(part, (*field, key)) for key, part in value.items()}
        if isinstance(value, list):
            return [self._plain(part, (*field, i)) for i, part in enumerate(value)]
        if isinstance(value, float) and not math.isfinite(value):
            raise self.error(field, f"expected a finite number, got {float(value)}")
        if isinstance(value, str) and re.search("[\ud800-\udfff]", value):
            raise self.error(field, "expected text, got half of a surrogate pair")
        return next((kind(value) for kind in (bool, int, float, str) if isinstance(value, kind)), value)


def _too_many(path: Path) -> InvalidFile:
    return InvalidFile(f"{path}: expected at most {MAX_VALUES} values, got more (aliases of aliases?)")
