"""Readings of tactile arrays, out of messages and into them."""

from types import SimpleNamespace as Message

import numpy as np

from handsight.checks import Array
from handsight.contact.taxels import TaxelArray
from handsight.errors import InvalidInput
from handsight.messages import images
from handsight.messages.topics import MessageRejected, RosMessage

ENCODINGS = ("mono8", "8UC1", "mono16", "16UC1", "32FC1")


def reading(message: RosMessage, shape: tuple[int, int]) -> Array:
    """Returns (rows, columns) of a Float32MultiArray or an Image; NaN where a taxel reads nothing. Raises
    MessageRejected.

    Row by row from the grid's corner at -x, -y; the layout of an array may say so, or nothing.
    """
    values = _image(message) if hasattr(message, "encoding") else _array(message, shape)
    if values.shape != shape:
        came = " x ".join(map(str, values.shape))
        raise MessageRejected(f"expected {shape[0]} x {shape[1]} taxels, got {came}")
    values = np.where(np.isfinite(values), values, np.nan)
    if np.isnan(values).all():
        raise MessageRejected("no taxel has a finite reading", nan=True)
    return values


def _image(message: RosMessage) -> Array:
    return np.asarray(images.values(message, ENCODINGS)[..., 0].astype(np.float64))


def _array(message: RosMessage, shape: tuple[int, int]) -> Array:
    """Returns readings as its layout says, or, where that says no more than how many there are, in the rows of the
    grid."""
    offset, sizes = int(message.layout.data_offset), [int(each.size) for each in message.layout.dim]
    data = np.asarray(message.data, dtype=np.float64)[offset:]
    sizes = [size for size in sizes if size != 1] if len(sizes) > 2 else sizes
    if len(sizes) == 2 and tuple(sizes) != shape:
        raise MessageRejected(f"expected {shape[0]} x {shape[1]} taxels, got {sizes[0]} x {sizes[1]}")
    if len(data) != shape[0] * shape[1]:
        raise MessageRejected(f"expected {shape[0]} x {shape[1]} taxels, got {len(data)} numbers")
    return np.asarray(data.reshape(shape))


def fields(values: Array, array: TaxelArray | None, name: str) -> dict[str, object]:
    """Returns the fields of a Float32MultiArray of an array's readings (rows, columns); raises InvalidInput."""
    if array is None:
        raise InvalidInput(f"skin[{name!r}]: expected a tactile array of the rig, got none of that name")
    clean = array.reading(values, f"skin[{name!r}]")
    (rows, columns), data = clean.shape, clean.astype(np.float32).ravel()
    dim = [
        Message(label="rows", size=rows, stride=data.size),
        Message(label="columns", size=columns, stride=columns),
    ]
    return {"layout": Message(dim=dim, data_offset=0), "data": data}
