"""A moment in three dimensions, in the palm's frame: nodes of a viser scene."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.viewer.moment import LIKELY, Moment
from handsight.viewer.picture import Picture
from handsight.viewer.shapes import ellipsoid, middle, open_direction

if TYPE_CHECKING:
    from viser import SceneApi, SceneNodeHandle

Color = tuple[int, int, int]
HAND: Color = (176, 182, 194)
GRID: Color = (160, 160, 160)
GHOST_OPACITY = 0.22  # of other poses
ARROW = 0.001  # radius of an arrow's shaft [m]
NORMAL = 0.02  # length of a drawn normal [m]
METRES_PER_NEWTON = 0.012  # of a drawn force
LARGEST = 10  # a larger force is drawn as one of this size [N]
NO_LINES = np.zeros((0, 2, 3), np.float32)

LAYERS: dict[str, tuple[str, Color]] = {
    "hand": ("hand", HAND),
    "object": ("object, corrected", (224, 161, 0)),
    "vision": ("object, as vision measured", (0, 160, 190)),
    "modes": ("other likely poses", (67, 160, 71)),
    "contacts": ("contacts and their normals", (194, 24, 91)),
    "forces": ("forces on the fingers", (229, 57, 53)),
    "covariance": ("where its middle is, 95 %", (150, 60, 190)),
    "open": ("left open by touch", (33, 100, 210)),
    "depth": ("depth image", (130, 130, 130)),
    "frame": ("the palm's axes, gravity, horizontal grid of 5 cm", (120, 120, 120)),
}
"""What can be shown, by name: its label and colour."""


class MomentScene:
    """Shows hand, object and contacts; each `draw` sends the changes to the browsers."""

    def __init__(self, scene: "SceneApi", rig: Rig, model: ObjectModel) -> None:
        """Adds all nodes to viser's `scene`, invisible."""
        self._scene = scene
        self._rig = rig
        self._model = model
        self.layers = dict.fromkeys(LAYERS, True)  # which layers are to be shown
        # Contacts, and the arrows at them, are visible through it.
        style = {"color": HAND, "opacity": 0.5, "visible": False}
        self.links = {
            name: scene.add_mesh_simple(f"/hand/{name.replace('/', '_')}", *mesh, **style)
            for name, mesh in rig.hand.link_meshes().items()
        }
        self._picture: Picture | None = None
        self.object = self._copy("/object", "object", 0.75)
        self.vision = self._copy("/vision", "vision", GHOST_OPACITY)
        self.modes = [self._copy(f"/modes/{k}", "modes", GHOST_OPACITY) for k in range(3)]
        self.contacts = self._dots("/contacts", LAYERS["contacts"][1], 6 * ARROW)
        self.rejected = self._dots("/rejected", (30, 30, 30), 6 * ARROW)
        self.depth = self._dots("/depth", LAYERS["depth"][1], ARROW)
        self.normals = self._arrows("/normals", "contacts")
        self.forces = self._arrows("/forces", "forces")
        self.open_shifts = self._arrows("/open/slides", "open")
        blue = LAYERS["open"][1]
        purple = LAYERS["covariance"][1]
        width = 2 * ARROW
        self.turns = scene.add_line_segments("/open/turns", NO_LINES, blue, thickness=width, visible=False)
        self.covariance = scene.add_icosphere("/covariance", 1.0, purple, cast_shadow=False, visible=False)
        self.axes = scene.add_frame("/axes", axes_length=0.05, axes_radius=ARROW, visible=False)
        self.world = scene.add_frame("/world", show_axes=False, visible=False)
        """Axes of the world at the palm's origin: gravity and grid are in it, and turn with it."""
        gravity = self._arrows("/world/gravity", "frame")
        gravity.points = np.array([[[0, 0, 0], [0, 0, -0.1]]])
        gravity.visible = True
        below = (0, 0, -0.15)  # [m]
        grey = {"cell_color": GRID, "section_color": GRID}  # on white as on black
        size = {"width": 1, "height": 1, "cell_size": 0.05, "section_size": 0.25}
        scene.add_grid("/world/grid", **size, **grey, section_thickness=2, position=below)

    def draw(self, moment: Moment, forces: Mapping[str, Array]) -> None:
        """Shows a moment in place of the last one; `forces` are those of `Moment.forces`."""
        links = moment.links(self._rig)
        for name, handle in self.links.items():
            self._put(handle, "hand", links.get(name))
        T_world_palm = moment.T_world_palm
        self._put(self.axes, "frame", np.eye(4))
        upright = None if T_world_palm is None else se3.compose(T_world_palm[:3, :3].T, np.zeros(3))
        self._put(self.world, "frame", upright)
        self._draw_contacts(moment, forces)
        estimate = moment.estimate
        vision = moment.vision
        self._put(self.object, "object", None if estimate is None else estimate.T_palm_object)
        self._put(self.vision, "vision", None if vision is None else vision.T_palm_object)
        others = [] if estimate is None else [mode for mode in estimate.modes[1:] if mode["weight"] >= LIKELY]
        for k, handle in enumerate(self.modes):
            self._put(handle, "modes", others[k]["T_palm_object"] if k < len(others) else None)
        self._draw_uncertainty(moment)
        picture = moment.picture
        if picture is not None and picture is not self._picture:
            self._picture = picture
            self.depth.points = picture.points_palm
            self.depth.colors = picture.colors
        self.depth.visible = self.layers["depth"] and len(self.depth.points) > 0

    def _draw_contacts(self, moment: Moment, forces: Mapping[str, Array]) -> None:
        """Shows contacts, rejected ones in black, their normals, and the forces on the fingers."""
        fingertips = moment.fingertips
        points, normals = np.zeros((2, 0, 3))
        if fingertips.contacts is not None:
            points = fingertips.contacts.points_palm
            normals = fingertips.contacts.normals_palm
        rejected = np.array([name in moment.outliers for name in fingertips.fingers], dtype=bool)
        pressed = moment.skin.contacts()
        on_skin = np.zeros((0, 3)) if pressed is None else pressed.points_palm
        self._set(self.contacts, "contacts", np.concatenate([points[~rejected], on_skin]))
        self._set(self.rejected, "contacts", points[rejected])
        self._set(self.normals, "contacts", np.stack([points, points + NORMAL * normals], axis=1))
        arrows = []
        for name, point in zip(fingertips.fingers, points, strict=True):
            if name in forces:
                size = max(float(np.linalg.norm(forces[name])), LARGEST)
                arrows.append((point, point + METRES_PER_NEWTON * LARGEST / size * forces[name]))
        self._set(self.forces, "forces", arrows)

    def _draw_uncertainty(self, moment: Moment) -> None:
        """Shows where the object's middle is with 95 %, and the directions that contacts leave open."""
        estimate = moment.estimate
        model = self._model
        arrows = list[Array]()
        arcs = list[tuple[Array, Array]]()
        T_palm_axes = None
        if estimate is not None:
            T_palm_axes, semi_axes = ellipsoid(estimate, model)
            self.covariance.scale = tuple(semi_axes.clip(min=ARROW / 4).tolist())
            # Inside the object it must be opaque, to be drawn before it; around the object it must be translucent.
            inside = semi_axes.max() < 0.7 * model.radius
            self.covariance.opacity = None if inside else GHOST_OPACITY / 2
        self._put(self.covariance, "covariance", T_palm_axes)
        if estimate is not None and moment.fingertips.fingers:
            center = middle(model, estimate.T_palm_object)
            for direction in estimate.unobservable:
                straight, arc = open_direction(direction, center, model)
                arrows += list(straight)
                arcs += pairwise(arc)
        self._set(self.open_shifts, "open", arrows)
        self._set(self.turns, "open", arcs)

    def _put(self, handle: "SceneNodeHandle", layer: str, T_palm_node: Array | None) -> None:
        """Shows a node at its pose in the palm (4, 4), and hides it if that is None or its layer is not chosen."""
        visible = T_palm_node is not None and self.layers[layer]
        if T_palm_node is not None and visible:
            handle.position = T_palm_node[:3, 3]
            handle.wxyz = quaternions_wxyz(T_palm_node)
        handle.visible = visible

    def _set(self, handle: "SceneNodeHandle", layer: str, points: Array | Sequence[object]) -> None:
        """Shows a node of points or lines, and hides it if there are none or its layer is not chosen."""
        visible = self.layers[layer] and len(points) > 0
        if visible:
            handle.points = np.asarray(points)
        handle.visible = visible

    def _copy(self, name: str, layer: str, opacity: float) -> "SceneNodeHandle":
        """Returns a node of the object, as triangles or as points."""
        model = self._model
        color = LAYERS[layer][1]
        if not len(model.faces):
            points, _ = model.sample(4000)
            return self._scene.add_point_cloud(name, points, color, point_size=ARROW, visible=False)
        return self._scene.add_mesh_simple(
            name,
            model.vertices,
            model.faces,
            color=color,
            opacity=opacity,
            scale=1.0 if layer == "object" else 1.01,  # so that equal surfaces do not flicker
            side="double",
            cast_shadow=False,
            visible=False,
        )

    def _dots(self, name: str, color: Color, size: float) -> "SceneNodeHandle":
        """Returns a node of points of that size [m]."""
        none = np.zeros((0, 3), np.float32)
        return self._scene.add_point_cloud(
            name, none, color, point_size=size, point_shape="circle", visible=False
        )

    def _arrows(self, name: str, layer: str) -> "SceneNodeHandle":
        """Returns a node of arrows."""
        sizes = {"shaft_radius": ARROW, "head_radius": 3 * ARROW, "head_length": 7 * ARROW}
        return self._scene.add_arrows(name, NO_LINES, LAYERS[layer][1], **sizes, visible=False)


def quaternions_wxyz(Ts: Array) -> Array:
    """Returns the quaternions (..., 4), w first as in viser, of poses (..., 4, 4)."""
    return se3.quaternion_from_rotation(Ts[..., :3, :3])[..., [3, 0, 1, 2]]
