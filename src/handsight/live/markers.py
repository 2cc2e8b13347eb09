"""What RViz draws: the object, contacts with their normals, how far the position is known, and what is open."""

from collections.abc import Iterator
from types import SimpleNamespace as Message
from typing import Any

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.live.answers import MARKERS, MARKERS_TOPIC, OBJECT_FRAME, Answer, Writer
from handsight.objects import ObjectModel
from handsight.objects.surface import Triangles
from handsight.recording.write import parts, pose
from handsight.tracking import Tracker

ARROW, SPHERE, LINE_STRIP, LINE_LIST, SPHERE_LIST, TRIANGLES = 0, 2, 4, 5, 7, 11
ADD, DELETE = 0, 2
MOST_TRIANGLES = 20_000
"""Of more, points of the surface are drawn."""
BRIEFLY, ALWAYS = Message(sec=0, nanosec=500_000_000), Message(sec=0, nanosec=0)
GREEN, ORANGE, BLUE, RED = (0.3, 0.8, 0.4), (1.0, 0.6, 0.1), (0.2, 0.5, 1.0), (0.9, 0.2, 0.2)
ORIGIN, NONE = np.eye(4), np.zeros((0, 3))
FARTHEST_DRAWN = 0.3
"""An ellipsoid's semi-axes are drawn up to this [m]."""


class Markers:
    """A `Markers` is a tracker's markers, as MarkerArrays."""

    def __init__(self, writer: Writer, palm: str) -> None:
        self._writer, self._palm = writer, palm

    def object(self, stamp: float, model: ObjectModel) -> Answer:
        """Returns the object itself, in its own frame, which /tf moves; it stays until another replaces it."""
        surface = model.surface
        if isinstance(surface, Triangles) and len(surface.faces) <= MOST_TRIANGLES:
            kind, size, points = TRIANGLES, 1.0, surface.corners.reshape(-1, 3)
        else:
            kind, size, points = SPHERE_LIST, model.diameter / 50, model.points_object
        marker = self._marker("object", kind, stamp, size=(size,) * 3, color=(*GREEN, 0.8), points=points)
        marker.header.frame_id, marker.lifetime, marker.frame_locked = OBJECT_FRAME, ALWAYS, True
        return self._writer.answer(MARKERS_TOPIC, MARKERS, markers=[marker])

    def around(self, tracker: Tracker) -> Answer:
        """Returns what is known of it now, in the palm; gone half a second after the last."""
        found = [*self._contacts(tracker), *self._unknown(tracker)]
        return self._writer.answer(MARKERS_TOPIC, MARKERS, markers=found)

    def _contacts(self, tracker: Tracker) -> Iterator[Message]:
        touched, stamp = tracker.fingertips.contacts, tracker.stamp
        if touched is None:
            return
        if (pressed := tracker.skin.contacts()) is not None:
            touched = touched.joined(pressed)
        points, normals = touched.points_palm, touched.normals_palm
        yield self._marker(
            "contacts", SPHERE_LIST, stamp, size=(0.005,) * 3, color=(*ORANGE, 1.0), points=points
        )
        if normals is not None:
            ends = np.stack([points, points + 0.03 * normals], axis=1).reshape(-1, 3)
            yield self._marker(
                "normals", LINE_LIST, stamp, size=(0.0015, 0, 0), color=(*ORANGE, 1.0), points=ends
            )

    def _unknown(self, tracker: Tracker) -> Iterator[Message]:
        estimate, model, stamp = tracker.estimate, tracker.model, tracker.stamp
        if estimate is None:
            return
        T, covariance = estimate.T_palm_object, estimate.bounded_covariance
        # Of the object's middle, wherever its origin is.
        lever = T[:3, :3] @ model.center_object
        J = se3.point_jacobian(lever)[:3]
        values, axes = np.linalg.eigh(J @ covariance @ J.T)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        at = se3.compose(axes, T[:3, 3] + lever)
        sizes = 2 * np.minimum(2 * np.sqrt(np.maximum(values, 0)), FARTHEST_DRAWN)
        yield self._marker(
            "two sigma", SPHERE, stamp, size=tuple(np.maximum(sizes, 1e-4)), color=(*BLUE, 0.3), at=at
        )
        for k, direction in enumerate(estimate.unobservable):
            yield self._open(k, direction, at[:3, 3], model.radius, stamp)

    def _open(self, k: int, direction: Array, middle: Array, radius: float, stamp: float) -> Message:
        """Returns what touch leaves open: a turn as an arc about its axis, a shift as an arrow."""
        shift, turn = direction[:3], direction[3:]
        color = (*RED, 0.9)
        if np.linalg.norm(turn) < np.linalg.norm(shift):
            ends = middle + np.array([[-1.0], [1.0]]) * radius * shift / np.linalg.norm(shift)
            return self._marker(
                "open", ARROW, stamp, number=k, size=(0.003, 0.008, 0.01), color=color, points=ends
            )
        axis = turn / np.linalg.norm(turn)
        side = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        side *= 1.2 * radius / np.linalg.norm(side)
        angles = np.linspace(0, 1.5 * np.pi, 40)[:, None]
        arc = middle + np.cos(angles) * side + np.sin(angles) * np.cross(axis, side)
        return self._marker("open", LINE_STRIP, stamp, number=k, size=(0.003, 0, 0), color=color, points=arc)

    def _marker(self, name: str, kind: int, stamp: float, **given: Any) -> Message:
        """Returns a marker. `given`: size, color, and what differs: number, points (n, 3), at (4, 4)."""
        size, color = given["size"], given["color"]
        points, at = given.get("points", NONE), given.get("at", ORIGIN)
        nothing = Message(header=self._writer.header(0.0), format="", data=np.zeros(0, np.uint8))
        return Message(
            header=self._writer.header(stamp, self._palm),
            ns=name,
            id=given.get("number", 0),
            type=kind,
            action=ADD,
            pose=pose(at),
            scale=parts("xyz", np.array(size, dtype=np.float64)),
            color=parts("rgba", np.array(color)),
            lifetime=BRIEFLY,
            frame_locked=False,
            points=[parts("xyz", row) for row in points],
            colors=[],
            text="",
            mesh_resource="",
            mesh_use_embedded_materials=False,
            # Of ROS 2 alone.
            texture_resource="",
            texture=nothing,
            uv_coordinates=[],
            mesh_file=Message(filename="", data=np.zeros(0, np.uint8)),
        )
