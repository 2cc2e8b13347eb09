"""Images of ROS to arrays: colour (h, w, 3) red, green, blue; depth (h, w) [m], NaN where there is none."""

import struct
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from handsight.camera import Depth
from handsight.errors import InvalidInput
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.vision import pixels
from handsight.vision.pixels import Color

COMPRESSED_DEPTH = struct.Struct("<iff")
"""What `compressed_depth_image_transport` puts before the PNG: a format, and A, B of depth = A / (value - B)."""

LAYOUTS = {
    **dict.fromkeys(("rgb8", "bgr8"), ("u1", 3)),
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    "32FC1": ("f4", 1),
}
"""Type and channels of a pixel, by encoding."""
Input = TypeVar("Input")
Output = TypeVar("Output")


def color(message: RosMessage) -> Color:
    """Returns the colour image of an Image or CompressedImage; raises MessageRejected."""
    if hasattr(message, "format"):
        return _accepted(pixels.color, bytes(message.data))
    found = values(message, ("rgb8", "bgr8"))
    return np.ascontiguousarray(found if message.encoding == "rgb8" else found[..., ::-1])


def depth(message: RosMessage) -> Depth:
    """Returns the depth image of an Image or CompressedImage; raises MessageRejected, also for the wrong unit."""
    if hasattr(message, "format"):
        return _compressed_depth(bytes(message.data), str(message.format))
    return _metres(values(message, ("16UC1", "mono16", "32FC1"))[..., 0])


def values(message: RosMessage, expected: tuple[str, ...]) -> NDArray[np.generic]:
    """Returns (h, w, channels) as the encoding says, rows padded to `step`; raises MessageRejected."""
    if message.encoding not in expected:
        raise MessageRejected(f"expected encoding {', '.join(expected)}, got {message.encoding[:20]!r}")
    kind, channels = LAYOUTS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    h, w, step = int(message.height), int(message.width), int(message.step)
    row = w * channels * dtype.itemsize
    if h == 0 or w == 0 or step < row or len(message.data) < step * (h - 1) + row:
        raise MessageRejected(
            f"expected {h} rows of {step} bytes for {w} x {h} {message.encoding}, got {len(message.data)} bytes"
        )
    strides = step, channels * dtype.itemsize, dtype.itemsize
    return np.ascontiguousarray(np.ndarray((h, w, channels), dtype, message.data, strides=strides))


def _metres(values: NDArray[np.generic]) -> Depth:
    """Returns a depth image from millimetres if the values are whole numbers, else metres; raises MessageRejected
    where they are not."""
    return _accepted(pixels.metres, values)


def _compressed_depth(data: bytes, described: str) -> Depth:
    if "rvl" in described.lower():
        raise MessageRejected("expected compressed depth as PNG, got RVL")
    if "compressedDepth" not in described:
        return _metres(_accepted(pixels.sixteen_bits, data))
    if len(data) < COMPRESSED_DEPTH.size:
        raise MessageRejected(f"expected a header of {COMPRESSED_DEPTH.size} bytes, got {len(data)} bytes")
    _, a, b = COMPRESSED_DEPTH.unpack_from(data)
    values = _accepted(pixels.sixteen_bits, data[COMPRESSED_DEPTH.size :])
    if not described.startswith("32FC1"):
        return _metres(values)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = (a / (values.astype(np.float64) - b)).astype(np.float32)
    return _metres(np.where(values == 0, np.float32(np.nan), inverse))


def _accepted(read: Callable[[Input], Output], given: Input) -> Output:
    """Returns what `read` makes of it; raises MessageRejected where it refuses."""
    try:
        return read(given)
    except InvalidInput as error:
        raise MessageRejected(str(error)) from None
