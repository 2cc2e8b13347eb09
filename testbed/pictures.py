"""Pictures for people of a simulated grasp, and of the object at another pose."""

from collections.abc import Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from handsight import se3
from handsight.errors import InvalidInput
from handsight.simulation import Sample, Scenario
from handsight.simulation.camera import CALIBRATED_CAMERA, Renderer
from handsight.simulation.scene import IMAGE_SIZE, SUPERSAMPLING, scene
from handsight.vision.pixels import Color
from testbed.report import Array

Rgba = tuple[float, float, float, float]  # red, green, blue and opacity, each 0 to 1
ENLARGED = 1.01  # so that equal surfaces do not flicker


class Line(NamedTuple):
    """A line or an arrow in the palm's frame."""

    begin: Array  # (3,) [m]
    end: Array  # (3,) [m]
    width: float  # [m]
    rgba: Rgba
    arrow: bool


class PictureRenderer(Renderer):
    """Draws one scene for people, larger and averaged."""

    def draw(
        self,
        configuration: Array,
        T_world_camera: Array,
        ghosts: Sequence[tuple[Array, Rgba]] = (),
        lines: Sequence[Line] = (),
        *,
        opacity: float = 1.0,
    ) -> Color:
        """Returns colour (h, w, 3) of the scene, the object in it of some opacity, with other objects, each at
        T_palm_object (4, 4), and with lines."""
        self.pose(configuration, T_world_camera)
        geom = self.scene.model.geom("object").id
        for drawn in self.drawn.geoms[: self.drawn.ngeom]:
            if drawn.objtype == self.mujoco.mjtObj.mjOBJ_GEOM and drawn.objid == geom:
                drawn.rgba[3] = opacity
        palm = self.data.body(self.scene.hand.palm)
        T_world_palm = se3.compose(palm.xmat.reshape(3, 3), palm.xpos)
        for T_palm_object, rgba in ghosts:
            self._add_object(T_world_palm @ T_palm_object, rgba)
        for line in lines:
            self._add_line(line, T_world_palm)
        color, _ = self.pixels(finer=SUPERSAMPLING)
        blocks = color.reshape(IMAGE_SIZE[1], SUPERSAMPLING, IMAGE_SIZE[0], SUPERSAMPLING, 3)
        smooth: Color = blocks.mean(axis=(1, 3)).astype(np.uint8)
        return smooth

    def _add_object(self, T_world_object: Array, rgba: Rgba) -> None:
        """Adds the object at another pose."""
        model = self.scene.model
        geom = model.geom("object").id
        # MuJoCo moves a mesh's frame to its principal axes of inertia.
        quaternion_xyzw = np.roll(model.geom_quat[geom], -1)
        T = T_world_object @ se3.from_position_quaternion(model.geom_pos[geom], quaternion_xyzw)
        added = self.drawn.geoms[self.drawn.ngeom]
        kind = int(model.geom_type[geom])
        size = ENLARGED * model.geom_size[geom]
        self.mujoco.mjv_initGeom(added, kind, size, T[:3, 3], T[:3, :3].ravel(), np.array(rgba, np.float32))
        if model.geom_dataid[geom] >= 0:
            added.dataid = 2 * model.geom_dataid[geom]  # the mesh; the odd number after it is its hull
        self.drawn.ngeom += 1

    def _add_line(self, line: Line, T_world_palm: Array) -> None:
        """Adds a line, with a head at its end if it is an arrow."""
        shapes = self.mujoco.mjtGeom
        kind = (shapes.mjGEOM_ARROW if line.arrow else shapes.mjGEOM_CAPSULE).value
        begin, end = se3.apply(T_world_palm, np.array([line.begin, line.end]))
        added = self.drawn.geoms[self.drawn.ngeom]
        still = np.zeros(3)
        self.mujoco.mjv_initGeom(
            added, kind, still, still, np.eye(3).ravel(), np.array(line.rgba, np.float32)
        )
        self.mujoco.mjv_connector(added, kind, line.width, begin, end)
        added.emission = 0.6  # as bright in the shade
        self.drawn.ngeom += 1


def render(
    scenario: Scenario,
    sample: Sample,
    *,
    ghost: ArrayLike | None = None,
    color: Rgba = (0.95, 0.75, 0.1, 0.6),
    show_object: bool = True,
    T_world_camera: ArrayLike | None = None,
) -> Color:
    """Returns a picture (480, 640, 3) of hand, object and table in a sample.

    `ghost` is T_palm_object (4, 4) of a second object, drawn in `color` (red, green, blue, opacity, 0 to 1); the true
    one is drawn if `show_object`. `T_world_camera` (4, 4) is the pose of the camera's optical frame in the rig's world;
    None: the pose of the robot's own camera. Raises InvalidInput; MissingExtra where nothing can draw.
    """
    built = scene(scenario.object, rig=scenario.rig)
    if sample.configuration.shape != (built.model.nq,):
        raise InvalidInput(f"sample: expected one of the scenario's ({scenario.object}), got another scene's")
    T = CALIBRATED_CAMERA if T_world_camera is None else se3.check(T_world_camera, "T_world_camera")
    ghosts = [] if ghost is None else [(se3.check(ghost, "ghost"), color)]
    with closing(PictureRenderer(built)) as renderer:
        return renderer.draw(sample.configuration, T, ghosts, opacity=float(show_object))
