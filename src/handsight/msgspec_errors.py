"""Messages about values that msgspec refuses: the field, what was expected, and what came.

A *form* is a type to which msgspec converts a document, such as a `msgspec.Struct`. Its `__post_init__` may raise
`ValueError("key: expected ..., got ...")`; the message is then about the field with that key. A refused value is walked
again beside the form, so that no message depends on msgspec's sentences.
"""

import operator
import types
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from handsight.checks import brief, suggestion
from handsight.errors import InvalidFile

FieldPath = tuple[str | int, ...]
"""Keys of mappings and indices of lists that lead from a document to a value in it."""
Form = TypeVar("Form")
JsonObject = dict[str, Any]
Fault = tuple[FieldPath, str]
"""The path of a value that is not as its form allows, and a message about it."""
WORDS = {
    str: "a text",
    float: "a finite number",
    int: "a whole number",
    bool: "true or false",
    list: "a list",
}
BOUNDS = {"gt": (operator.gt, "above"), "ge": (operator.ge, "of at least")}
BOUNDS |= {"lt": (operator.lt, "below"), "le": (operator.le, "of at most")}
"""Limits of numbers, by msgspec's names."""


def field_name(path: FieldPath) -> str:
    """Returns a path as text, such as `contacts[2].point`; empty for the document itself."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in path]
    return "".join(steps).removeprefix(".")


def decode(data: bytes, form: type[Form], where: str) -> Form:
    """Returns a JSON document converted to a form; raises an InvalidFile that begins with `where`."""
    raw = decode_json(data, where) if get_origin(form) is list else decode_object(data, where)
    return convert(raw, form, where)


def convert(raw: object, form: type[Form], where: str) -> Form:
    """Returns a document's values in a form; raises an InvalidFile that begins with `where` and names the field."""
    try:
        return msgspec.convert(raw, form)
    except msgspec.ValidationError:
        field, message = explain(form, raw)
        raise InvalidFile(f"{where}: {field_name(field) or 'file'}: {message}") from None


def decode_object(data: bytes, where: str) -> JsonObject:
    """Returns a JSON document that is an object; raises an InvalidFile that begins with `where`."""
    raw = decode_json(data, where)
    if not isinstance(raw, dict):
        raise InvalidFile(f"{where}: expected an object {{...}}, got {brief(raw)}")
    return raw


def decode_json(data: bytes, where: str) -> Any:
    """Returns a JSON document; raises an InvalidFile that begins with `where`."""
    try:
        return msgspec.json.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InvalidFile(f"{where}: expected JSON, got other text ({error})") from None


def explain(form: Any, value: Any) -> Fault:
    """Returns the path of the field for which msgspec refuses `value` as a `form`, and a message about that field."""
    kinds = alternatives(form)
    for kind in kinds:
        for step, part_form, part in _parts(kind, value):
            if not _fits(part_form, part):
                path, message = explain(part_form, part)
                return (step, *path), message
        if _is_struct(kind) and isinstance(value, dict):
            return _fault_of_struct(kind, value)
    names = [str(name) for kind in kinds if get_origin(kind) is Literal for name in get_args(kind)]
    if isinstance(value, str) and names:
        return (), f"expected {_words(form)}, got {value!r}{suggestion(value, names)}"
    hint = " (a text)" if isinstance(value, str) and str not in kinds else ""
    return (), f"expected {_bound_missed(form, value) or _words(form)}, got {brief(value)}{hint}"


def _parts(kind: Any, value: Any) -> list[tuple[str | int, Any, Any]]:
    """Returns the parts of a value as a kind of mapping or list: their keys or indices, forms and values."""
    if _is_struct(kind) and isinstance(value, dict):
        fields = _field_types(kind)
        return [(key, fields[key], part) for key, part in value.items() if key in fields]
    origin = get_origin(kind)
    parts = get_args(kind)
    if origin is dict and isinstance(value, dict):
        return [(key, parts[1], part) for key, part in value.items()]
    if origin is list and isinstance(value, list):
        return [(i, parts[0], part) for i, part in enumerate(value)]
    if origin is tuple and isinstance(value, list) and len(value) == len(parts):
        return list(zip(range(len(value)), parts, value, strict=True))
    return []


def _fits(form: Any, value: object) -> bool:
    """Returns whether msgspec converts a value to a form."""
    try:
        msgspec.convert(value, form)
    except msgspec.ValidationError:
        return False
    return True


def _fault_of_struct(kind: Any, value: JsonObject) -> Fault:
    """Returns the fault of a mapping whose parts are right: an unknown key, a missing one, or what its form raises."""
    fields = _field_types(kind)
    unknown = [key for key in value if key not in fields]
    if unknown and kind.__struct_config__.forbid_unknown_fields:
        return (unknown[0],), f"unknown key{suggestion(unknown[0], fields)}"
    for field in msgspec.structs.fields(kind):
        if field.required and field.encode_name not in value:
            return (field.encode_name,), f"expected {_words(field.type)}, got nothing"
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        key, colon, message = str(error.__cause__).partition(": ")
        return ((key,), message) if colon and key.isidentifier() else ((), str(error.__cause__))
    return (), f"expected {_words(kind)}, got {brief(value)}"


def _bound_missed(form: Any, value: object) -> str | None:
    """Returns the bound of its form that a number is beyond, in words."""
    if get_origin(form) in (Union, types.UnionType):
        return next(filter(None, (_bound_missed(part, value) for part in get_args(form))), None)
    if get_origin(form) is not Annotated or isinstance(value, bool) or not isinstance(value, int | float):
        return None
    inner, *metas = get_args(form)
    for meta in metas:
        for name, (holds, words) in BOUNDS.items():
            limit = getattr(meta, name, None)
            if limit is not None and not holds(value, limit):
                return f"a number {words} {limit:g}"
    return _bound_missed(inner, value)


def _words(form: Any) -> str:
    """Returns a user's words for the values of a form."""
    kinds = [kind for kind in alternatives(form) if kind is not types.NoneType]
    if len(kinds) > 1:
        return " or ".join(map(_words, kinds))
    origin = get_origin(kinds[0]) or kinds[0]
    parts = get_args(kinds[0])
    if origin is Literal:
        return f"one of {', '.join(map(str, parts))}"
    if origin is tuple:
        return f"{len(parts)} finite numbers"
    return WORDS.get(origin, "keys and values")


def alternatives(form: Any) -> list[Any]:
    """Returns the types in a union, or the type itself, without annotations."""
    if get_origin(form) is Annotated:
        return alternatives(get_args(form)[0])
    if get_origin(form) in (Union, types.UnionType):
        return [kind for part in get_args(form) for kind in alternatives(part)]
    return [form]


def _is_struct(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _field_types(kind: Any) -> JsonObject:
    """Returns the types of a form's fields, by key in the document."""
    return {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
