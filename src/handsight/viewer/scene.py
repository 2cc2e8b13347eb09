"""A moment in three dimensions, in the palm's frame: nodes of a viser scene."""

import itertools
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.viewer.moment import LIKELY, Moment
from handsight.viewer.picture import Picture
from handsight.viewer.shapes import direction_line, ellipsoid, middle

if TYPE_CHECKING:
    from viser import SceneApi, SceneNodeHandle

Color = tuple[int, int, int]
HAND: Color = (176, 182, 194)
GHOST_OPACITY = 0.22  # of other modes
MIN_SHIFT = 3e-4  # smallest motion of a link or a line that is sent: joints tremble [m]
MIN_ROTATION = 2e-3  # smallest change of a link's quaternion that is sent

LAYERS: dict[str, tuple[str, Color]] = {
    "hand": ("hand", HAND),
    "object": ("object, corrected", (224, 161, 0)),
    "vision": ("object, as vision measured", (0, 160, 190)),
    "modes": ("other likely poses", (67, 160, 71)),
    "contacts": ("contacts and their normals", (194, 24, 91)),
    "forces": ("forces on the fingers", (229, 57, 53)),
    "covariance": ("where its middle is, 95 %", (123, 31, 162)),
    "open": ("left open by touch", (13, 71, 161)),
    "depth": ("depth image", (110, 110, 110)),
    "frame": ("the palm's axes, gravity, horizontal grid of 5 cm", (90, 90, 90)),
}
"""What can be shown, by name: its label and colour."""


