"""Pictures for people of a simulated grasp, and of the object at another pose."""

from contextlib import closing

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


class PictureRenderer(Renderer):
    """Draws one scene for people, larger and averaged."""

    def draw(
        self, configuration: Array, T_world_camera: Array, ghost: tuple[Array, Rgba] | None, show_object: bool
    ) -> Color:
        """Returns colour (h, w, 3); `ghost` is T_palm_object (4, 4) and colour of a second, translucent object."""
        self.pose(configuration, T_world_camera)
        geom = self.scene.model.geom("object").id
        for drawn in self.drawn.geoms[: self.drawn.ngeom]:
            if not show_object and drawn.objtype == self.mujoco.mjtObj.mjOBJ_GEOM and drawn.objid == geom:
                drawn.rgba[3] = 0.0
        if ghost is not None:
            (T_palm_object, rgba), model = ghost, self.scene.model
            palm = self.data.body(self.scene.hand.palm)
            T_world_palm = se3.compose(palm.xmat.reshape(3, 3), palm.xpos)
            # MuJoCo moves a mesh's frame to its principal axes of inertia.
            quaternion_xyzw = np.roll(model.geom_quat[geom], -1)
            T_object_geom = se3.from_position_quaternion(model.geom_pos[geom], quaternion_xyzw)
            T = T_world_palm @ T_palm_object @ T_object_geom
            added, kind = self.drawn.geoms[self.drawn.ngeom], int(model.geom_type[geom])
            pose, shade = (T[:3, 3], T[:3, :3].ravel()), np.array(rgba, np.float32)
            self.mujoco.mjv_initGeom(added, kind, model.geom_size[geom], *pose, shade)
            if model.geom_dataid[geom] >= 0:
                added.dataid = 2 * model.geom_dataid[geom]  # the mesh; the odd number after it is its hull
            self.drawn.ngeom += 1
        color, _ = self.pixels(finer=SUPERSAMPLING)
        blocks = color.reshape(IMAGE_SIZE[1], SUPERSAMPLING, IMAGE_SIZE[0], SUPERSAMPLING, 3)
        smooth: Color = blocks.mean(axis=(1, 3)).astype(np.uint8)
        return smooth


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
    wanted = None if ghost is None else (se3.check(ghost, "ghost"), color)
    with closing(PictureRenderer(built)) as renderer:
        return renderer.draw(sample.configuration, T, wanted, show_object)
