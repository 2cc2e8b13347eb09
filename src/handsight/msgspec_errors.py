"""Messages about values that msgspec refuses: the field, what was expected, and what came.

A *form* is a type to which msgspec converts a document, such as a `msgspec.Struct`. Its `__post_init__` may raise
`ValueError("key: expected ..., got ...")`; the message is then about the field with that key.
"""

import re
import types
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from handsight.checks import brief, suggestion
from handsight.errors import InvalidFile

FieldPath = tuple[str | int, ...]
"""Keys of mappings and indices of lists that lead from a document to a value in it."""
Form = TypeVar("Form")
JsonObject = dict[str, Any]


def field_name(path: FieldPath) -> str:
    """Returns a path as text, such as `contacts[2].point`; empty for the document itself."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in path]
    return "".join(steps).removeprefix(".")


def decode(data: bytes, form: type[Form], where: str) -> Form:
    """Returns a JSON document converted to a form; raises an InvalidFile that begins with `where`."""
    raw = _decode_json(data, where) if get_origin(form) is list else decode_object(data, where)
    try:
        return msgspec.convert(raw, form)
    except msgspec.ValidationError as error:
        field, message = explain(error, form, raw)
        raise InvalidFile(f"{where}: {field_name(field) or 'file'}: {message}") from None


def decode_object(data: bytes, where: str) -> JsonObject:
    """Returns a JSON document that is an object; raises an InvalidFile that begins with `where`."""
    raw = _decode_json(data, where)
    if not isinstance(raw, dict):
        raise InvalidFile(f"{where}: expected an object {{...}}, got {brief(raw)}")
    return raw


def _decode_json(data: bytes, where: str) -> object:
    """Returns a JSON document; raises an InvalidFile that begins with `where`."""
    try:
        return msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidFile(f"{where}: expected JSON, got other text ({error})") from None


def explain(error: msgspec.ValidationError, form: object, value: object) -> tuple[FieldPath, str]:
    """Returns the path of the field for which msgspec refused `value` as a `form`, and a message about that field."""
    text, mark, where = str(error).rpartition(" - at `$")
    try:
        return _field_and_message(text, where, form, value) if mark else _message(str(error), (), form, value)
    except (LookupError, TypeError, ValueError):  # an unknown key that looks like msgspec's own text
        return _message(str(error), (), form, value)


def _field_and_message(text: str, where: str, form: object, value: object) -> tuple[FieldPath, str]:
    """Follows msgspec's path `where`, such as `.contacts[2].point`, to the refused value; returns as `explain`."""
    path: FieldPath = ()
    for key in re.findall(r"\.{3}|[^.\[\]`]+", where):
        if key == "...":  # an entry of a mapping with arbitrary keys; msgspec does not say which one
            entry_form = _entry_form(form, key)
            for name, entry in value.items():  # type: ignore[attr-defined]
                try:
                    msgspec.convert(entry, entry_form)
                except msgspec.ValidationError as error:
                    field, message = explain(error, entry_form, entry)
                    return (*path, name, *field), message
            raise ValueError("expected a mapping with an entry that is not of the form, got none")
        step = int(key) if isinstance(value, list) else key
        path, form, value = (*path, step), _entry_form(form, step), value[step]  # type: ignore[index]
    return _message(text, path, form, value)


def _message(text: str, path: FieldPath, form: object, value: object) -> tuple[FieldPath, str]:
    """Returns the path of the field that msgspec's `text` is about, and the text in words for a user."""
    if found := re.fullmatch(r"Object contains unknown field `(.*)`", text, re.DOTALL):
        return (*path, found[1]), f"unknown key{suggestion(found[1], _field_types(form))}"
    if found := re.fullmatch(r"Object missing required field `(.*)`", text):
        return (*path, found[1]), f"expected {_type_text(_field_types(form).get(found[1]))}, got nothing"
    if text.startswith("Invalid enum value"):
        allowed = alternatives(form)
        names = [str(name) for kind in allowed if get_origin(kind) is Literal for name in get_args(kind)]
        others = "".join(f"{_kind_text('array', form)} or " for kind in allowed if get_origin(kind) is tuple)
        expected = f"expected {others}one of {', '.join(names)}"
        return path, f"{expected}, got {value!r}{suggestion(str(value), names)}"
    if text == "Number out of range":
        return path, f"expected a finite number, got {brief(value)}"
    if found := re.match(r"Expected `([^`]+)`(?: (>=?|<=?) ([\d.]+))?", text):
        kinds, bound, limit = found.groups()
        expected = " or ".join(_kind_text(kind, form) for kind in kinds.split(" | ") if kind != "null")
        if bound:
            comparisons = {">": "above", ">=": "of at least", "<": "below", "<=": "of at most"}
            expected = f"a number {comparisons[bound]} {float(limit):g}"
        hint = " (a text)" if isinstance(value, str) and "str" not in kinds else ""
        return path, f"expected {expected}, got {brief(value)}{hint}"
    if found := re.match(r"(\w+): ", text):
        return (*path, found[1]), text[found.end() :]
    return path, text


def _kind_text(kind: str, form: object) -> str:
    """Returns a user's words for one of msgspec's kinds of values."""
    sizes = [len(get_args(part)) for part in alternatives(form) if get_origin(part) is tuple]
    texts = {
        "object": "keys and values",
        "array": f"{sizes[0]} finite numbers" if sizes else "a list",
        "str": "a text",
        "float": "a finite number",
        "int": "a whole number",
        "bool": "true or false",
    }
    return texts.get(kind, kind)


def _type_text(form: object) -> str:
    """Returns a user's words for a type of values."""
    first = alternatives(form)[0]
    if get_origin(first) is Literal:
        return " or ".join(map(str, get_args(first)))
    origin = get_origin(first) or first
    names = {str: "str", float: "float", int: "int", bool: "bool", tuple: "array", list: "array"}
    return _kind_text(next((name for kind, name in names.items() if kind is origin), "object"), form)


def alternatives(form: object) -> list[object]:
    """Returns the types in a union, or the type itself, without annotations."""
    if get_origin(form) is Annotated:
        return alternatives(get_args(form)[0])
    if get_origin(form) in (Union, types.UnionType):
        return [kind for part in get_args(form) for kind in alternatives(part)]
    return [form]


def _field_types(form: object) -> dict[str, object]:
    """Returns the types of a form's fields, by key in the document."""
    for kind in alternatives(form):
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
            return {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    return {}


def _entry_form(form: object, step: str | int) -> object:
    """Returns the type of a form's value under a key, at an index of a list, or in any entry of a mapping."""
    for kind in alternatives(form):
        if get_origin(kind) is tuple:
            return get_args(kind)[int(step)]
        if get_origin(kind) not in (None, Literal):
            return get_args(kind)[-1]
    return _field_types(form).get(str(step))
