"""A camera's image made small, with the object's outline over it, and its depth as points in the palm."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import CameraFromPalm
from handsight.viewer.silhouette import silhouette
from handsight.vision import pixels
from handsight.vision.pixels import Color


class PictureOptions(NamedTuple):
    """`PictureOptions` are what is shown of an image."""

    max_width: int = 320  # of an image that is shown [pixels]
    around: float = 0.25  # half of what is shown around the palm, where that is in the image [m]
    min_around: float = 40.0  # and how little at least [pixels]
    max_points: int = 3000  # of a cloud
    jpeg_quality: int = 80  # of a JPEG
    max_range: float = 0.2  # points farther from the palm are not shown [m]: they are the room's
    grey: int = 110  # of points whose colour is not known


PICTURE = PictureOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A `Picture` is an image of the rig's camera."""

    camera: Camera | None
    """Of these pixels; None: nobody knows."""
    image: Color | bytes
    """(h, w, 3) colour, else depth in grey, near ones light; or that as a JPEG."""
    points_palm: NDArray[np.floating]
    """(n, 3) [m]; none where the camera's place is not known."""
    colors: Color
    """(n, 3) of the points."""
    T_camera_palm: Array | None
    """(4, 4) as the hand in images has shown, else as calibrated; None where nobody knows."""
    T_camera_palm_calibrated: Array | None
    """(4, 4) with the calibration's error in it, as what vision measures is placed in the palm."""

    def with_outlines(self, model: ObjectModel, outlines: Mapping[tuple[int, int, int], Array]) -> Color:
        """Returns the image with the object's outlines: by colour, at T_camera_object (4, 4); the last one on top."""
        image = pixels.color(self.image) if isinstance(self.image, bytes) else self.image
        if self.camera is None or not outlines:
            return image
        image = image.copy()
        for color, T_camera_object in outlines.items():
            there = np.isfinite(silhouette(self.camera, model, T_camera_object))
            image[edge(there)] = color
        return image

    def packed(self) -> "Picture":
        """Returns the same in a fifth of the memory."""
        if isinstance(self.image, bytes):
            return self
        return replace(self, image=jpeg(self.image), points_palm=self.points_palm.astype(np.float16))


def edge(there: Mask) -> Mask:
    """Returns (h, w) the pixels just outside of an area, two wide."""
    grown = there.copy()
    for _ in range(2):  # scipy.ndimage takes twenty times as long
        before = grown.copy()
        grown[1:] |= before[:-1]
        grown[:-1] |= before[1:]
        grown[:, 1:] |= before[:, :-1]
        grown[:, :-1] |= before[:, 1:]
    return grown & ~there


def jpeg(image: Color) -> bytes:
    """Returns an image (h, w, 3) as a file."""
    from PIL import Image  # which viser needs

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=PICTURE.jpeg_quality)
    return buffer.getvalue()


def picture(
    rig: Rig, observation: Observation, from_palm: CameraFromPalm, T_world_palm: Array | None
) -> Picture | None:
    """Returns what an observation's images show; None where it has none."""
    color, depth = observation.color, observation.depth
    # An image of other pixels than depth's is of another camera than the rig's.
    alike = color is not None and (depth is None or color.shape[:2] == depth.shape)
    if color is not None and alike:
        image = color
    elif depth is not None:
        image = _grey(depth)
    else:
        return None
    camera, T_calibrated = _camera_of(rig, image.shape), palm_in_camera(rig, CameraFromPalm(), T_world_palm)
    T_camera_palm = palm_in_camera(rig, from_palm, T_world_palm)
    points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    if camera is not None and depth is not None and T_camera_palm is not None:
        points, places = _cloud(camera, depth, T_camera_palm)
        colors = image.reshape(-1, 3)[places] if alike else np.full((len(points), 3), PICTURE.grey, np.uint8)
    shown = _window(camera, T_camera_palm, image)
    image = np.ascontiguousarray(image[shown])
    smaller = None if camera is None else _within(camera, shown, image)
    return Picture(smaller, image, points, colors, T_camera_palm, T_calibrated)


def palm_in_camera(rig: Rig, from_palm: CameraFromPalm, T_world_palm: Array | None) -> Array | None:
    """Returns T_camera_palm (4, 4): as the hand in the camera's images has shown, else as the camera was calibrated.

    None where the rig has no camera, or one in the world and the palm's place in it is not known.
    """
    mounted = rig.camera
    if mounted is None:
        return None
    T_mount_palm = np.eye(4) if mounted.on == "palm" else T_world_palm
    if T_mount_palm is None:
        return None
    if from_palm.confirmed:
        T_mount_palm = from_palm.confirmed[-1].expected(T_mount_palm)
    return np.asarray(se3.inverse(mounted.T_mount_camera) @ T_mount_palm)


def _camera_of(rig: Rig, shape: tuple[int, ...]) -> Camera | None:
    """Returns the rig's camera, if images of that shape (h, w) are its."""
    mounted = rig.camera
    if mounted is None or mounted.intrinsics is None or mounted.size != (shape[1], shape[0]):
        return None
    return Camera.of(mounted)


def _window(camera: Camera | None, T_camera_palm: Array | None, image: Color) -> tuple[slice, slice]:
    """Returns the rows and columns that are shown: around the hand where it is in the image, and not too many."""
    rows, columns = slice(0, image.shape[0]), slice(0, image.shape[1])
    if camera is not None and T_camera_palm is not None:
        pixel, focal = camera.project(T_camera_palm[None, :3, 3])[0], camera.matrix[0, 0]
        if np.isfinite(pixel).all() and ((pixel >= 0) & (pixel < camera.size)).all():
            half = max(focal * PICTURE.around / T_camera_palm[2, 3], PICTURE.min_around)
            rows, columns = (
                slice(int(max(middle - size, 0)), int(min(middle + size, end)) + 1)
                for middle, size, end in zip(pixel[::-1], (0.75 * half, half), image.shape[:2], strict=True)
            )
    step = max(1, -(-(columns.stop - columns.start) // PICTURE.max_width))
    return slice(rows.start, rows.stop, step), slice(columns.start, columns.stop, step)


def _within(camera: Camera, shown: tuple[slice, slice], image: Color) -> Camera:
    """Returns the camera of some of its rows and columns."""
    rows, columns = shown
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= columns.start, rows.start
    matrix[:2] /= columns.step
    return Camera(matrix, (image.shape[1], image.shape[0]), camera.lens)


def _grey(depth: Depth) -> Color:
    known = np.isfinite(depth) & (depth > 0)
    z = np.where(known, depth, 1)
    near, far = np.percentile(z[known][::16], [1, 95]) if known.any() else (0, 1)
    grey = np.where(known, 230 - 190 * np.clip((z - near) / max(far - near, 1e-6), 0, 1), 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def _cloud(camera: Camera, depth: Depth, T_camera_palm: Array) -> tuple[NDArray[np.float32], Indices]:
    """Returns points in the palm (n, 3) around it, and their places among the pixels (n,)."""
    points = camera.points(np.ascontiguousarray(depth)).reshape(-1, 3)
    center = T_camera_palm[:3, 3].astype(np.float32)
    with np.errstate(invalid="ignore"):
        places = np.flatnonzero(np.abs(points - center).max(axis=1) < PICTURE.max_range)
    places = places[:: max(1, -(-len(places) // PICTURE.max_points))]
    return se3.apply(se3.inverse(T_camera_palm), points[places].astype(float)).astype(np.float32), places
