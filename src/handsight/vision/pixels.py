"""Depth and colour images, and cameras, from files and from bytes: in metres, and in red, green, blue."""

import io
import struct
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from handsight import checks
from handsight.camera import MAX_PIXELS, Camera, Depth, check_lens
from handsight.checks import MAX_DISTANCE
from handsight.errors import InvalidFile, InvalidInput, needing
from handsight.files import read_bytes
from handsight.msgspec_errors import decode

if TYPE_CHECKING:
    from PIL.Image import Image

Color = NDArray[np.uint8]
Pixel = TypeVar("Pixel", bound=np.generic)
MILLIMETRE = 1e-3
MAX_IMAGE, MAX_CAMERA = 200_000_000, 100_000  # bytes of the files of an image and of a camera
MOST_PIXELS = 20_000_000  # of a compressed image, which a kilobyte may hold
MIN_SCALE, MAX_SCALE = 1e-7, 1.0  # of one step of a depth image [m]
MIN_MEDIAN, MAX_MEDIAN = 0.02, 20.0  # of a depth image, below and above which its unit is another [m]
Pixels = Annotated[float, Meta(gt=0, le=1e6)]
Side = Annotated[int, Meta(gt=0, le=MAX_PIXELS)]


class CameraForm(msgspec.Struct, forbid_unknown_fields=True):
    """A `CameraForm` has the keys of a camera's file [pixels]."""

    fx: Pixels
    fy: Pixels
    cx: float
    cy: float
    width: Side
    height: Side
    lens: list[float] = []

    def __post_init__(self) -> None:
        check_lens(self.lens, "lens")


def read_camera(path: str | Path) -> Camera:
    """Returns the camera of a JSON file; raises InvalidFile with the file's name and the key.

    Its keys: fx, fy, cx, cy, width, height [pixels], and where images are not rectified `lens`: k1, k2, p1, p2[, k3[,
    k4, k5, k6]] of OpenCV.
    """
    form = decode(read_bytes(path, MAX_CAMERA), CameraForm, str(path))
    K = np.array([[form.fx, 0, form.cx], [0, form.fy, form.cy], [0, 0, 1.0]])
    try:
        return Camera(K, (form.width, form.height), np.array(form.lens))
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None


def read_depth(path: str | Path, scale: float = MILLIMETRE, *, camera: Camera | None = None) -> Depth:
    """Returns the depth (h, w) [m] of a PNG of 16 bits, NaN where it holds 0.

    `scale`: metres of a step; of a BOP scene a thousandth of its `depth_scale`. `camera`: whose size the image must
    have. Raises InvalidFile for what is no such image, for one of another size or without any depth, and where the
    median depth (below 2 cm or beyond 20 m) says that the unit is another; InvalidInput for the scale; MissingExtra.
    """
    unit = checks.positive(scale, "scale")
    if not MIN_SCALE <= unit <= MAX_SCALE:
        expected = f"expected metres from {MIN_SCALE:g} to {MAX_SCALE:g}"
        raise InvalidInput(f"scale: {expected}, got {unit:g} (millimetres?)")
    data = read_bytes(path, MAX_IMAGE)
    try:
        depth = metres(_of_size(sixteen_bits(data), camera), unit)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None
    if np.isnan(depth).all():
        raise InvalidFile(f"{path}: expected depth, got none at any pixel")
    return depth


def read_color(path: str | Path, *, camera: Camera | None = None) -> Color:
    """Returns red, green, blue (h, w, 3) of a PNG or JPEG of the size of `camera`; raises InvalidFile, MissingExtra."""
    data = read_bytes(path, MAX_IMAGE)
    try:
        return _of_size(color(data), camera)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None


def metres(pixels: NDArray[np.generic], scale: float = MILLIMETRE) -> Depth:
    """Returns the depth (h, w) [m], NaN where there is none, of whole numbers of `scale` metres, or of metres. Raises
    InvalidInput where the median says that the unit is another."""
    is_integer = pixels.dtype.kind in "iu"
    unit = scale if is_integer else 1.0
    depth = pixels.astype(np.float32)
    with np.errstate(invalid="ignore"):
        depth[~((depth > 0) & (depth < (np.inf if is_integer else MAX_DISTANCE)))] = np.nan
    sample = depth[::4, ::4]
    known = sample[~np.isnan(sample)]
    median = float(np.median(known)) if known.size else np.nan
    if unit * median < MIN_MEDIAN or unit * median > MAX_MEDIAN:
        guess = "another unit?" if is_integer or median < MIN_MEDIAN else "millimetres?"
        if is_integer and unit == MILLIMETRE and median > MAX_MEDIAN:
            guess += " --depth-scale 0.0001 is for tenths of millimetres"
        names = {1.0: "metres (32FC1)", MILLIMETRE: "millimetres (16UC1)"}
        expected = names.get(unit, f"units of {1e3 * unit:g} mm")
        raise InvalidInput(f"expected depth in {expected}, got a median of {median:.4g} ({guess})")
    return depth * np.float32(unit) if is_integer else depth


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
    with needing("images need pillow", "vision"):
        from PIL import Image
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG")) as image:
                if image.width * image.height > MOST_PIXELS:
                    raise InvalidInput(f"expected at most {MOST_PIXELS} pixels, got {image.size}")
                pixels = read(image)
                # Pillow leaves rows black that a PNG lacks, and says nothing.
                last = image.crop((0, image.height - 1, image.width, image.height))
                if image.format == "PNG" and not any(last.tobytes()):
                    _check_rows(data)
                return pixels
    except InvalidInput:
        raise
    except Exception as error:  # pillow's plugins raise many kinds; each says that the bytes are no image
        raise InvalidInput(f"expected a PNG or JPEG, got: {str(error)[:80]}") from None


def _check_rows(png: bytes) -> None:
    """Raises InvalidInput where a PNG, which pillow has read, holds fewer rows of pixels than it declares."""
    width, height, bits, kind, *_, interlaced = struct.unpack(">IIBBBBB", png[16:29])
    bits *= {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[kind]
    # Of Adam7's passes: first column and row, and the steps to the next ones.
    adam7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
    expected, at, packed = 0, 8, bytearray()
    for x, y, dx, dy in adam7 if interlaced else ((0, 0, 1, 1),):
        columns, rows = -(-(width - x) // dx), -(-(height - y) // dy)
        if columns > 0 and rows > 0:
            expected += rows * (1 + -(-columns * bits // 8))
    while at + 8 <= len(png) and png[at + 4 : at + 8] != b"IEND":
        (length,) = struct.unpack(">I", png[at : at + 4])
        packed += png[at + 8 : at + 8 + length] if png[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + length
    came = len(zlib.decompressobj().decompress(packed, expected))
    if came < expected:
        bytes_of = f"{came} bytes of pixels where it declares {expected}"
        raise InvalidInput(f"expected a complete PNG, got {bytes_of}")


def _of_size(image: NDArray[Pixel], camera: Camera | None) -> NDArray[Pixel]:
    """Returns the image; raises InvalidInput where it has another size than the camera."""
    height, width = image.shape[:2]
    if camera is not None and (width, height) != camera.size:
        expected, across = camera.size
        raise InvalidInput(f"expected {expected} x {across} pixels as the camera's, got {width} x {height}")
    return image
