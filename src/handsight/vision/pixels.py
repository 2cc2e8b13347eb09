"""Depth and colour images, and cameras, from files and from bytes: in metres, and in red, green, blue."""

import io
import tempfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from handsight import checks
from handsight.camera import Camera, Depth
from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidFile, InvalidInput, MissingExtra, needing
from handsight.files import read_bytes

if TYPE_CHECKING:
    from PIL.Image import Image

Color = NDArray[np.uint8]
Pixel = TypeVar("Pixel", bound=np.generic)
MILLIMETRE = 1e-3
PNG_END = b"IEND"  # chunk after all pixels of a PNG
MAX_IMAGE = 200_000_000  # bytes of an image's file
MOST_PIXELS = 20_000_000  # of a compressed image, which a kilobyte may hold
MIN_SCALE, MAX_SCALE = 1e-7, 1.0  # of one step of a depth image [m]
EXR_DEPTH = ("z", "depth", "v")
"""Names of a channel of depth, behind those of a layer, as Blender writes them."""
SENTINEL_SHARE = 0.01
SENTINEL_LEAST = 20
SENTINEL_GAP = 1.5
"""A value stands for no measurement where more than this share of a sample of pixels, and more than so many, have it,
and all others are less by this factor."""
UNITS = {1.0: "metres", 1e-3: "millimetres", 2.5e-4: "steps of 0.25 mm", 2e-4: "TUM's 5000 steps a metre"}
UNITS |= {1e-4: "tenths of millimetres", 1e-6: "micrometres"}
"""Units that depth images have, in metres, and their names."""
MIN_MEDIAN, MAX_MEDIAN = 0.02, 20.0  # of a depth image, below and above which its unit is another [m]


def read_depth(path: str | Path, scale: float | None = None, *, camera: Camera | None = None) -> Depth:
    """Returns the depth (h, w) [m] of an image, NaN where nothing was measured; see `measured_depth`."""
    return measured_depth(path, scale, camera=camera).depth


class MeasuredDepth(NamedTuple):
    """A depth image from a file."""

    depth: Depth
    """(h, w) [m], NaN where nothing was measured."""
    note: str
    """Which value was taken for no measurement, with its share of the pixels; empty where none was."""
    whole: bool
    """Whether the file has whole numbers, of a unit of their own."""


def measured_depth(
    path: str | Path, scale: float | None = None, *, camera: Camera | None = None, step: float = MILLIMETRE
) -> MeasuredDepth:
    """Returns the depth of a PNG or TIFF of 16 bits or of floats, a NumPy array (.npy) or an EXR.

    `scale`: metres of a step; None: floats are metres, and whole numbers are in steps of `step` metres. `camera`: whose
    size the image must have. Zero, NaN, infinity, and a largest value that stands for no measurement (`_sentinel`) are
    no depth. Raises InvalidFile for what is no such image, for one of another size or without any depth, and where the
    median depth (below 2 cm or beyond 20 m) says that the unit is another; InvalidInput for the scale; MissingExtra.
    """
    if scale is not None and not MIN_SCALE <= checks.positive(scale, "scale") <= MAX_SCALE:
        expected = f"expected metres from {MIN_SCALE:g} to {MAX_SCALE:g}"
        raise InvalidInput(f"scale: {expected}, got {scale:g} (millimetres?)")
    data = read_bytes(path, MAX_IMAGE)
    try:
        pixels = _of_size(depth_numbers(data), camera)
        depth = metres(pixels, scale or (step if pixels.dtype.kind in "iu" else None))
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None
    sentinel = _sentinel(pixels)
    share = float(np.mean(pixels == sentinel))
    note = f"{100 * share:.0f} % of pixels are {sentinel:g}: no measurement" if share else ""
    if np.isnan(depth).all():
        raise InvalidFile(f"{path}: expected depth, got none at any pixel{f' ({note})' if note else ''}")
    return MeasuredDepth(depth, note, pixels.dtype.kind in "iu")


def _sentinel(pixels: NDArray[Any]) -> float:
    """Returns the value by which an image says, beside 0 and NaN, that a pixel has no depth.

    It is the largest number of the type, infinity for floats; or the largest value, where many pixels have it and no
    other is near: a far plane, or the end of a camera's range.
    """
    ends = float(np.inf if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max)
    sample = pixels[::4, ::4]
    known = sample[(sample > 0) & (sample < ends)]
    if not known.size:
        return ends
    largest = float(known.max())
    others = known[known < largest]
    apart = others.size > 0 and largest > SENTINEL_GAP * float(others.max())
    many = known.size - others.size > max(SENTINEL_LEAST, SENTINEL_SHARE * sample.size)
    return largest if apart and many else ends


def read_color(path: str | Path, *, camera: Camera | None = None) -> Color:
    """Returns red, green, blue (h, w, 3) of a PNG or JPEG of the size of `camera`; raises InvalidFile, MissingExtra."""
    data = read_bytes(path, MAX_IMAGE)
    try:
        return _of_size(color(data), camera)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None


def metres(pixels: NDArray[Any], scale: float | None = None) -> Depth:
    """Returns the depth (h, w) [m], NaN where there is none, of numbers in steps of `scale` metres; None: whole numbers
    are millimetres, floats are metres. Raises InvalidInput where the median says that the unit is another."""
    is_integer = pixels.dtype.kind in "iu"
    unit = scale or (MILLIMETRE if is_integer else 1.0)
    depth = pixels.astype(np.float32)
    with np.errstate(invalid="ignore"):
        depth[~((depth > 0) & (depth * unit < MAX_DISTANCE) & (pixels != _sentinel(pixels)))] = np.nan
    sample = depth[::4, ::4]
    known = sample[~np.isnan(sample)]
    median = float(np.median(known)) if known.size else np.nan
    if unit * median < MIN_MEDIAN or unit * median > MAX_MEDIAN:
        names = {1.0: "metres (32FC1)", MILLIMETRE: "millimetres (16UC1)"}
        expected = names.get(unit, f"units of {1e3 * unit:g} mm")
        raise InvalidInput(
            f"expected depth in {expected}, got a median of {median:.4g} ({_other_units(median)})"
        )
    return depth if unit == 1 else depth * np.float32(unit)


