"""Depth and colour images from bytes and whole numbers: in metres, and in red, green, blue."""

import io
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from handsight.camera import Depth
from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidInput, MissingExtra

if TYPE_CHECKING:
    from PIL.Image import Image


Color = NDArray[np.uint8]


class DepthLimits(NamedTuple):
    """`DepthLimits` bound what an image may hold."""

    max_pixels: int = 20_000_000  # of a compressed image, which a kilobyte may hold
    min_median: float = 0.02  # of a depth image: below it the unit is another [m]
    max_median: float = 20.0  # and above it [m]


DEPTH_LIMITS = DepthLimits()

MILLIMETRE = 1e-3


def metres(pixels: NDArray[np.generic], scale: float = MILLIMETRE) -> Depth:
    """Returns the depth (h, w) [m], NaN where there is none, of whole numbers of `scale` metres, or of metres.

    Raises InvalidInput where the median says that the unit is another.
    """
    is_integer = pixels.dtype.kind in "iu"
    unit = scale if is_integer else 1.0
    depth = pixels.astype(np.float32)
    with np.errstate(invalid="ignore"):
        depth[~((depth > 0) & (depth < (np.inf if is_integer else MAX_DISTANCE)))] = np.nan
    sample = depth[::4, ::4]
    known = sample[~np.isnan(sample)]
    median = float(np.median(known)) if known.size else np.nan
    if unit * median < DEPTH_LIMITS.min_median or unit * median > DEPTH_LIMITS.max_median:
        guess = "another unit?" if is_integer or median < DEPTH_LIMITS.min_median else "millimetres?"
        names = {1.0: "metres (32FC1)", MILLIMETRE: "millimetres (16UC1)"}
        expected = names.get(unit, f"units of {1e3 * unit:g} mm")
        raise InvalidInput(f"expected depth in {expected}, got a median of {median:.4g} ({guess})")
    return depth * np.float32(unit) if is_integer else depth


Pixel = TypeVar("Pixel", bound=np.generic)


def color(data: bytes) -> Color:
    """Returns red, green, blue (h, w, 3) from the bytes of a PNG or JPEG; raises InvalidInput, MissingExtra."""
    return _opened(data, lambda image: np.asarray(image.convert("RGB"), dtype=np.uint8))


def sixteen_bits(data: bytes) -> NDArray[np.uint16]:
    """Returns the numbers (h, w) from the bytes of a PNG of 16 bits; raises InvalidInput, MissingExtra."""

    def read(image: "Image") -> NDArray[np.uint16]:
        if not image.mode.startswith("I"):
            raise InvalidInput(f"expected a PNG of 16 bits for depth, got mode {image.mode}")
        return np.asarray(image).astype(np.uint16)

    return _opened(data, read)


def _opened(data: bytes, read: Callable[["Image"], NDArray[Pixel]]) -> NDArray[Pixel]:
    """Returns what `read` makes of an image from its bytes; raises InvalidInput, MissingExtra."""
    try:
        from PIL import Image
    except ImportError:
        raise MissingExtra("images need pillow: pip install 'handsight[vision]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
                if image.width * image.height > DEPTH_LIMITS.max_pixels:
                    raise InvalidInput(f"expected at most {DEPTH_LIMITS.max_pixels} pixels, got {image.size}")
                return read(image)
    except InvalidInput:
        raise
    except Exception as error:  # pillow's plugins raise many kinds; each says that the bytes are no image
        raise InvalidInput(f"expected a PNG or JPEG, got: {str(error)[:80]}") from None
