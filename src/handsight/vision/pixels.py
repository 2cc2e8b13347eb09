"""Depth and colour images as bytes and whole numbers hold them, to metres and red, green, blue."""

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
    """`DepthLimits` are what a depth image may hold."""

    max_pixels: int = 20_000_000  # of a compressed image, before it is unpacked; a kilobyte may hold as many
    min_median: float = 0.02
    """Median of what a depth camera measures, at least: below it the unit is another [m]."""
    max_median: float = 20.0  # and at most [m]


DEPTH_LIMITS = DepthLimits()

MILLIMETRE = 1e-3


def metres(pixels: NDArray[np.generic], scale: float = MILLIMETRE) -> Depth:
    """Returns depth (h, w) [m], NaN where there is none; of whole numbers, `scale` metres each and 0 for none, or of
    metres.

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
        raise InvalidInput(f"expected depth in {_called(unit)}, got a median of {median:.4g} ({guess})")
    return depth * np.float32(unit) if is_integer else depth


def _called(unit: float) -> str:
    names = {1.0: "metres (32FC1)", MILLIMETRE: "millimetres (16UC1)"}
    return names.get(unit, f"units of {1e3 * unit:g} mm")


Pixel = TypeVar("Pixel", bound=np.generic)


def color(data: bytes) -> Color:
    """Returns red, green, blue (h, w, 3) of the bytes of a PNG or JPEG; raises InvalidInput, MissingExtra."""
    return _opened(data, lambda image: np.asarray(image.convert("RGB"), dtype=np.uint8))


def sixteen_bits(data: bytes) -> NDArray[np.uint16]:
    """Returns the numbers (h, w) of the bytes of a PNG of 16 bits; raises InvalidInput, MissingExtra."""
    return _opened(data, _sixteen_bits)


def _sixteen_bits(image: "Image") -> NDArray[np.uint16]:
    if not image.mode.startswith("I"):
        raise InvalidInput(f"expected a PNG of 16 bits for depth, got mode {image.mode}")
    return np.asarray(image).astype(np.uint16)


def _opened(data: bytes, read: Callable[["Image"], NDArray[Pixel]]) -> NDArray[Pixel]:
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
