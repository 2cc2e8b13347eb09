"""What is drawn of an answer beside the object: the edges of its surface, what is left open, how uncertain it is."""

from typing import NamedTuple

import numpy as np
import trimesh

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.objects import ObjectModel
from handsight.tracking.track_state import point_uncertainty


class ShapeStyle(NamedTuple):
    """A `ShapeStyle` says how edges and uncertain directions are drawn."""

    crease: float = np.deg2rad(25)  # angle between triangles at which an edge is drawn [rad]
    open_shift: float = 0.65  # half a flat direction's double arrow in parts of the object's diameter
    open_rotation: float = 0.62  # the radius of a turn's arc in parts of the object's radius
    arc_points: int = 60  # of such an arc
    arc_angle: float = 1.6 * np.pi  # of such an arc [rad]
    sigmas_95: float = 2.795  # standard deviations within which three numbers of a Gaussian are with 95 %


SHAPES = ShapeStyle()


class Open(NamedTuple):
    """An `Open` is a direction that contacts leave open, as a line with an arrow's head at one of its ends, or at
    both."""

    line: Array
    """(n, 3) in the palm [m]: two ends of a slide, or an arc about the axis of a turn."""
    turn: bool


class Ellipsoid(NamedTuple):
    """An `Ellipsoid` says where the object's middle is with 95 %."""

    T_palm_axes: Array
    """(4, 4) its middle and principal axes."""
    semi_axes: Array
    """(3,) [m]."""


def creases(model: ObjectModel) -> Array:
    """Returns (k, 2, 3) edges [m] at which the surface bends sharply or ends."""
    if not len(model.faces):
        return np.empty((0, 2, 3))
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    sharp = mesh.face_adjacency_edges[mesh.face_adjacency_angles > SHAPES.crease]
    edges, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return np.asarray(model.vertices[np.concatenate([sharp, edges[count == 1]])])


def middle(model: ObjectModel, T_palm_object: Array) -> Array:
    """Returns (3,) the object's middle in the palm [m]."""
    return np.asarray(se3.apply(T_palm_object, model.center_object[None])[0])


def opened(direction: Array, center: Array, model: ObjectModel) -> Open:
    """Returns a direction (6,) of `PoseEstimate.unobservable` about the object's middle `center` (3,): a slide or a
    turn, whichever it mostly is."""
    # About the object's middle, where a turn leaves the drawn object in place.
    if np.linalg.norm(direction[:3]) >= np.linalg.norm(direction[3:]):
        reach = SHAPES.open_shift * model.diameter * direction[:3] / np.linalg.norm(direction[:3])
        return Open(np.stack([center - reach, center + reach]), turn=False)
    axis = direction[3:] / np.linalg.norm(direction[3:])
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    angle = np.linspace(0, SHAPES.arc_angle, SHAPES.arc_points)[:, None]
    ring = np.cos(angle) * side + np.sin(angle) * np.cross(axis, side)
    return Open(center + SHAPES.open_rotation * model.radius * ring, turn=True)


def ellipsoid(estimate: PoseEstimate, model: ObjectModel) -> Ellipsoid:
    """Returns where the object's middle is; along what is open no longer than the object."""
    values, axes = np.linalg.eigh(point_uncertainty(estimate, model, model.center_object)[0])
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    semi_axes = SHAPES.sigmas_95 * np.sqrt(values.clip(min=0.0))
    center = middle(model, estimate.T_palm_object)
    return Ellipsoid(se3.compose(axes, center), semi_axes.clip(max=model.diameter))
