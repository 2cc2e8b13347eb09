"""The reference of a `rig.yaml` as Markdown, made of the forms that declare its keys."""

import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from msgspec import Meta

from handsight.msgspec_errors import alternatives
from handsight.rig.form import Form, Key, RigForm, keys

HEAD = """Lengths are in metres, angles in degrees, forces in newtons. Every `sigma`, noise and error is one standard
deviation per axis. Keys in bold must be there; others have a default, or stand for something that the robot lacks.
"""
WORDS = {str: "text", float: "number", int: "whole number", bool: "true, false"}


def schema() -> str:
    """Returns the reference: a table of the keys of each mapping of the file, in the file's order."""
    places = dict[type[Form], str]()
    _place(RigForm, "", places)
    tables = [HEAD]
    for form, place in places.items():
        title = f"`{place}`: " if place else ""
        meaning = " ".join((form.__doc__ or "").split())
        rows = "\n".join(_row(key, places) for key in keys(form))
        tables.append(f"{title}{meaning}\n\n| key | value | meaning |\n|---|---|---|\n{rows}\n")
    return "\n".join(tables)


def _place(form: type[Form], place: str, places: dict[type[Form], str]) -> None:
    """Adds where a form stands in the file, and the forms in it; one that stands in several places, once."""
    if form in places:
        return
    places[form] = place
    for key in keys(form):
        for kind in alternatives(key.declared):
            inner = get_args(kind)[1] if get_origin(kind) is dict else kind
            name = f"{key.text}.NAME" if get_origin(kind) is dict else key.text
            if isinstance(inner, type) and issubclass(inner, Form):
                _place(inner, f"{place}.{name}".removeprefix("."), places)


def _row(key: Key, places: dict[type[Form], str]) -> str:
    name = f"**`{key.text}`**" if key.required else f"`{key.text}`"
    value = _values(key.declared, places)
    if key.metres:
        value += f", within {key.metres:g} m"
    if key.kilograms:
        value += f", up to {key.kilograms:g} kg"
    if key.text.endswith("_deg"):
        value += " °"
    return f"| {name} | {value} | {key.comment} |"


def _values(kind: Any, places: dict[type[Form], str]) -> str:
    """Returns a user's words for the values of a type."""
    origin = get_origin(kind)
    parts = get_args(kind)
    if origin is Annotated:
        bounds = [_bounds(part) for part in parts[1:] if isinstance(part, Meta)]
        return _values(parts[0], places) + "".join(bounds)
    if origin in (Union, types.UnionType):
        return " or ".join(_values(part, places) for part in parts if part is not types.NoneType)
    if origin is Literal:
        return ", ".join(f"`{part}`" for part in parts)
    if origin is tuple:
        return f"{len(parts)} numbers"
    if origin is list:
        return f"list of: {_values(parts[0], places)}"
    if origin is dict:
        return f"by name: {_values(parts[1], places)}"
    return f"as `{places[kind]}`" if kind in places else WORDS[kind]


def _bounds(meta: Meta) -> str:
    least = f" above {meta.gt:g}" if meta.gt is not None else ""
    if meta.ge is not None:
        least = f" from {meta.ge:g}"
    most = f" to {meta.le:g}" if meta.le is not None else ""
    return least + most
