"""What a CameraInfo says of its camera."""

import numpy as np

from handsight.camera import Camera
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.messages.topics import MessageRejected, RosMessage

LENSES = {"plumb_bob": 5, "rational_polynomial": 8}
"""Distortion models of CameraInfo that a pinhole behind a lens is, and how many numbers they have."""
MAX_PIXELS_ACROSS = 1e6
"""No focal length or principal point is larger [pixels]."""


def intrinsics(message: RosMessage) -> Camera:
    """Returns the camera of a CameraInfo of ROS 1 or 2; raises MessageRejected."""
    K = np.array(message.K if hasattr(message, "K") else message.k, dtype=np.float64).reshape(3, 3)
    if not np.isfinite(K).all():
        raise MessageRejected("intrinsics are not finite", nan=True)
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise MessageRejected("expected focal lengths above 0, got an uncalibrated camera")
    if np.abs(K).max() > MAX_PIXELS_ACROSS:
        most = np.abs(K).max()
        raise MessageRejected(f"expected intrinsics within {MAX_PIXELS_ACROSS:g} pixels, got {most:g}")
    K, size = _cut(K, message)
    try:
        return Camera(K, size, _lens(message))
    except InvalidInput as error:
        raise MessageRejected(str(error)) from None


def _lens(message: RosMessage) -> Array:
    """Returns the lens' numbers, none where they are all zero; raises MessageRejected for a lens of another kind."""
    model, lens = message.distortion_model, np.array(message.D if hasattr(message, "D") else message.d)
    if not np.isfinite(lens).all():
        raise MessageRejected("the lens' numbers are not finite", nan=True)
    if model not in LENSES and (model or lens.any()):
        raise MessageRejected(f"expected a distortion model {' or '.join(LENSES)}, got {model[:40]!r}")
    most = LENSES.get(model, 0)
    if lens[most:].any():
        raise MessageRejected(f"expected at most {most} numbers of a {model} lens, got {len(lens)}")
    lens = lens[:most].astype(np.float64)
    return lens if lens.any() else np.zeros(0)


def _cut(K: Array, message: RosMessage) -> tuple[Array, tuple[int, int]]:
    """Returns the intrinsics and the size of the images that come, cut out and binned: the message's are the whole
    sensor's."""
    K, roi, size = K.copy(), message.roi, [int(message.width), int(message.height)]
    for axis, (first, side, binned) in enumerate(
        ((roi.x_offset, roi.width, message.binning_x), (roi.y_offset, roi.height, message.binning_y))
    ):
        by = max(int(binned), 1)
        # Centres of pixels are at whole numbers, so the image begins at -½.
        K[axis, axis], K[axis, 2] = K[axis, axis] / by, (K[axis, 2] - first + 0.5) / by - 0.5
        size[axis] = (int(side) or size[axis]) // by
    return K, (size[0], size[1])
