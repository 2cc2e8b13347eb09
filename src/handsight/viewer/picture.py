"""A camera's image, reduced, with the object's outline over it, and its depth as points in the palm."""

import io
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from handsight import se3
from handsight.camera import Camera
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import CameraFromPalm
from handsight.tracking.track_state import TrackState
from handsight.viewer.shapes import grey, silhouette
from handsight.vision import pixels
from handsight.vision.pixels import Color

WIDTH = 320  # most columns of an image
MAX_POINTS = 3000  # of a depth image
NEAR_PALM = 0.2  # farther points of a depth image are the room's [m]


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """An image of the rig's camera."""

    camera: Camera | None  # the camera of these pixels; None where it is not known
    image: bytes  # colour, or depth in grey, the nearer the lighter; as JPEG
    points_palm: NDArray[np.float16]  # (n, 3) [m]; none where the camera's pose is not known
    colors: Color  # (n, 3) of the points
    T_camera_palm: Array | None  # (4, 4) as measured from images of the hand, else as calibrated, where known
    T_camera_palm_calibrated: Array | None
    """(4, 4) by the rig's calibration, whose error it has; it brings vision's measurements into the palm."""

    def with_outlines(self, model: ObjectModel, outlines: Mapping[tuple[int, int, int], Array]) -> Color:
        """Returns the image with outlines of the object in given colours at T_camera_object (4, 4), the last on top."""
        image = pixels.color(self.image).copy()
        if self.camera is None:
            return image
        for color, T_camera_object in outlines.items():
            inside = np.isfinite(silhouette(self.camera, model, T_camera_object))
            image[scipy.ndimage.binary_dilation(inside, iterations=2) & ~inside] = color
        return image


def jpeg(image: Color) -> bytes:
    """Returns an image (h, w, 3) as a JPEG file."""
    from PIL import Image  # a dependency of viser

    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=80)
    return buffer.getvalue()


def picture(rig: Rig, state: TrackState) -> Picture | None:
    """Returns the picture of the images that a tracker has processed last; None where there were none."""
    observation = state.processed
    color = None if observation is None else observation.color
    depth = None if observation is None else observation.depth
    # A colour image of another size than depth's is of another camera than the rig's.
    if color is not None and (depth is None or color.shape[:2] == depth.shape):
        image = color
    elif depth is not None:
        image = (255 * grey(depth)).astype(np.uint8)
    else:
        return None
    height, width = image.shape[:2]
    mounted = rig.camera
    camera = None
    if mounted is not None and mounted.intrinsics is not None and mounted.size == (width, height):
        camera = Camera.of(mounted)
    T_world_palm = state.belief.T_world_palm
    T_camera_palm = palm_in_camera(rig, state.belief.vision.camera_from_palm, T_world_palm)
    points = np.zeros((0, 3), np.float16)
    colors = np.zeros((0, 3), np.uint8)
    if camera is not None and depth is not None and T_camera_palm is not None:
        cloud = camera.points(np.ascontiguousarray(depth)).reshape(-1, 3).astype(float)
        cloud = se3.apply(se3.inverse(T_camera_palm), cloud)
        near = np.flatnonzero((np.abs(cloud) < NEAR_PALM).all(axis=1))
        near = near[:: 1 + len(near) // MAX_POINTS]
        points = cloud[near].astype(np.float16)
        colors = image.reshape(-1, 3)[near]
    step = -(-width // WIDTH)
    image = np.ascontiguousarray(image[::step, ::step])
    if camera is not None:
        shrunk = camera.matrix * [[1 / step], [1 / step], [1]]
        camera = Camera(shrunk, (image.shape[1], image.shape[0]), camera.lens)
    calibrated = palm_in_camera(rig, CameraFromPalm(), T_world_palm)
    return Picture(camera, jpeg(image), points, colors, T_camera_palm, calibrated)


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