def _other_units(median: float) -> str:
    """Returns the units in which a median of depth is one of a scene."""
    fitting = [
        f"{unit:g} for {name}" for unit, name in UNITS.items() if MIN_MEDIAN < unit * median < MAX_MEDIAN
    ]
    return f"another unit? its scale would be {', or '.join(fitting)}" if fitting else "another unit?"


def color(data: bytes) -> Color:
    """Returns red, green, blue (h, w, 3) from the bytes of a PNG or JPEG; raises InvalidInput, MissingExtra."""
    return _opened(data, lambda image: np.asarray(image.convert("RGB"), dtype=np.uint8), ("PNG", "JPEG"))


def depth_numbers(data: bytes) -> NDArray[Any]:
    """Returns the numbers (h, w) of a depth image from its bytes, told apart by how they begin; raises InvalidInput,
    MissingExtra."""
    if data.startswith(b"\x93NUMPY"):
        image = numpy_array(data).squeeze()
        if image.ndim != 2 or image.size > MOST_PIXELS:
            raise InvalidInput(f"expected depth of shape (h, w), got {image.shape}")
        return image
    if data.startswith(b"\x76\x2f\x31\x01"):
        return _exr(data)

    def read(image: "Image") -> NDArray[Any]:
        if image.mode == "F":
            return np.asarray(image)
        if not image.mode.startswith("I"):
            raise InvalidInput(
                f"expected depth of 16 bits or of floats, got mode {image.mode} (a picture of it?)"
            )
        return np.asarray(image).astype(np.uint16)

    return _opened(data, read, ("PNG", "TIFF"))


def sixteen_bits(data: bytes) -> NDArray[np.uint16]:
    """Returns the numbers (h, w) from the bytes of a PNG of 16 bits; raises InvalidInput, MissingExtra."""
    numbers = depth_numbers(data)
    if numbers.dtype != np.uint16:
        raise InvalidInput(f"expected a PNG of 16 bits for depth, got {numbers.dtype}")
    return numbers.astype(np.uint16, copy=False)


def numpy_array(data: bytes) -> NDArray[Any]:
    """Returns the numbers in the bytes of a .npy file; raises InvalidInput."""
    try:
        numbers = np.lib.format.read_array(io.BytesIO(data))
    except (ValueError, EOFError, MemoryError, TypeError, OverflowError) as error:
        raise InvalidInput(f"expected a NumPy array of numbers, got: {str(error)[:80]}") from None
    if numbers.dtype.kind not in "fiu":
        raise InvalidInput(f"expected a NumPy array of numbers, got {numbers.dtype}")
    return np.asarray(numbers)


def _exr(data: bytes) -> NDArray[Any]:
    """Returns the channel of depth, else the first one (h, w), of an EXR's bytes; raises InvalidInput, MissingExtra."""
    try:
        OpenEXR = import_module("OpenEXR")
    except ImportError:
        raise MissingExtra(
            "EXR images need OpenEXR: pip install OpenEXR, or save the depth as .npy"
        ) from None
    with tempfile.NamedTemporaryFile(suffix=".exr") as file:  # it reads no bytes
        file.write(data)
        file.flush()
        try:
            channels = OpenEXR.File(file.name, separate_channels=True).channels()
            planes = {name: np.asarray(channel.pixels) for name, channel in channels.items()}
        except Exception as error:  # bindings raise whatever they meet
            raise InvalidInput(f"expected an EXR, got: {str(error)[:80]}") from None
    depths = [planes[name] for name in planes if name.rpartition(".")[2].lower() in EXR_DEPTH]
    plane = next(iter([*depths, *planes.values()]), np.empty(0))
    if plane.ndim != 2 or plane.size > MOST_PIXELS:
        came = ", ".join(planes) or "none"
        raise InvalidInput(f"expected an EXR with a channel of depth (h, w), got {came}")
    return plane


def _opened(
    data: bytes, read: Callable[["Image"], NDArray[Pixel]], formats: tuple[str, str]
) -> NDArray[Pixel]:
    """Returns what `read` makes of an image from its bytes; raises InvalidInput, MissingExtra."""
    with needing("images need pillow", "vision"):
        from PIL import Image
    try:
        with Image.open(io.BytesIO(data), formats=formats) as image:
            if image.width * image.height > MOST_PIXELS:
                raise InvalidInput(f"expected at most {MOST_PIXELS} pixels, got {image.size}")
            pixels = read(image)
            # Pillow leaves rows black that a PNG lacks, and says nothing.
            if image.format == "PNG" and PNG_END not in data:
                raise InvalidInput("expected a complete PNG, got a part of its pixels")
            return pixels
    except InvalidInput:
        raise
    except Exception as error:  # pillow's plugins raise many kinds; each says that the bytes are no image
        came = "other bytes" if "cannot identify" in str(error) else str(error)[:80]
        raise InvalidInput(f"expected a {' or '.join(formats)}, got: {came}") from None


def _of_size(image: NDArray[Pixel], camera: Camera | None) -> NDArray[Pixel]:
    """Returns the image; raises InvalidInput where it has another size than the camera."""
    height, width = image.shape[:2]
    if camera is not None and (width, height) != camera.size:
        expected, across = camera.size
        raise InvalidInput(f"expected {expected} x {across} pixels as the camera's, got {width} x {height}")
    return image
