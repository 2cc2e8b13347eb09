"""A YAML file as a tree that knows its lines: each value is asked for once, by name and kind.

What was never asked for is an unknown key. Every error is `file:line: path: expected ..., got ...`.
"""

import difflib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidFile, MissingExtra

LARGEST_FILE = 1 << 20
"""Bytes; a rig is a page or two."""
FARTHEST = 100.0
"""Nothing of a rig is farther away than this [m]; beyond it the unit is wrong."""
MOST_VALUES = 50_000
"""In a file, aliases written out: of a few lines they can make billions."""

_ABSENT = object()


def load(path: Path) -> "Node":
    """The file's mapping; raises InvalidFile where it is none."""
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
        raise InvalidFile(f"{path}: expected a mapping of keys to values, got {checks.brief(plain(value))}")
    try:
        size = _size(value, path, {})
    except RecursionError:
        raise InvalidFile(f"{path}: expected YAML, got: too deep") from None
    if size > MOST_VALUES:
        raise InvalidFile(f"{path}: expected at most {MOST_VALUES} values, got more (aliases of aliases?)")
    return Node(path, value, "", 1)


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
                said = f"expected names as keys, got {checks.brief(plain(key))} (not quoted?)"
                raise InvalidFile(f"{path}:{line}: {said}")
        parts = list(value.values() if isinstance(value, dict) else value)
        known[id(value)] = 1 + sum(_size(part, path, known, line) for part in parts)
    return known[id(value)]


class Node:
    """One mapping of the file."""

    def __init__(self, file: Path, value: Any, path: str, line: int) -> None:
        """`path`: where it is, in words; `line`: its first."""
        self.file, self.path, self.line = file, path, line
        self._value, self._asked = value, set[str]()

    def fail(self, key: str, said: str) -> InvalidFile:
        """An error at a key, or at this mapping where the key is empty."""
        place = (self._value.lc.data or {}).get(key)  # what was merged in has none
        line = self.line if place is None else place[2] + 1
        return InvalidFile(f"{self.file}:{line}: {self._name(key)}: {said}")

    def _name(self, key: str) -> str:
        return ".".join(part for part in (self.path, str(key)) if part) or "file"

    def __contains__(self, key: str) -> bool:
        return key in self._value

    @property
    def keys(self) -> list[str]:
        """Names the mapping gives, for mappings whose keys are free."""
        return [str(key) for key in self._value]

    def _get(self, key: str, default: Any) -> Any:
        self._asked.add(key)
        value = self._value.get(key, _ABSENT)
        if value is _ABSENT:
            if default is _ABSENT:
                raise self.fail(key, f"expected, got nothing{self.misspelt(key)}")
            return default
        return value

    def misspelt(self, *keys: str) -> str:
        """A question whether a key that nobody has asked for was meant as one of these; empty where none is alike."""
        for spare in (str(key) for key in self._value if key not in self._asked):
            if difflib.get_close_matches(spare, keys, n=1, cutoff=0.7):
                return f" (is {spare!r} meant for it?)"
        return ""

    def checked(self, key: str, default: Any, check: Callable[[Any, str], Any]) -> Any:
        """The value as `check(value, name)` returns it; the default is not checked."""
        value = self._get(key, default)
        if value is default:
            return default
        try:
            return check(plain(value), self._name(key))
        except HandsightError as error:
            said = str(error).removeprefix(f"{self._name(key)}: ")
            said += " (a text)" if isinstance(value, str) and check is not _text else ""
            raise self.fail(key, said) from None

    def section(self, key: str) -> "Node | None":
        """A mapping under a key; None where it is absent."""
        value = self._get(key, None)
        return None if value is None else self._mapping(key, value)

    def needed(self, key: str) -> "Node":
        """A mapping that must be there."""
        return self._mapping(key, self._get(key, _ABSENT))

    def _mapping(self, key: str, value: Any) -> "Node":
        if not hasattr(value, "lc") or not hasattr(value, "keys"):
            raise self.fail(key, f"expected keys and values, got {checks.brief(plain(value))}")
        return Node(self.file, value, self._name(key), value.lc.line + 1)

    def text(self, key: str, default: Any = _ABSENT) -> Any:
        """A text that is not empty."""
        return self.checked(key, default, _text)

    def one_of(self, key: str, names: Iterable[str], default: Any = _ABSENT) -> Any:
        """One of some names."""
        value = self.text(key, default)
        if value is not default and value not in names:
            raise self.fail(
                key, f"expected one of {', '.join(names)}, got {value!r}{checks.among(value, names)}"
            )
        return value

    def number(self, key: str, default: Any = _ABSENT) -> Any:
        """A finite number."""
        return self.checked(key, default, lambda v, name: float(checks.finite(v, name, ())))

    def positive(self, key: str, default: Any = _ABSENT) -> Any:
        """A number above zero."""
        return self.checked(key, default, checks.positive)

    def least(self, key: str, default: Any = _ABSENT) -> Any:
        """A number, at least zero."""
        return self.checked(key, default, _least)

    def angle(self, key: str, default: float) -> float:
        """Degrees of the file, at least zero, as radians; the default is in radians."""
        value = self.least(key, None)
        return default if value is None else float(np.deg2rad(value))

    def vector(self, key: str, size: int, default: Any = _ABSENT) -> Any:
        """So many finite numbers."""
        return self.checked(key, default, lambda v, name: checks.finite(v, name, (size,)))

    def pose(self, key: str) -> Array:
        """`{position, quaternion_xyzw}` as (4, 4); the identity where absent."""
        node = self.section(key)
        if node is None:
            return np.eye(4)
        position = node.vector("position", 3, np.zeros(3))
        if np.abs(position).max() > FARTHEST:
            raise node.fail("position", f"expected metres, got {position.tolist()} (millimetres?)")
        quaternion = node.checked(
            "quaternion_xyzw", np.array([0.0, 0.0, 0.0, 1.0]), lambda v, name: checks.unit(v, name, (4,))
        )
        node.done()
        return se3.compose(se3.rotation_from_quaternion(quaternion), position)

    def done(self) -> None:
        """Raises for the first key that nobody asked for."""
        for key in self._value:
            if key not in self._asked:
                raise self.fail(key, f"unknown key{checks.among(str(key), self._asked)}")


def plain(value: Any) -> Any:
    """YAML's own lists and numbers as Python's; what is neither stays and fails its check."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, bool):
        return value
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    for kind in (int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InvalidFile(f"{name}: expected a text, got {checks.brief(value)}")
    return value


def _least(value: Any, name: str) -> float:
    number = float(checks.finite(value, name, ()))
    if number < 0:
        raise InvalidFile(f"{name}: expected a number of at least 0, got {number:g}")
    return number
