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


def color(message: RosMessage) -> Color:
    """Returns the colour image of an Image or CompressedImage."""
    if hasattr(message, "format"):
        return pixels.color(bytes(message.data))
    found = values(message, ("rgb8", "bgr8"))
    return np.ascontiguousarray(found if message.encoding == "rgb8" else found[..., ::-1])


def depth(message: RosMessage) -> Depth:
    """Returns the depth (h, w) [m] of an Image or CompressedImage; its integers are millimetres, its floats metres."""
    if not hasattr(message, "format"):
        return pixels.metres(values(message, ("16UC1", "mono16", "32FC1"))[..., 0])
    # `compressed_depth_image_transport` puts before the PNG a format, and A and B of depth = A / (value - B).
    before, data, described = struct.Struct("<iff"), bytes(message.data), str(message.format)
    if "rvl" in described.lower():
        raise MessageRejected("expected compressed depth as PNG, got RVL")
    if "compressedDepth" not in described:
        return pixels.metres(pixels.sixteen_bits(data))
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
    h, w, step = int(message.height), int(message.width), int(message.step)
    row = w * channels * dtype.itemsize
    if h == 0 or w == 0 or step < row or len(message.data) < step * (h - 1) + row:
        rows = f"{h} rows of {step} bytes for {w} x {h} {message.encoding}"
        raise MessageRejected(f"expected {rows}, got {len(message.data)} bytes")
    strides = step, channels * dtype.itemsize, dtype.itemsize
    return np.ascontiguousarray(np.ndarray((h, w, channels), dtype, message.data, strides=strides))


def camera(message: RosMessage) -> Camera:
    """Returns the camera of a CameraInfo of ROS 1 or 2, as it is for its cropped and binned images."""
    K = np.array(message.K if hasattr(message, "K") else message.k, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(K).all():
        raise MessageRejected("intrinsics are not finite", nan=True)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise MessageRejected("expected focal lengths above 0, got an uncalibrated camera")
    limit = 1e6  # no focal length or principal point is larger [pixels]
    if (most := np.abs(K).max()) > limit:
        raise MessageRejected(f"expected intrinsics within {limit:g} pixels, got {most:g}")
    # The message's intrinsics and size are those of the complete sensor.
    roi, size = message.roi, [int(message.width), int(message.height)]
    x, y = (roi.x_offset, roi.width, message.binning_x), (roi.y_offset, roi.height, message.binning_y)
    for axis, (first, side, binned) in enumerate((x, y)):
        by = max(int(binned), 1)
        # Pixel centres are at whole numbers, so the image begins at -½.
        K[axis, axis], K[axis, 2] = K[axis, axis] / by, (K[axis, 2] - first + 0.5) / by - 0.5
        size[axis] = (int(side) or size[axis]) // by
    # The distortion models that are supported, with their number of coefficients.
    lenses = {"plumb_bob": 5, "rational_polynomial": 8}
    model, lens = message.distortion_model, np.array(message.D if hasattr(message, "D") else message.d)
    if not np.isfinite(lens).all():
        raise MessageRejected("the lens' numbers are not finite", nan=True)
    if model not in lenses and (model or lens.any()):
        raise MessageRejected(f"expected a distortion model {' or '.join(lenses)}, got {model[:40]!r}")
    count = lenses.get(model, 0)
    if lens[count:].any():
        raise MessageRejected(f"expected at most {count} numbers of a {model} lens, got {len(lens)}")
    lens = lens[:count].astype(np.float64)
    return Camera(K, (size[0], size[1]), lens if lens.any() else np.zeros(0))
