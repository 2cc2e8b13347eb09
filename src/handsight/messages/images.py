"""Images of ROS to arrays: colour (h, w, 3) red, green, blue; depth (h, w) [m], NaN where there is none."""

import io
import struct
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight.checks import FARTHEST
from handsight.errors import MissingExtra
from handsight.messages.topics import MessageRejected

Color = NDArray[np.uint8]
Depth = NDArray[np.float32]

MAX_PIXELS = 20_000_000
"""Of a compressed image, before it is unpacked; a kilobyte may hold as many."""
MAX_MEDIAN_M = 20.0
"""A depth image whose median is beyond it [m] is not in metres."""
MIN_MEDIAN_MM = 20
"""A depth image whose median is below it [mm] is not in millimetres."""
COMPRESSED_DEPTH = struct.Struct("<iff")
"""What `compressed_depth_image_transport` puts before the PNG: a format, and A, B of depth = A / (value - B)."""

LAYOUTS = {"rgb8": ("u1", 3), "bgr8": ("u1", 3), "16UC1": ("u2", 1), "mono16": ("u2", 1), "32FC1": ("f4", 1)}
"""Type and channels of a pixel, by encoding."""


def color(message: Any) -> Color:
    """The colour image of an Image or CompressedImage; raises MessageRejected."""
    if hasattr(message, "format"):
        return _opened(bytes(message.data), lambda image: np.asarray(image.convert("RGB"), dtype=np.uint8))
    pixels = _pixels(message, ("rgb8", "bgr8"))
    return np.ascontiguousarray(pixels if message.encoding == "rgb8" else pixels[..., ::-1])


def depth(message: Any) -> Depth:
    """The depth image of an Image or CompressedImage; raises MessageRejected, also for the wrong unit."""
    if hasattr(message, "format"):
        return _compressed_depth(bytes(message.data), str(message.format))
    return _metres(_pixels(message, ("16UC1", "mono16", "32FC1"))[..., 0])


def _pixels(message: Any, expected: tuple[str, ...]) -> NDArray[Any]:
    """(h, w, channels) as the encoding says, rows padded to `step`."""
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


def _metres(pixels: NDArray[Any]) -> Depth:
    """Millimetres if the pixels are integers, else metres; raises MessageRejected where the numbers say otherwise."""
    integers = pixels.dtype.kind == "u"
    metres = pixels.astype(np.float32)
    with np.errstate(invalid="ignore"):
        metres[~((metres > 0) & (metres < (np.inf if integers else FARTHEST)))] = np.nan
    sample = metres[::4, ::4]
    known = sample[~np.isnan(sample)]
    median = float(np.median(known)) if known.size else np.nan
    if median < MIN_MEDIAN_MM if integers else median > MAX_MEDIAN_M:
        unit = "millimetres (16UC1)" if integers else "metres (32FC1)"
        guess = "another unit?" if integers else "millimetres?"
        raise MessageRejected(f"expected depth in {unit}, got a median of {median:.4g} ({guess})")
    return metres * np.float32(1e-3) if integers else metres


def _compressed_depth(data: bytes, described: str) -> Depth:
    if "rvl" in described.lower():
        raise MessageRejected("expected compressed depth as PNG, got RVL")
    if "compressedDepth" not in described:
        return _metres(_opened(data, _sixteen_bits))
    if len(data) < COMPRESSED_DEPTH.size:
        raise MessageRejected(f"expected a header of {COMPRESSED_DEPTH.size} bytes, got {len(data)} bytes")
    _, a, b = COMPRESSED_DEPTH.unpack_from(data)
    values = _opened(data[COMPRESSED_DEPTH.size :], _sixteen_bits)
    if not described.startswith("32FC1"):
        return _metres(values)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = (a / (values.astype(np.float64) - b)).astype(np.float32)
    return _metres(np.where(values == 0, np.float32(np.nan), inverse))


def _sixteen_bits(image: Any) -> NDArray[np.uint16]:
    if not image.mode.startswith("I"):
        raise MessageRejected(f"expected a PNG of 16 bits for depth, got mode {image.mode}")
    return np.asarray(image).astype(np.uint16)


def _opened(data: bytes, read: Callable[[Any], NDArray[Any]]) -> NDArray[Any]:
    """What `read` makes of a PNG or JPEG; raises MessageRejected where it is none, or too large."""
    try:
        from PIL import Image
    except ImportError:
        raise MissingExtra("compressed images need pillow: pip install 'handsight[robot]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise MessageRejected(f"expected at most {MAX_PIXELS} pixels, got {image.size}")
                return read(image)
    except MessageRejected:
        raise
    except Exception as error:  # pillow's plugins raise many kinds; each says that the bytes are no image
        raise MessageRejected(f"expected a PNG or JPEG, got: {str(error)[:80]}") from None
