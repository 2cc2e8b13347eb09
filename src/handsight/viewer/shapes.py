"""Shapes to be drawn for an object and an estimate: sharp edges, silhouette, flat directions, uncertainty."""

import numpy as np
import scipy  # loads its parts when they are used

from handsight import se3
from handsight.camera import Camera, Depth
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.correction.estimate import point_uncertainty
from handsight.objects import ObjectModel
from handsight.objects.surface import Triangles

SIGMAS_95 = 2.795  # standard deviations within which 95 % of a Gaussian in three dimensions are


def creases(model: ObjectModel) -> Array:
    """Returns edges (k, 2, 3) [m] at which the surface bends sharply or ends; none for an object without triangles."""
    if not len(model.faces):
        return np.empty((0, 2, 3))
    surface = Triangles(model.vertices, model.faces)
    edges, (a, b) = surface.edges, (surface.doubled_normals[of // 3] for of in surface.shared)
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    sharp = edges.vertices[edges.counts == 2][(a * b).sum(axis=1) < np.cos(np.deg2rad(25)) * lengths]
    return np.asarray(model.vertices[np.concatenate([sharp, edges.vertices[edges.counts == 1]])])


def silhouette(camera: Camera, model: ObjectModel, T_camera_object: Array) -> Depth:
    """Returns the depth (h, w) [m] that the camera would measure of the object alone, infinite beside it."""
    if len(model.faces):
        return camera.draw(se3.apply(T_camera_object, model.vertices), model.faces).depth
    points = se3.apply(T_camera_object, model.sample(6000)[0])
    depth = np.full(camera.size[::-1], np.inf, dtype=np.float32)
    pixels = camera.project(points)
    inside = np.isfinite(pixels).all(axis=1) & (pixels > -0.5).all(axis=1)
    inside &= (pixels < np.array(camera.size) - 0.5).all(axis=1)
    u, v = np.round(pixels[inside]).astype(int).T
    np.minimum.at(depth, (v, u), points[inside, 2].astype(np.float32))
    # Each point is a dot in front of what is behind it.
    image = scipy.ndimage
    dot = image.iterate_structure(image.generate_binary_structure(2, 1), 2)
    return np.asarray(image.minimum_filter(depth, footprint=dot, mode="constant", cval=np.inf))


def grey(depth: Depth) -> Array:
    """Returns a depth image (h, w) [m] as red, green, blue (h, w, 3) from 0 to 1, near light, black without depth."""
    known = np.isfinite(depth) & (depth > 0)
    near, far = np.percentile(depth[known][::16], [1, 95]) if known.any() else (0, 1)
    share = np.clip((np.where(known, depth, 1) - near) / max(far - near, 1e-6), 0, 1)
    return np.repeat(np.where(known, 0.9 - 0.75 * share, 0)[..., None], 3, axis=2)


def middle(model: ObjectModel, T_palm_object: Array) -> Array:
    """Returns the object's middle (3,) in the palm [m]."""
    return np.asarray(se3.apply(T_palm_object, model.center_object[None])[0])


def direction_line(direction: Array, center: Array, model: ObjectModel) -> tuple[Array, bool]:
    """Returns a line (n, 3) in the palm [m] for a direction (6,) of `PoseEstimate.unobservable`; whether it is a turn.

    A slide has two ends. A turn is an arc about the object's middle `center` (3,), where it leaves the drawn object in
    place, with an arrowhead at its last point.
    """
    if np.linalg.norm(direction[:3]) >= np.linalg.norm(direction[3:]):
        reach = 0.65 * model.diameter * direction[:3] / np.linalg.norm(direction[:3])  # half a double arrow
        return np.stack([center - reach, center + reach]), False
    axis = direction[3:] / np.linalg.norm(direction[3:])
    side = se3.perpendicular(axis)
    angle = np.linspace(0, 1.6 * np.pi, 60)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    return center + 0.62 * model.radius * ring, True


def ellipsoid(estimate: PoseEstimate, model: ObjectModel) -> tuple[Array, Array]:
    """Returns the ellipsoid that contains the object's middle with a probability of 95 %: T_palm_axes (4, 4) and its
    semi-axes (3,) [m], along flat directions no longer than the object."""
    values, axes = np.linalg.eigh(point_uncertainty(estimate, model, model.center_object)[0])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    semi_axes = SIGMAS_95 * np.sqrt(values.clip(min=0.0))
    return se3.compose(axes, middle(model, estimate.T_palm_object)), semi_axes.clip(max=model.diameter)
