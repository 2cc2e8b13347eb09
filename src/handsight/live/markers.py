"""Markers for RViz: the object, contacts, the uncertainty of the position, and the unobservable directions."""

from collections.abc import Iterator, Sequence

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.live.answers import OBJECT_FRAME, Answer, Writer
from handsight.messages.encode import Message, header, parts, pose
from handsight.messages.topics import OwnTopic, RosType
from handsight.objects import ObjectModel
from handsight.objects.surface import Triangles
from handsight.tracking import Tracker

ARROW, SPHERE, LINE_STRIP, LINE_LIST, SPHERE_LIST, TRIANGLES = 0, 2, 4, 5, 7, 11
"""The shape of a visualization_msgs/Marker."""
GREEN, ORANGE = (0.3, 0.8, 0.4, 0.8), (1.0, 0.6, 0.1, 1.0)
BLUE, RED = (0.2, 0.5, 1.0, 0.3), (0.9, 0.2, 0.2, 0.9)


class Markers:
    """A `Markers` builds MarkerArrays of a tracker's estimate."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer

    def object(self, stamp: float, model: ObjectModel) -> Answer:
        """Returns the object in its own frame, which /tf moves; the marker stays until another replaces it."""
        surface, most_triangles = model.surface, 20_000
        if isinstance(surface, Triangles) and len(surface.faces) <= most_triangles:
            kind, size, points = TRIANGLES, 1.0, surface.corners.reshape(-1, 3)
        else:
            kind, size, points = SPHERE_LIST, model.diameter / 50, model.points_object
        marker = self._marker("object", kind, stamp, (size,) * 3, GREEN, points)
        always = Message(sec=0, nanosec=0)
        marker.header.frame_id, marker.lifetime, marker.frame_locked = OBJECT_FRAME, always, True
        return self._writer.answer(OwnTopic.MARKERS, RosType.MARKERS, markers=[marker])

    def around(self, tracker: Tracker) -> Answer:
        """Returns contacts and uncertainty in the palm's frame; the markers vanish after half a second.

        They are all contact points and their normals, the ellipsoid of two standard deviations of the object's centre,
        and the unobservable directions.
        """
        markers = [*self._contacts(tracker), *self._uncertainty(tracker)]
        return self._writer.answer(OwnTopic.MARKERS, RosType.MARKERS, markers=markers)

    def _contacts(self, tracker: Tracker) -> Iterator[Message]:
        touched, stamp = tracker.fingertips.contacts, tracker.stamp
        if touched is None:
            return
        if (pressed := tracker.skin.contacts()) is not None:
            touched = touched.joined(pressed)
        points, normals = touched.points_palm, touched.normals_palm
        yield self._marker("contacts", SPHERE_LIST, stamp, (0.005,) * 3, ORANGE, points)
        if normals is not None:
            ends = np.stack([points, points + 0.03 * normals], axis=1).reshape(-1, 3)
            yield self._marker("normals", LINE_LIST, stamp, (0.0015, 0, 0), ORANGE, ends)

    def _uncertainty(self, tracker: Tracker) -> Iterator[Message]:
        estimate, model, stamp = tracker.estimate, tracker.model, tracker.stamp
        if estimate is None:
            return
        T, covariance = estimate.T_palm_object, estimate.bounded_covariance
        # The object's origin may be anywhere, so the ellipsoid is around its centre.
        lever = T[:3, :3] @ model.center_object
        J = se3.point_jacobian(lever)[:3]
        values, axes = np.linalg.eigh(J @ covariance @ J.T)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        at = se3.compose(axes, T[:3, 3] + lever)
        longest = 0.3  # no semi-axis is drawn longer [m]
        sizes = 2 * np.minimum(2 * np.sqrt(np.maximum(values, 0)), longest)
        yield self._marker("two sigma", SPHERE, stamp, np.maximum(sizes, 1e-4), BLUE, at=at)
        # A rotation that is unobservable is an arc about its axis, a shift an arrow.
        for k, direction in enumerate(estimate.unobservable):
            shift, turn = direction[:3], direction[3:]
            if np.linalg.norm(turn) < np.linalg.norm(shift):
                ends = at[:3, 3] + np.array([[-1.0], [1.0]]) * model.radius * shift / np.linalg.norm(shift)
                yield self._marker("open", ARROW, stamp, (0.003, 0.008, 0.01), RED, ends, number=k)
                continue
            axis = turn / np.linalg.norm(turn)
            side = 1.2 * model.radius * se3.perpendicular(axis)
            angles = np.linspace(0, 1.5 * np.pi, 40)[:, None]
            arc = at[:3, 3] + np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
            yield self._marker("open", LINE_STRIP, stamp, (0.003, 0, 0), RED, arc, number=k)

    def _marker(
        self,
        name: str,
        kind: int,
        stamp: float,
        size: Sequence[float] | Array,
        color: tuple[float, float, float, float],
        points: Array | None = None,
        *,
        at: Array | None = None,
        number: int = 0,
    ) -> Message:
        """Returns a marker of `points` (n, 3) at the pose `at` (4, 4) in the palm's frame; size [m], colour RGBA."""
        nothing = Message(header=header(0.0), format="", data=np.zeros(0, np.uint8))
        return Message(
            header=header(stamp, self._writer.palm),
            ns=name,
            id=number,
            type=kind,
            action=0,  # add or replace
            pose=pose(np.eye(4) if at is None else at),
            scale=parts("xyz", np.array(size, dtype=np.float64)),
            color=parts("rgba", np.array(color)),
            lifetime=Message(sec=0, nanosec=500_000_000),
            frame_locked=False,
            points=[] if points is None else [parts("xyz", row) for row in points],
            colors=[],
            text="",
            mesh_resource="",
            mesh_use_embedded_materials=False,
            # ROS 1 lacks these fields.
            texture_resource="",
            texture=nothing,
            uv_coordinates=[],
            mesh_file=Message(filename="", data=np.zeros(0, np.uint8)),
        )
