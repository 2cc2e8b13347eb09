"""Shapes to be drawn for an object and an estimate: silhouette, flat directions, uncertainty."""

import numpy as np

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.correction.estimate import point_uncertainty
from handsight.objects import ObjectModel

STATES = {"tracking": "#3d9a42", "uncertain": "#d98200", "lost": "#e53935"}
SLIP = "#a347ba"
"""Colours of a track's states and of slips, readable on white and on black."""
REACH = 0.6  # of what is drawn of an open direction, relative to the object's size
SIGMAS_95 = 2.795  # standard deviations within which 95 % of a Gaussian in three dimensions are


def silhouette(camera: Camera, model: ObjectModel, T_camera_object: Array) -> Depth:
    """Returns the depth (h, w) [m] that the camera would measure of the object alone, infinite beside it."""
    if len(model.faces):
        return camera.draw(se3.apply(T_camera_object, model.vertices), model.faces).depth
    points = se3.apply(T_camera_object, model.sample(6000)[0])
    # A scan's points are triangles that face the camera.
    corners = points[:, None] + model.diameter / 40 * np.array([[1, 0, 0], [-0.5, 0.9, 0], [-0.5, -0.9, 0]])
    return camera.draw(corners.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3)).depth


def grey(depth: Depth) -> Array:
    """Returns a depth image (h, w) [m] as red, green, blue (h, w, 3) from 0 to 1, near light, black without depth."""
    known = np.isfinite(depth) & (depth > 0)
    near, far = np.percentile(depth[known][::16], [1, 95]) if known.any() else (0, 1)
    share = np.clip((np.where(known, depth, 1) - near) / ((far - near) or 1), 0, 1)
    return np.repeat(np.where(known, 1 - share / 1.25, 0)[..., None], 3, axis=2)


def middle(model: ObjectModel, T_palm_object: Array) -> Array:
    """Returns the object's middle (3,) in the palm [m]."""
    return np.asarray(se3.apply(T_palm_object, model.center_object[None])[0])


def open_direction(direction: Array, center: Array, model: ObjectModel) -> tuple[Array, Array]:
    """Returns what is drawn of a direction (6,) of `PoseEstimate.unobservable`, in the palm [m]: arrows (m, 2, 3), and
    an arc (n, 3).

    A slide has an arrow to either side, and no arc. A turn has an arc about the object's middle `center` (3,), where it
    leaves the drawn object in place, and an arrow at the end of the arc.
    """
    shift = direction[:3]
    turn = direction[3:]
    if np.linalg.norm(shift) >= np.linalg.norm(turn):
        reach = REACH * model.diameter * shift / np.linalg.norm(shift)
        return np.array([[center, center - reach], [center, center + reach]]), np.zeros((0, 3))
    axis = turn / np.linalg.norm(turn)
    side = se3.perpendicular(axis)
    angle = np.linspace(0, 5, 60)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    arc = center + REACH * model.radius * ring
    return arc[None, [-6, -1]], arc


def ellipsoid(estimate: PoseEstimate, model: ObjectModel) -> tuple[Array, Array]:
    """Returns the ellipsoid that contains the object's middle with a probability of 95 %: T_palm_axes (4, 4) and its
    semi-axes (3,) [m], along flat directions no longer than the object."""
    values, axes = np.linalg.eigh(point_uncertainty(estimate, model, model.center_object)[0])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    semi_axes = SIGMAS_95 * np.sqrt(values.clip(min=0.0))
    return se3.compose(axes, middle(model, estimate.T_palm_object)), semi_axes.clip(max=model.diameter)
