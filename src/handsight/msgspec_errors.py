"""What is wrong with a file that msgspec refused, in words: which field, what was expected, what came.

A form is a `msgspec.Struct`; its `__post_init__` may raise `ValueError("key: expected ..., got ...")`, told at the key.
"""

import re
import types
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from handsight.checks import brief, suggestion
from handsight.errors import InvalidFile

FieldPath = tuple[str | int, ...]
"""Keys and places in lists, from the whole file to one value."""
Form = TypeVar("Form")

_KINDS = {
    "object": "keys and values",
    "array": "a list",
    "str": "a text",
    "float": "a finite number",
    "int": "a whole number",
    "bool": "true or false",
}
_BOUNDS = {
    ">": "a number above",
    ">=": "a number of at least",
    "<": "a number below",
    "<=": "a number of at most",
}


def field_name(path: FieldPath) -> str:
    """A path in words, as `contacts[2].point`; empty for the whole file."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in path]
    return "".join(steps).removeprefix(".")


def decode(data: bytes, form: type[Form], where: str) -> Form:
    """A JSON document in a form; raises InvalidFile for what it is not, which begins with `where`."""
    raw = decode_object(data, where)
    try:
        return msgspec.convert(raw, form)
    except msgspec.ValidationError as error:
        field, said = explain(error, form, raw)
        raise InvalidFile(f"{where}: {field_name(field) or 'file'}: {said}") from None


def decode_object(data: bytes, where: str) -> dict[str, Any]:
    """A JSON document whose outermost is a mapping; raises InvalidFile, which begins with `where`."""
    try:
        raw = msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidFile(f"{where}: expected JSON, got other text ({error})") from None
    if not isinstance(raw, dict):
        raise InvalidFile(f"{where}: expected an object {{...}}, got {brief(raw)}")
    return raw


def explain(error: msgspec.ValidationError, form: Any, value: Any) -> tuple[FieldPath, str]:
    """Where `value` is not of the `form` that msgspec wanted, and the sentence about it."""
    said, mark, where = str(error).rpartition(" - at `$")
    said, where = (said, where) if mark else (where, "")
    try:
        return _located(said, re.findall(r"\.{3}|[^.\[\]`]+", where), form, value)
    except (LookupError, TypeError, ValueError):  # an unknown key that reads like msgspec's own words
        return _sentence(str(error), (), form, value)


def _located(said: str, steps: list[str], form: Any, value: Any) -> tuple[FieldPath, str]:
    path: FieldPath = ()
    for text in steps:
        if text == "...":  # an entry of a mapping whose keys are free: msgspec does not say which
            name, (inner, said) = _first_wrong_entry(_part(form, text), value)
            return (*path, name, *inner), said
        step = int(text) if isinstance(value, list) else text
        path, form, value = (*path, step), _part(form, step), value[step]
    return _sentence(said, path, form, value)


def _sentence(said: str, path: FieldPath, form: Any, value: Any) -> tuple[FieldPath, str]:
    if found := re.fullmatch(r"Object contains unknown field `(.*)`", said, re.DOTALL):
        return (*path, found[1]), f"unknown key{suggestion(found[1], _fields(form))}"
    if found := re.fullmatch(r"Object missing required field `(.*)`", said):
        return (*path, found[1]), "expected, got nothing"
    if said.startswith("Invalid enum value"):
        allowed = _alternatives(form)
        names = [str(name) for kind in allowed if get_origin(kind) is Literal for name in get_args(kind)]
        others = "".join(f"{_kind('array', form)} or " for kind in allowed if get_origin(kind) is tuple)
        return (
            path,
            f"expected {others}one of {', '.join(names)}, got {value!r}{suggestion(str(value), names)}",
        )
    if said == "Number out of range":
        return path, f"expected a finite number, got {brief(value)}"
    if found := re.match(r"Expected `([^`]+)`(?: (>=?|<=?) ([\d.]+))?", said):
        kinds, bound, limit = found.groups()
        names = [_kind(kind, form) for kind in kinds.split(" | ") if kind != "null"]
        expected = f"{_BOUNDS[bound]} {float(limit):g}" if bound else " or ".join(names)
        is_text = isinstance(value, str) and "str" not in kinds
        return path, f"expected {expected}, got {brief(value)}{' (a text)' if is_text else ''}"
    if found := re.match(r"(\w+): ", said):
        return (*path, found[1]), said[found.end() :]
    return path, said


def _kind(kind: str, form: Any) -> str:
    sizes = [len(get_args(part)) for part in _alternatives(form) if get_origin(part) is tuple]
    return f"{sizes[0]} finite numbers" if kind == "array" and sizes else _KINDS.get(kind, kind)


def _first_wrong_entry(form: Any, entries: dict[str, Any]) -> tuple[str, tuple[FieldPath, str]]:
    for name, value in entries.items():
        try:
            msgspec.convert(value, form)
        except msgspec.ValidationError as error:
            return name, explain(error, form, value)
    raise ValueError("expected a mapping with an entry that is not of the form, got none")


def _alternatives(form: Any) -> list[Any]:
    """The types that a type allows: those of a union, without annotations."""
    if get_origin(form) is Annotated:
        return _alternatives(get_args(form)[0])
    if get_origin(form) in (Union, types.UnionType):
        return [kind for part in get_args(form) for kind in _alternatives(part)]
    return [form]


def _fields(form: Any) -> dict[str, Any]:
    """Types of a form's fields by the keys they have in the file."""
    for kind in _alternatives(form):
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            return {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    return {}


def _part(form: Any, step: str | int) -> Any:
    """The type of what lies under a key, at a place of a list, or in any entry of a mapping."""
    for kind in _alternatives(form):
        if get_origin(kind) is tuple:
            return get_args(kind)[int(step)]
        if get_origin(kind) not in (None, Literal):
            return get_args(kind)[-1]
    return _fields(form).get(str(step))
