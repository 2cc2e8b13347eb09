"""Images and cameras from ROS messages: colour (h, w, 3) red, green, blue; depth (h, w) [m], NaN where unknown.

Each function raises MessageRejected or InvalidInput where a message cannot be used.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from handsight.camera import Camera, Depth
from handsight.messages.topics import MessageRejected, RosMessage
from handsight.vision import pixels
from handsight.vision.pixels import Color

LAYOUTS = {
    **dict.fromkeys(("rgb8", "bgr8"), ("u1", 3)),
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    "32FC1": ("f4", 1),
    "32SC1": ("i4", 1),
}
"""Type and number of channels of a pixel, by the encoding of an Image."""
LENSES = {"plumb_bob": 5, "rational_polynomial": 8}
"""The distortion models that are supported, with their number of coefficients."""


def color(message: RosMessage) -> Color:
    """Returns the colour image of an Image or CompressedImage."""
    if hasattr(message, "format"):
        return pixels.color(bytes(message.data))
    found = values(message, ("rgb8", "bgr8"))
    if message.encoding == "bgr8":
        found = found[..., ::-1]
    return np.ascontiguousarray(found)


def depth(message: RosMessage) -> Depth:
    """Returns the depth (h, w) [m] of an Image or CompressedImage; its integers are millimetres, its floats metres."""
    if not hasattr(message, "format"):
        return pixels.metres(values(message, ("16UC1", "mono16", "32FC1"))[..., 0])
    # `compressed_depth_image_transport` puts before the PNG a format, and A and B of depth = A / (value - B).
    data = bytes(message.data)
    described = str(message.format)
    if "rvl" in described.lower():
        raise MessageRejected("expected compressed depth as PNG, got RVL")
    if "compressedDepth" not in described:
        return pixels.metres(pixels.sixteen_bits(data))
    before = struct.Struct("<iff")
    if len(data) < before.size:
        raise MessageRejected(f"expected a header of {before.size} bytes, got {len(data)} bytes")
    _, a, b = before.unpack_from(data)
    numbers = pixels.sixteen_bits(data[before.size :])
    if not described.startswith("32FC1"):
        return pixels.metres(numbers)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        inverse = (a / (numbers.astype(np.float64) - b)).astype(np.float32)
    return pixels.metres(np.where(numbers == 0, np.float32(np.nan), inverse))


def labels(message: RosMessage) -> NDArray[np.integer]:
    """Returns the numbers (h, w) of an Image that says of each pixel which object it is of, 0: of none."""
    return values(message, ("mono8", "8UC1", "mono16", "16UC1", "32SC1"))[..., 0].astype(np.int32)


def values(message: RosMessage, expected: tuple[str, ...]) -> NDArray[np.generic]:
    """Returns the pixels (h, w, channels) of an Image, whose rows may be padded; `expected`: encodings to accept."""
    if message.encoding not in expected:
        raise MessageRejected(f"expected encoding {', '.join(expected)}, got {message.encoding[:20]!r}")
    kind, channels = LAYOUTS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    h = int(message.height)
    w = int(message.width)
    step = int(message.step)
    row = w * channels * dtype.itemsize
    size = step * (h - 1) + row
    if min(h, w) == 0 or step < row or len(message.data) < size:
        rows = f"{h} rows of {step} bytes for {w} x {h} {message.encoding}"
        raise MessageRejected(f"expected {rows}, got {len(message.data)} bytes")
    strides = step, channels * dtype.itemsize, dtype.itemsize
    return np.ascontiguousarray(np.ndarray((h, w, channels), dtype, message.data, strides=strides))


def camera(message: RosMessage) -> Camera:
    """Returns the camera of a CameraInfo of ROS 1 or 2, as it is for its cropped and binned images."""
    of_ros1 = hasattr(message, "K")
    K = np.array(message.K if of_ros1 else message.k, dtype=np.float64).reshape(3, 3)
    lens = np.array(message.D if of_ros1 else message.d, dtype=np.float64)
    if not (K[[0, 1], [0, 1]] > 0).all():
        raise MessageRejected("expected focal lengths above 0, got an uncalibrated camera")
    model = message.distortion_model
    count = LENSES.get(model, 0)
    if model not in LENSES and (model or lens.any()):
        raise MessageRejected(f"expected a distortion model {' or '.join(LENSES)}, got {model[:40]!r}")
    if lens[count:].any():
        raise MessageRejected(f"expected at most {count} numbers of a {model} lens, got {len(lens)}")
    lens = lens[:count] if lens.any() else np.zeros(0)
    # The message's intrinsics and size are those of the complete sensor; they are of the images that come here.
    roi = message.roi
    binned = np.maximum([message.binning_x, message.binning_y], 1)
    width = roi.width or message.width
    height = roi.height or message.height
    K[[0, 1], [0, 1]] /= binned
    corner = K[:2, 2] - [roi.x_offset, roi.y_offset] + 0.5
    K[:2, 2] = corner / binned - 0.5  # pixel centres are at whole numbers
    return Camera(K, (int(width // binned[0]), int(height // binned[1])), lens)