class MomentScene:
    """A `MomentScene` shows hand, object and contacts; each `draw` sends the changes to the browsers."""

    def __init__(self, scene: "SceneApi", rig: Rig, model: ObjectModel) -> None:
        """Adds all nodes to viser's `scene`, invisible."""
        self._scene, self._rig, self._model = scene, rig, model
        self.layers = dict.fromkeys(LAYERS, True)  # which layers are to be shown
        # Contacts, and the arrows at them, are visible through it.
        style = {"color": HAND, "opacity": 0.55, "visible": False}
        self.links = {
            name: scene.add_mesh_simple(f"/hand/{name.replace('/', '_')}", *mesh, **style)
            for name, mesh in rig.hand.link_meshes().items()
        }
        count = len(self.links)
        self._sent = {"position": np.full((count, 3), np.inf), "wxyz": np.full((count, 4), np.inf)}
        """Positions and quaternions of the links as they were last sent."""
        self._picture: Picture | None = None
        self.object = self._copy("/object", "object", 0.75)
        self.vision = self._copy("/vision", "vision", GHOST_OPACITY)
        self.modes = [self._copy(f"/modes/{k}", "modes", GHOST_OPACITY) for k in range(3)]
        none, gone = np.zeros((0, 3), np.float32), {"visible": False}
        size, black = {"point_size": 0.006, "point_shape": "circle"}, (30, 30, 30)
        self.contacts = scene.add_point_cloud("/contacts", none, LAYERS["contacts"][1], **size, **gone)
        self.rejected = scene.add_point_cloud("/rejected", none, black, **size, **gone)
        self.normals = self._arrows("/normals", "contacts", 0.0008)
        self.forces = self._arrows("/forces", "forces", 0.0016)
        self.open_shifts = self._arrows("/open/slides", "open", 0.0015)
        lines, blue = np.zeros((0, 2, 3), np.float32), LAYERS["open"][1]
        self.turns = scene.add_line_segments("/open/turns", lines, blue, thickness=0.003, **gone)
        purple = LAYERS["covariance"][1]
        self.covariance = scene.add_icosphere("/covariance", 1.0, purple, cast_shadow=False, **gone)
        self.axes = scene.add_frame("/axes", axes_length=0.05, axes_radius=0.001, visible=False)
        self.world = scene.add_frame("/world", show_axes=False, visible=False)
        """Axes of the world at the palm's origin: gravity and grid are in it, and turn with it."""
        down, dark = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, -0.08]]]), LAYERS["frame"][1]
        sizes = {"shaft_radius": 0.001, "head_radius": 0.003, "head_length": 0.01}
        scene.add_arrows("/world/gravity", down, dark, **sizes)
        cells = {"cell_size": 0.05, "section_size": 0.2}  # [m]
        scene.add_grid("/world/grid", width=0.8, height=0.8, **cells, position=(0, 0, -0.15))
        grey = LAYERS["depth"][1]
        self.depth = scene.add_point_cloud("/depth", np.zeros((1, 3)), (grey,), point_size=0.0012, **gone)

    def draw(self, moment: Moment, forces: Mapping[str, Array]) -> None:
        """Shows a moment in place of the last one; `forces` are those of `Moment.forces`."""
        links = moment.links(self._rig) if self.layers["hand"] else {}
        known, handles = [name in links for name in self.links], list(self.links.values())
        for handle, visible in zip(handles, known, strict=True):
            _show(handle, visible)
        if any(known):
            Ts = np.stack([links.get(name, np.eye(4)) for name in self.links])
            shifts, turns = (Ts[:, :3, 3], MIN_SHIFT), (quaternions_wxyz(Ts), MIN_ROTATION)
            for part, (values, least) in (("position", shifts), ("wxyz", turns)):
                sent = self._sent[part]
                for k in np.flatnonzero((np.abs(values - sent) > least).any(axis=1) & known):
                    setattr(handles[k], part, values[k])
                    sent[k] = values[k]
        _show(self.axes, self.layers["frame"])
        _show(self.world, self.layers["frame"] and moment.T_world_palm is not None)
        if moment.T_world_palm is not None:
            turn = quaternions_wxyz(se3.inverse(moment.T_world_palm))
            if np.abs(turn - self.world.wxyz).max() > MIN_ROTATION:
                self.world.wxyz = turn
        self._draw_contacts(moment, forces)
        estimate, vision = moment.estimate, moment.vision
        self._put(self.object, "object", None if estimate is None else estimate.T_palm_object)
        self._put(self.vision, "vision", None if vision is None else vision.T_palm_object)
        others = [] if estimate is None else [mode for mode in estimate.modes[1:] if mode["weight"] >= LIKELY]
        for handle, mode in itertools.zip_longest(self.modes, others[: len(self.modes)]):
            self._put(handle, "modes", None if mode is None else mode["T_palm_object"])
        self._draw_uncertainty(moment)
        picture = moment.picture if self.layers["depth"] else None
        if picture is not None and len(picture.points_palm) and picture is not self._picture:
            self._picture = picture
            self.depth.points, self.depth.colors = picture.points_palm, picture.colors
        _show(self.depth, picture is not None and len(picture.points_palm) > 0)

    def _draw_contacts(self, moment: Moment, forces: Mapping[str, Array]) -> None:
        """Shows contacts, rejected ones in black, their normals, and the forces on the fingers."""
        fingertips, wanted = moment.fingertips, self.layers["contacts"]
        points, normals = np.zeros((2, 0, 3))
        if fingertips.contacts is not None:
            points, normals = fingertips.contacts.points_palm, fingertips.contacts.normals_palm
        rejected = np.array([name in moment.outliers for name in fingertips.fingers], dtype=bool)
        pressed = moment.skin.contacts()
        on_skin = np.zeros((0, 3)) if pressed is None else pressed.points_palm
        self._set(self.contacts, np.concatenate([points[~rejected], on_skin]), wanted)
        self._set(self.rejected, points[rejected], wanted)
        self._set(self.normals, np.stack([points, points + 0.02 * normals], axis=1), wanted)  # [m]
        arrows = []
        for name, point in zip(fingertips.fingers, points, strict=True):
            if (force := forces.get(name)) is not None:
                longest = 0.12 / max(float(np.linalg.norm(force)), 1e-9)  # [m]
                arrows.append((point, point + force * min(0.012, longest)))  # [m/N]
        self._set(self.forces, np.array(arrows).reshape(-1, 2, 3), self.layers["forces"])

    def _draw_uncertainty(self, moment: Moment) -> None:
        """Shows where the object's middle is with 95 %, and the directions that contacts leave open."""
        estimate, model = moment.estimate, self._model
        T_palm_axes, semi_axes = (None, np.zeros(3)) if estimate is None else ellipsoid(estimate, model)
        self._put(self.covariance, "covariance", T_palm_axes)
        if T_palm_axes is not None and self.layers["covariance"]:
            self.covariance.scale = tuple(float(a) for a in semi_axes.clip(min=2e-4))
            # Inside the object it must be opaque, to be drawn before it; around the object it must be translucent.
            inside = semi_axes.max() < 0.7 * model.radius
            self.covariance.opacity = None if inside else GHOST_OPACITY / 2
        open_shifts, turns = [np.zeros((0, 2, 3))], [np.zeros((0, 2, 3))]
        if estimate is not None and moment.fingertips.fingers:
            center = middle(model, estimate.T_palm_object)
            for direction in estimate.unobservable:
                line, turn = direction_line(direction, center, model)
                if turn:
                    turns.append(np.stack([line[:-1], line[1:]], axis=1))
                    open_shifts.append(line[None, [-6, -1]])
                else:
                    open_shifts.append(np.stack([[center, line[0]], [center, line[1]]]))
        self._set(self.open_shifts, np.concatenate(open_shifts), self.layers["open"])
        self._set(self.turns, np.concatenate(turns), self.layers["open"])

    def _put(self, handle: "SceneNodeHandle", layer: str, T_palm_node: Array | None) -> None:
        """Shows a node at its pose in the palm (4, 4), and hides it if that is None or its layer is not chosen."""
        visible = T_palm_node is not None and self.layers[layer]
        if visible and T_palm_node is not None:
            handle.position, handle.wxyz = T_palm_node[:3, 3], quaternions_wxyz(T_palm_node)
        _show(handle, visible)

    def _set(self, handle: "SceneNodeHandle", points: Array, wanted: bool) -> None:
        """Shows a node of points or lines, and hides it if there are none or they are not wanted."""
        before, visible = handle.points, wanted and len(points) > 0
        # viser takes ten times as long to find that nothing has changed.
        if visible and (points.shape != before.shape or np.abs(points - before).max() > MIN_SHIFT):
            handle.points = points
        _show(handle, visible)

    def _copy(self, name: str, layer: str, opacity: float) -> "SceneNodeHandle":
        """Returns a node of the object, as triangles or as points."""
        model, color = self._model, LAYERS[layer][1]
        if len(model.faces):
            scale = 1.0 if layer == "object" else 1.01  # so that equal surfaces do not flicker
            style = {"color": color, "opacity": opacity, "scale": scale, "visible": False}
            mesh = model.vertices, model.faces
            return self._scene.add_mesh_simple(name, *mesh, side="double", cast_shadow=False, **style)
        points, _ = model.sample(4000)
        return self._scene.add_point_cloud(name, points, color, point_size=0.0015, visible=False)

    def _arrows(self, name: str, layer: str, radius: float) -> "SceneNodeHandle":
        """Returns a node of arrows with shafts of that radius [m]."""
        points, color = np.zeros((0, 2, 3), np.float32), LAYERS[layer][1]
        sizes = {"shaft_radius": radius, "head_radius": 2.6 * radius, "head_length": 6 * radius}
        return self._scene.add_arrows(name, points, color, **sizes, visible=False)


def _show(handle: "SceneNodeHandle", visible: bool) -> None:
    if handle.visible is not visible:
        handle.visible = visible


def quaternions_wxyz(Ts: Array) -> Array:
    """Returns the quaternions (..., 4), w first as in viser, of poses (..., 4, 4)."""
    return se3.quaternion_from_rotation(Ts[..., :3, :3])[..., [3, 0, 1, 2]]
