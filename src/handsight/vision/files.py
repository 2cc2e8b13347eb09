"""Depth, colour and intrinsics from files: PNG, JPEG, and a small JSON."""

from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from handsight import checks
from handsight.camera import MAX_PIXELS, Camera, Depth, check_lens
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import decode
from handsight.vision import pixels
from handsight.vision.pixels import MILLIMETRE, Color

Pixel = TypeVar("Pixel", bound=np.generic)


class FileLimits(NamedTuple):
    """`FileLimits` bound what files of images and cameras may hold."""

    max_image: int = 200_000_000  # bytes of an image
    max_camera: int = 100_000  # bytes of a camera
    min_scale: float = 1e-7  # least size of one step of a depth image [m]
    max_scale: float = 1.0  # and largest [m]


FILES = FileLimits()

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
    form = decode(read_bytes(path, FILES.max_camera), CameraForm, str(path))
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
    if not FILES.min_scale <= unit <= FILES.max_scale:
        expected = f"expected metres from {FILES.min_scale:g} to {FILES.max_scale:g}"
        raise InvalidInput(f"scale: {expected}, got {unit:g} (millimetres?)")
    data = read_bytes(path, FILES.max_image)
    try:
        depth = pixels.metres(_of_size(pixels.sixteen_bits(data), camera), unit)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None
    if np.isnan(depth).all():
        raise InvalidFile(f"{path}: expected depth, got none at any pixel")
    return depth


def read_color(path: str | Path, *, camera: Camera | None = None) -> Color:
    """Returns red, green, blue (h, w, 3) of a PNG or JPEG, which must have the size of `camera`; raises InvalidFile,
    MissingExtra."""
    data = read_bytes(path, FILES.max_image)
    try:
        return _of_size(pixels.color(data), camera)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None


def _of_size(image: NDArray[Pixel], camera: Camera | None) -> NDArray[Pixel]:
    height, width = image.shape[:2]
    if camera is not None and (width, height) != camera.size:
        expected, across = camera.size
        raise InvalidInput(f"expected {expected} x {across} pixels as the camera's, got {width} x {height}")
    return image
