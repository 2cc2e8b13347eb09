"""Readings of taxels out of messages: of arrays, images and point clouds, and of any message by a path into it."""

import math

import numpy as np

from handsight.checks import Array
from handsight.contact.taxels import PIXELS, block
from handsight.messages.paths import at, numbers
from handsight.messages.topics import MessageRejected, RosMessage, TaxelSource


def readings(message: RosMessage, source: TaxelSource) -> Array:
    """Returns a surface's readings, NaN where a taxel has no finite one.

    The numbers are in the order of the surface's taxels, of a grid row by row from its corner at -x, -y. Raises
    MessageRejected, InvalidInput.
    """
    value = at(message, source.field)
    if hasattr(value, "sensors"):  # a TactileState
        value = at(value, f"sensors[name={source.name}]")
    found, sizes = numbers(value)
    expected = f"expected {' x '.join(map(str, source.shape))} taxels"
    if source.indentation:
        expected += f", or an image with {PIXELS}"
    if source.indentation and block(sizes, source.shape) is not None:
        source = source._replace(shape=sizes)
    # A list of vectors is of the taxels one after the other, those of a grid too, and so is an image of a bent gel.
    allowed = source.shape, (math.prod(source.shape[:-1]), source.shape[-1])
    bent = source.indentation and len(source.shape) == 1
    if len(sizes) > 1 and sizes not in allowed and not bent:
        raise MessageRejected(f"{expected}, got {' x '.join(map(str, sizes))}")
    if not found.size:
        why = "as drivers send them without a calibration of the sensor"
        raise MessageRejected(f"{expected}, got none, {why}")
    if found.size != math.prod(source.shape):
        raise MessageRejected(f"{expected}, got {found.size} numbers")
    found = np.where(np.isfinite(found), found, np.nan).reshape(source.shape)
    if np.isnan(found).all():
        raise MessageRejected("no taxel has a finite reading", nan=True)
    return found
