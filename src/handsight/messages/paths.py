"""Paths into the messages of drivers, such as `sensors[sensor_pos=3].forces[0:30]`, and the numbers at their ends."""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.messages import images
from handsight.messages.topics import MessageRejected
from handsight.rig.rig import message_steps

NUMBERS = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), start=1))
"""NumPy's types of the columns of a PointCloud2, by their number there."""


def numbers(value: Any) -> tuple[Array, tuple[int, ...]]:
    """Returns the numbers of an image, an array message, a channel or a list, and their shape; empty: not stated."""
    if hasattr(value, "encoding"):
        pixels = images.values(value, ("mono8", "8UC1", "mono16", "16UC1", "32FC1"))[..., 0]
        return pixels.astype(np.float64), pixels.shape
    sizes: tuple[int, ...] = ()
    if hasattr(value, "layout"):
        sides = [int(each.size) for each in value.layout.dim]
        sizes = tuple(side for side in sides if side != 1 or len(sides) < 3)
        value = value.data[int(value.layout.data_offset) :]
    elif hasattr(value, "data") and not hasattr(value, "point_step"):  # one number
        value = value.data
    value = getattr(value, "values", value)
    if isinstance(value, list) and value and is_dataclass(value[0]):
        value = _table(value, ["x", "y", "z"])
    try:
        found = np.asarray(value)
    except ValueError:  # lists of different lengths
        found = np.zeros(0, object)
    if found.dtype.kind not in "fiub":
        raise MessageRejected(f"expected numbers, got {type(value).__name__}")
    if found.ndim > 1 and found.shape[-1] == 1:  # one column
        found = found[..., 0]
    return found.astype(np.float64), sizes or (found.shape if found.ndim > 1 else ())


def at(message: object, path: str) -> Any:
    """Returns what a path leads to; raises InvalidInput that names a step which leads nowhere."""
    value: Any = message
    for value in along(message, path):  # noqa: B007 - the last one
        pass
    return value


def beside(path: str, name: str) -> str:
    """Returns a path with another field in place of its last one, such as `hands[0].name` for `hands[0].position`."""
    last = [step for step in message_steps(path) if step["name"]][-1:]
    for step in last:
        return path[: step.start("name")] + name + path[step.end() :]
    return name


def time_along(message: object, path: str) -> float:
    """Returns the last `time` [s] on the way along a path; 0 without one."""
    time = 0.0
    with suppress(InvalidInput):  # which `at` raises too
        for value in along(message, path):
            seconds = getattr(value, "time", None)
            if isinstance(seconds, float):
                time = seconds
    return time


def along(message: object, path: str) -> Iterator[Any]:
    """Yields what each step of a path leads to in a message; raises InvalidInput that names a step which leads nowhere.

    An empty path has no steps.
    """
    value = message
    for step in message_steps(path) if path else ():
        try:
            value = _after(value, step)
        except InvalidInput as error:
            raise InvalidInput(f"field {path[: step.end()]}: {error}") from None
        yield value


def _after(value: Any, step: re.Match[str]) -> Any:
    """Returns what is one step farther in a message; raises InvalidInput."""
    columns = step["columns"].split(",") if step["columns"] else []
    if columns and hasattr(value, "point_step"):
        return _columns(value, columns)
    if (name := step["name"]) and not isinstance(value, list):
        return _field(value, name)
    if not isinstance(value, list | np.ndarray):
        raise InvalidInput(f"expected a list, got {type(value).__name__}")
    if columns:
        return _table(value, columns)
    if name:
        return [_field(each, name) for each in value]
    if key := step["key"]:
        keys = [str(_field(each, key)) for each in value]
        if keys.count(step["value"]) == 1:
            return value[keys.index(step["value"])]
        raise InvalidInput(f"expected one with that {key}, got {', '.join(keys[:12]) or 'none'}")
    index = step["index"]
    first = int(index or step["first"] or 0)
    end = first + 1 if index else int(step["end"] or len(value))
    if not first < end <= len(value):
        raise InvalidInput(f"expected at least {max(end, first + 1)} elements, got {len(value)}")
    return value[first] if index else value[first:end]


def _table(rows: Any, names: list[str]) -> list[list[Any]]:
    """Returns those fields of each message in a list."""
    for name in names if len(rows) else ():
        _field(rows[0], name)  # all are of one type
    numbers_of = attrgetter(*names)
    return [list(numbers_of(each)) if len(names) > 1 else [numbers_of(each)] for each in rows]


def _field(value: Any, name: str) -> Any:
    """Returns a field of a decoded message; raises InvalidInput where it has none of that name."""
    if name not in getattr(value, "__dataclass_fields__", ()):  # `fields` takes far longer
        names = [each.name for each in fields(value) if each.name[0] != "_"] if is_dataclass(value) else []
        known = ", ".join(names[:20]) or "none here"
        raise InvalidInput(f"expected a field of the message ({known}), got {name}")
    return getattr(value, name)


def _columns(cloud: Any, names: list[str]) -> Array:
    """Returns columns (n, k) of a PointCloud2, of an organised one (h, w, k); raises InvalidInput."""
    known = {each.name: each for each in cloud.fields}
    if unknown := [name for name in names if name not in known]:
        raise InvalidInput(f"expected columns of the cloud ({', '.join(known)}), got {unknown[0]}")
    order = ">" if cloud.is_bigendian else "<"
    chosen = [known[name] for name in names]
    for field in chosen:
        if field.count > 1:
            raise InvalidInput(f"expected one number a point in {field.name}, got {field.count}")
    height = int(cloud.height)
    width = int(cloud.width)
    step = int(cloud.point_step)
    row = max(int(cloud.row_step), width * step)
    try:
        formats = [order + NUMBERS[field.datatype] for field in chosen]
        offsets = [field.offset for field in chosen]
        point = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
        points = np.ndarray((height, width), point, bytes(cloud.data), strides=(row, step))
    except (KeyError, ValueError, TypeError) as error:  # which NumPy raises where it is not as the fields say
        stated = f"{height} rows of {width} points of {step} bytes with {', '.join(names)}"
        raise InvalidInput(f"expected {stated}, got {len(cloud.data)} bytes ({error})") from None
    if min(height, width) == 1:
        points = points.ravel()
    return np.stack([points[name].astype(np.float64) for name in names], axis=-1)
