"""Markers for RViz: the object, contacts, the uncertainty of the position, and the unobservable directions."""

from collections.abc import Iterator, Sequence

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.correction import PoseEstimate
from handsight.live.answers import OBJECT_FRAME
from handsight.messages.encode import Message, header, parts, pose
from handsight.objects import ObjectModel
from handsight.objects.surface import Triangles
from handsight.tracking import Tracker

ARROW = 0
SPHERE = 2
LINE_STRIP = 4
LINE_LIST = 5
SPHERE_LIST = 7
TRIANGLES = 11
"""The shape of a visualization_msgs/Marker."""
GREEN, ORANGE = (0.3, 0.8, 0.4, 0.8), (1.0, 0.6, 0.1, 1.0)
BLUE, RED = (0.2, 0.5, 1.0, 0.3), (0.9, 0.2, 0.2, 0.9)
LONGEST = 0.3  # no semi-axis is drawn longer [m]


def object_marker(stamp: float, model: ObjectModel) -> Message:
    """Returns the object in its own frame, which /tf moves; it stays until another marker replaces it."""
    surface = model.surface
    most_triangles = 20_000
    if isinstance(surface, Triangles) and len(surface.faces) <= most_triangles:
        kind = TRIANGLES
        size = 1.0
        points = surface.corners.reshape(-1, 3)
    else:
        kind = SPHERE_LIST
        size = model.diameter / 50
        points = model.points_object
    marker = _marker("object", kind, header(stamp, OBJECT_FRAME), (size,) * 3, GREEN, points)
    marker.lifetime = Message(sec=0, nanosec=0)
    marker.frame_locked = True
    return marker


def markers_around(tracker: Tracker, palm: str) -> Iterator[Message]:
    """Yields contacts and uncertainty in the palm's frame `palm`; the markers vanish after half a second.

    They are all contact points and their normals, the ellipsoid of two standard deviations of the object's centre,
    and the unobservable directions.
    """
    top = header(tracker.stamp, palm)
    touched = tracker.fingertips.contacts
    pressed = tracker.skin.contacts()
    if touched is not None:
        if pressed is not None:
            touched = touched.joined(pressed)
        points = touched.points_palm
        yield _marker("contacts", SPHERE_LIST, top, (0.005,) * 3, ORANGE, points)
        ends = np.stack([points, points + 0.03 * touched.normals_palm], axis=1)
        yield _marker("normals", LINE_LIST, top, (0.0015, 0, 0), ORANGE, ends.reshape(-1, 3))
    if tracker.estimate is not None:
        yield _two_sigma(tracker.estimate, tracker.model, top)
        for k, direction in enumerate(tracker.estimate.unobservable):
            yield _open_direction(tracker.estimate, tracker.model, top, direction, k)


def _two_sigma(estimate: PoseEstimate, model: ObjectModel, top: Message) -> Message:
    """Returns the ellipsoid of the position; the object's origin may be anywhere, so it is around its centre."""
    T = estimate.T_palm_object
    lever = T[:3, :3] @ model.center_object
    J = se3.point_jacobian(lever)[:3]
    variances, axes = np.linalg.eigh(J @ estimate.bounded_covariance @ J.T)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    sigmas = np.sqrt(np.maximum(variances, 0))
    sizes = 2 * np.clip(2 * sigmas, 5e-5, LONGEST)
    return _marker("two sigma", SPHERE, top, sizes, BLUE, at=se3.compose(axes, T[:3, 3] + lever))


def _open_direction(
    estimate: PoseEstimate, model: ObjectModel, top: Message, direction: Array, number: int
) -> Message:
    """Returns an unobservable direction (6,): an arc about a rotation's axis, an arrow along a shift."""
    T = estimate.T_palm_object
    center = T[:3, 3] + T[:3, :3] @ model.center_object
    shift = direction[:3]
    turn = direction[3:]
    along = float(np.linalg.norm(shift))
    about = float(np.linalg.norm(turn))
    if about < along:
        ends = center + np.array([[-1.0], [1.0]]) * model.radius * shift / along
        return _marker("open", ARROW, top, (0.003, 0.008, 0.01), RED, ends, number=number)
    axis = turn / about
    side = 1.2 * model.radius * se3.perpendicular(axis)
    angles = np.linspace(0, 1.5 * np.pi, 40)[:, None]
    arc = center + np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
    return _marker("open", LINE_STRIP, top, (0.003, 0, 0), RED, arc, number=number)


def _marker(
    name: str,
    kind: int,
    top: Message,
    size: Sequence[float] | Array,
    color: tuple[float, float, float, float],
    points: Sequence[Array] | Array = (),
    at: Array | None = None,
    number: int = 0,
) -> Message:
    """Returns a marker of `points` (n, 3) at the pose `at` (4, 4) in the frame of its header `top`; size [m], colour
    RGBA."""
    marker = Message(header=top, ns=name, id=number, type=kind)
    marker.action = 0  # add or replace
    marker.pose = pose(np.eye(4) if at is None else at)
    marker.scale = parts("xyz", np.array(size, dtype=np.float64))
    marker.color = parts("rgba", np.array(color))
    marker.lifetime = Message(sec=0, nanosec=500_000_000)
    marker.points = [parts("xyz", row) for row in points]
    marker.text = marker.mesh_resource = marker.texture_resource = ""
    marker.frame_locked = marker.mesh_use_embedded_materials = False
    marker.colors = marker.uv_coordinates = []
    marker.texture = Message(header=header(0.0), format="", filename="", data=np.zeros(0, np.uint8))
    marker.mesh_file = marker.texture  # of both no field is set
    return marker
