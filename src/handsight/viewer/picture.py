"""A camera's image, reduced, with the object's outline over it, and its depth as points in the palm."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array, Mask
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import CameraFromPalm
from handsight.viewer.shapes import grey, silhouette
from handsight.vision import pixels
from handsight.vision.pixels import Color


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A `Picture` is an image of the rig's camera."""

    camera: Camera | None  # the camera of these pixels; None where it is not known
    image: Color | bytes  # colour (h, w, 3), or depth in grey, the nearer the lighter; or either as JPEG
    points_palm: NDArray[np.floating]  # (n, 3) [m]; none where the camera's pose is not known
    colors: Color  # (n, 3) of the points
    T_camera_palm: Array | None  # (4, 4) as measured from images of the hand, else as calibrated, where known
    T_camera_palm_calibrated: Array | None
    """(4, 4) by the rig's calibration, whose error it has; it brings vision's measurements into the palm."""

    def with_outlines(self, model: ObjectModel, outlines: Mapping[tuple[int, int, int], Array]) -> Color:
        """Returns the image with outlines of the object in given colours at T_camera_object (4, 4), the last on top."""
        image = pixels.color(self.image) if isinstance(self.image, bytes) else self.image
        if self.camera is None or not outlines:
            return image
        image = image.copy()
        for color, T_camera_object in outlines.items():
            image[edge(np.isfinite(silhouette(self.camera, model, T_camera_object)))] = color
        return image

    def packed(self) -> "Picture":
        """Returns the same picture in a fifth of the memory."""
        if isinstance(self.image, bytes):
            return self
        return replace(self, image=jpeg(self.image), points_palm=self.points_palm.astype(np.float16))


def edge(inside: Mask) -> Mask:
    """Returns the pixels (h, w) just outside of an area, two wide."""
    grown = inside.copy()
    for _ in range(2):  # scipy.ndimage takes twenty times as long
        before = grown.copy()
        grown[1:] |= before[:-1]
        grown[:-1] |= before[1:]
        grown[:, 1:] |= before[:, :-1]
        grown[:, :-1] |= before[:, 1:]
    return grown & ~inside


def jpeg(image: Color) -> bytes:
    """Returns an image (h, w, 3) as a JPEG file."""
    from PIL import Image  # a dependency of viser

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=80)
    return buffer.getvalue()


def picture(
    rig: Rig, observation: Observation, from_palm: CameraFromPalm, T_world_palm: Array | None
) -> Picture | None:
    """Returns the picture of an observation's images; None where it has none."""
    color, depth = observation.color, observation.depth
    # A colour image of another size than depth's is of another camera than the rig's.
    aligned = color is not None and (depth is None or color.shape[:2] == depth.shape)
    if color is not None and aligned:
        image = color
    elif depth is not None:
        image = (255 * grey(depth)).astype(np.uint8)
    else:
        return None
    mounted, (height, width) = rig.camera, image.shape[:2]
    camera = None
    if mounted is not None and mounted.intrinsics is not None and mounted.size == (width, height):
        camera = Camera.of(mounted)
    T_calibrated = palm_in_camera(rig, CameraFromPalm(), T_world_palm)
    T_camera_palm = palm_in_camera(rig, from_palm, T_world_palm)
    points, colors = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    if camera is not None and depth is not None and T_camera_palm is not None:
        # The depth points near the palm.
        cloud = camera.points(np.ascontiguousarray(depth)).reshape(-1, 3)
        with np.errstate(invalid="ignore"):
            off = np.abs(cloud - T_camera_palm[:3, 3].astype(np.float32)).max(axis=1)
            places = np.flatnonzero(off < 0.2)  # [m]: farther ones are the room's
        places = places[:: max(1, -(-len(places) // 3000))]
        points = se3.apply(se3.inverse(T_camera_palm), cloud[places].astype(float)).astype(np.float32)
        grey_points = np.full((len(points), 3), 110, np.uint8)  # their colour is not known
        colors = image.reshape(-1, 3)[places] if aligned else grey_points
    rows, columns = _window(camera, T_camera_palm, (height, width))
    image = np.ascontiguousarray(image[rows, columns])
    if camera is not None:
        matrix = camera.matrix.copy()
        matrix[:2, 2] -= columns.start, rows.start
        matrix[:2] /= columns.step
        camera = Camera(matrix, (image.shape[1], image.shape[0]), camera.lens)
    return Picture(camera, image, points, colors, T_camera_palm, T_calibrated)


def palm_in_camera(rig: Rig, from_palm: CameraFromPalm, T_world_palm: Array | None) -> Array | None:
    """Returns T_camera_palm (4, 4) as measured from images of the hand, else as the camera was calibrated. None where
    the rig has no camera, or has one in the world in which the palm's pose is not known."""
    mounted = rig.camera
    if mounted is None:
        return None
    T_mount_palm = np.eye(4) if mounted.on == "palm" else T_world_palm
    if T_mount_palm is None:
        return None
    if from_palm.confirmed:
        T_mount_palm = from_palm.confirmed[-1].expected(T_mount_palm)
    return np.asarray(se3.inverse(mounted.T_mount_camera) @ T_mount_palm)


def _window(
    camera: Camera | None, T_camera_palm: Array | None, shape: tuple[int, int]
) -> tuple[slice, slice]:
    """Returns the shown rows and columns (at most 320) of an image (h, w): around the hand, if it is there."""
    rows, columns = slice(0, shape[0]), slice(0, shape[1])
    if camera is not None and T_camera_palm is not None:
        pixel, focal = camera.project(T_camera_palm[None, :3, 3])[0], camera.matrix[0, 0]
        if np.isfinite(pixel).all() and ((pixel >= 0) & (pixel < camera.size)).all():
            # A quarter of a metre around the palm, and at least 40 pixels.
            half = max(focal * 0.25 / T_camera_palm[2, 3], 40.0)
            rows, columns = (
                slice(int(max(middle - size, 0)), int(min(middle + size, end)) + 1)
                for middle, size, end in zip(pixel[::-1], (0.75 * half, half), shape, strict=True)
            )
    step = max(1, -(-(columns.stop - columns.start) // 320))
    return slice(rows.start, rows.stop, step), slice(columns.start, columns.stop, step)
