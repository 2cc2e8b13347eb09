"""Readings of taxels out of messages: of arrays, images and point clouds, and of any message by a path into it."""

import math
import re
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.messages import images
from handsight.messages.topics import MessageRejected, RosMessage, TaxelSource
from handsight.rig.rig import message_steps

NUMBERS = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), start=1))
"""NumPy's types of the columns of a PointCloud2, by their number there."""


def readings(message: RosMessage, source: TaxelSource) -> tuple[Array, float]:
    """Returns a surface's readings, NaN where a taxel has no finite one, and their own time [s], 0 without one.

    The numbers are in the order of the surface's taxels, of a grid row by row from its corner at -x, -y. Raises
    MessageRejected, InvalidInput.
    """
    value, time = _at(message, source.field) if source.field else (message, 0.0)
    if hasattr(value, "sensors"):  # a TactileState
        value, _ = _at(value, f"sensors[name={source.name}]")
    found, sizes = _numbers(value)
    expected = f"expected {' x '.join(map(str, source.shape))} taxels"
    # A list of vectors is of the taxels one after the other, those of a grid too.
    if len(sizes) > 1 and sizes not in (source.shape, (math.prod(source.shape[:-1]), source.shape[-1])):
        raise MessageRejected(f"{expected}, got {' x '.join(map(str, sizes))}")
    if not found.size:
        why = "as drivers send them without a calibration of the sensor"
        raise MessageRejected(f"{expected}, got none, {why}")
    if found.size != np.prod(source.shape):
        raise MessageRejected(f"{expected}, got {found.size} numbers")
    found = np.where(np.isfinite(found), found, np.nan).reshape(source.shape)
    if np.isnan(found).all():
        raise MessageRejected("no taxel has a finite reading", nan=True)
    return found, time


def _numbers(value: Any) -> tuple[Array, tuple[int, ...]]:
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
        value = [[_field(each, axis) for axis in "xyz"] for each in value]
    try:
        found = np.asarray(value)
    except ValueError:  # lists of different lengths
        found = np.zeros(0, object)
    if found.dtype.kind not in "fiub":
        raise MessageRejected(f"expected numbers, got {type(value).__name__}")
    if found.ndim > 1 and found.shape[-1] == 1:  # one column
        found = found[..., 0]
    return found.astype(np.float64), sizes or (found.shape if found.ndim > 1 else ())


def _at(message: object, field: str) -> tuple[Any, float]:
    """Returns what a path leads to in a message, and the last `time` on its way [s], 0 without one. Raises InvalidInput
    that names the step which leads nowhere."""
    value, time = message, 0.0
    for step in message_steps(field):
        try:
            value = _after(value, step)
        except InvalidInput as error:
            raise InvalidInput(f"field {field[: step.end()]}: {error}") from None
        if isinstance(seconds := getattr(value, "time", None), float):
            time = seconds
    return value, time


def _after(value: Any, step: re.Match[str]) -> Any:
    """Returns what is one step farther in a message; raises InvalidInput."""
    if step["columns"] and hasattr(value, "point_step"):
        return _columns(value, step["columns"].split(","))
    if name := step["name"]:
        return [_field(each, name) for each in value] if isinstance(value, list) else _field(value, name)
    if not isinstance(value, list | np.ndarray):
        raise InvalidInput(f"expected a list, got {type(value).__name__}")
    if columns := step["columns"]:
        return [[_field(each, name) for name in columns.split(",")] for each in value]
    if key := step["key"]:
        keys = [str(_field(each, key)) for each in value]
        if step["value"] in keys:
            return value[keys.index(step["value"])]
        raise InvalidInput(f"expected one with that {key}, got {', '.join(keys[:12]) or 'none'}")
    one = step["index"] is not None
    first = int(step["index"] if one else step["first"] or 0)
    end = first + 1 if one else int(step["end"] or len(value))
    if not first < end <= len(value):
        raise InvalidInput(f"expected at least {max(end, first + 1)} elements, got {len(value)}")
    return value[first] if one else value[first:end]


def _field(value: Any, name: str) -> Any:
    """Returns a field of a decoded message; raises InvalidInput where it has none of that name."""
    names = [each.name for each in fields(value) if each.name[0] != "_"] if is_dataclass(value) else []
    if name not in names:
        known = ", ".join(names[:20]) or "none here"
        raise InvalidInput(f"expected a field of the message ({known}), got {name}")
    return getattr(value, name)


def _columns(cloud: Any, names: list[str]) -> Array:
    """Returns columns (n, k) of a PointCloud2, its points row by row; raises InvalidInput."""
    known = {each.name: each for each in cloud.fields}
    if unknown := [name for name in names if name not in known]:
        raise InvalidInput(f"expected columns of the cloud ({', '.join(known)}), got {unknown[0]}")
    order, step, row = "<>"[bool(cloud.is_bigendian)], int(cloud.point_step), int(cloud.row_step)
    data, height, width = bytes(cloud.data), int(cloud.height), int(cloud.width)
    if step < 1 or width * step > row or height * row > len(data):
        stated = f"{height} rows of {width} points of {step} bytes"
        raise InvalidInput(f"expected {stated}, got rows of {row} bytes, {len(data)} bytes in all")
    found = np.empty((height * width, len(names)))
    for column, each in zip(found.T, (known[name] for name in names), strict=True):
        number = np.dtype(order + NUMBERS.get(each.datatype, "f4"))
        if each.offset + number.itemsize > step or each.datatype not in NUMBERS:
            came = f"{each.name} at {each.offset}"
            raise InvalidInput(f"expected a number within the {step} bytes of a point, got {came}")
        shape, strides = (height, width), (row, step)
        column[:] = np.ndarray(shape, number, data, each.offset, strides).ravel() if found.size else 0.0
    return found
