"""Colour for depth images: the colour of each depth pixel, from a camera at another place."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from handsight import se3
from handsight._deprecated import renamed_members
from handsight.camera import Camera
from handsight.checks import Mask
from handsight.errors import InvalidInput
from handsight.vision.pixels import Color


@renamed_members(seen="visible")
class Registered(NamedTuple):
    """A `Registered` has the colours of a depth image's pixels."""

    color: Color  # (h, w, 3) red, green, blue of each pixel; 0 where it is not visible to the colour camera
    visible: Mask  # (h, w) whether it is


def register_color(
    depth: ArrayLike, camera: Camera, color: Color, color_camera: Camera, T_color_depth: ArrayLike
) -> Registered:
    """Returns the colour of each pixel of a depth image (h, w) [m] of `camera`.

    `color` (H, W, 3) of `color_camera`, which has the depth camera's frame at `T_color_depth` (4, 4). A pixel without
    depth has no colour, nor has one that is hidden from the colour camera by the surface of the depth image; at its
    edges the near side is taken to go on to the far one. A thing that only the colour camera sees may give its colour
    to what is behind it. Raises InvalidInput for images of another size than their cameras'.
    """
    image, (width, height) = np.asarray(color), color_camera.size
    if image.shape != (height, width, 3) or image.dtype != np.uint8:
        expected = f"bytes of shape {(height, width, 3)} as its camera's"
        raise InvalidInput(f"color: expected {expected}, got {image.dtype} of {image.shape}")
    points = camera.points(depth)
    known = np.isfinite(points[..., 2])
    flat = np.nan_to_num(points.astype(np.float64)).reshape(-1, 3)
    placed = se3.apply(se3.check(T_color_depth, "T_color_depth"), flat)
    places = np.arange(known.size).reshape(known.shape)
    a, b, c, d = places[:-1, :-1], places[:-1, 1:], places[1:, :-1], places[1:, 1:]
    faces = np.stack([a, b, c, b, d, c], axis=-1).reshape(-1, 3)  # between neighbouring pixels
    surface = color_camera.draw(placed, faces[known.ravel()[faces].all(axis=1)]).depth
    pixels = np.full((placed.shape[0], 2), np.nan)
    pixels[known.ravel()] = color_camera.project(placed[known.ravel()])
    columns, rows = np.rint(np.nan_to_num(pixels, nan=-1)).astype(np.int64).T
    visible = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    columns, rows = columns.clip(0, width - 1), rows.clip(0, height - 1)
    visible &= placed[:, 2] < surface[rows, columns] + 0.01  # what is a centimetre behind a surface is hidden
    found = np.where(visible[:, None], image[rows, columns], np.uint8(0))
    return Registered(found.reshape(*known.shape, 3), visible.reshape(known.shape))
