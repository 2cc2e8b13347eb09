"""Pictures of the scene, drawn without a screen."""

import os
from contextlib import closing
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from handsight import se3
from handsight.camera import Depth
from handsight.checks import Array
from handsight.errors import InvalidInput, MissingExtra
from handsight.simulation.camera import CALIBRATED_CAMERA
from handsight.simulation.scenario import Sample, Scenario
from handsight.simulation.scene import IMAGE_SIZE, SCENE, SimulatedScene, mujoco_module, scene
from handsight.vision.pixels import Color

if TYPE_CHECKING:
    from mujoco.gl_context import GLContext

Rgba = tuple[float, float, float, float]  # red, green, blue and opacity, each 0 to 1


class Renderer:
    """A `Renderer` draws one scene from any camera pose; it must be closed before the next is opened."""

    def __init__(self, built: SimulatedScene) -> None:
        """Raises MissingExtra where neither EGL nor OSMesa can draw."""
        mujoco = self._mujoco = mujoco_module()
        self._scene, self._data = built, mujoco.MjData(built.model)
        # An own context, for the kind of mujoco.Renderer's is fixed when mujoco is first imported.
        self._context = _context()
        self._context.make_current()
        self._drawn, self._option = mujoco.MjvScene(built.model, maxgeom=400), mujoco.MjvOption()
        # Neither the hand's collision shapes (group 4) nor hidden geoms (5) are drawn.
        self._option.geomgroup[:] = [1, 1, 0, 0, 0, 0]
        self._camera = mujoco.MjvCamera()
        self._camera.type, self._camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0  # the only one
        self._device = mujoco.MjrContext(built.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._device)
        self._device.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR

    def close(self) -> None:
        """Frees the device; nothing can be drawn afterwards."""
        self._context.make_current()
        self._device.free()
        self._context.free()

    def take(self, configuration: Array, T_world_camera: Array) -> tuple[Color, Depth]:
        """Returns colour (h, w, 3), and depth (h, w) along the optical axis [m], of the scene in a configuration."""
        self._pose(configuration, T_world_camera)
        self._drawn.flags[self._mujoco.mjtRndFlag.mjRND_SHADOW] = 0  # takes half of the time
        color, buffer = self._pixels()
        planes = self._scene.model.vis.map  # in units of the scene's extent, which is 1
        # The buffer is linear in 1 / z, from 1 at the near plane to 0 at the far one.
        near, far = np.float32(planes.znear), np.float32(planes.zfar)
        return color, near * far / (near + buffer * (far - near))

    def draw(
        self, configuration: Array, T_world_camera: Array, ghost: tuple[Array, Rgba] | None, show_object: bool
    ) -> Color:
        """Returns colour (h, w, 3); `ghost` is T_palm_object (4, 4) and colour of a second, translucent object."""
        self._pose(configuration, T_world_camera)
        geom = self._scene.model.geom("object").id
        for drawn in self._drawn.geoms[: self._drawn.ngeom]:
            if not show_object and drawn.objtype == self._mujoco.mjtObj.mjOBJ_GEOM and drawn.objid == geom:
                drawn.rgba[3] = 0.0
        if ghost is not None:
            (T_palm_object, rgba), model = ghost, self._scene.model
            palm = self._data.body(self._scene.hand.palm)
            T_world_palm = se3.compose(palm.xmat.reshape(3, 3), palm.xpos)
            # MuJoCo moves a mesh's frame to its principal axes of inertia.
            quaternion_xyzw = np.roll(model.geom_quat[geom], -1)
            T_object_geom = se3.from_position_quaternion(model.geom_pos[geom], quaternion_xyzw)
            T = T_world_palm @ T_palm_object @ T_object_geom
            added, kind = self._drawn.geoms[self._drawn.ngeom], int(model.geom_type[geom])
            pose, shade = (T[:3, 3], T[:3, :3].ravel()), np.array(rgba, np.float32)
            self._mujoco.mjv_initGeom(added, kind, model.geom_size[geom], *pose, shade)
            if model.geom_dataid[geom] >= 0:
                added.dataid = 2 * model.geom_dataid[geom]  # the mesh; the odd number after it is its hull
            self._drawn.ngeom += 1
        color, _ = self._pixels(finer=SCENE.supersampling)
        blocks = color.reshape(IMAGE_SIZE[1], SCENE.supersampling, IMAGE_SIZE[0], SCENE.supersampling, 3)
        smooth: Color = blocks.mean(axis=(1, 3)).astype(np.uint8)
        return smooth

    def _pose(self, configuration: Array, T_world_camera: Array) -> None:
        """Moves the scene to a configuration and the camera to its pose, for the next picture."""
        model, data = self._scene.model, self._data
        data.qpos[:] = configuration
        self._mujoco.mj_kinematics(model, data)
        self._mujoco.mj_camlight(model, data)
        camera = data.camera("camera")
        # OpenGL looks along -z, y up.
        camera.xpos[:], camera.xmat[:] = T_world_camera[:3, 3], (T_world_camera[:3, :3] * [1, -1, -1]).ravel()
        every = self._mujoco.mjtCatBit.mjCAT_ALL.value
        self._mujoco.mjv_updateScene(model, data, self._option, None, self._camera, every, self._drawn)

    def _pixels(self, *, finer: int = 1) -> tuple[Color, Depth]:
        """Returns colour (h, w, 3) and the depth buffer (h, w), of `finer` times the image's size."""
        self._context.make_current()
        width, height = finer * IMAGE_SIZE[0], finer * IMAGE_SIZE[1]
        color, depth = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.float32)
        rectangle = self._mujoco.MjrRect(0, 0, width, height)
        self._mujoco.mjr_render(rectangle, self._drawn, self._device)
        self._mujoco.mjr_readPixels(color, depth, rectangle, self._device)
        return color[::-1].copy(), depth[::-1].copy()  # OpenGL's first row is the lowest


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
    with closing(Renderer(built)) as renderer:
        return renderer.draw(sample.configuration, T, wanted, show_object)


def _context() -> "GLContext":
    """Returns an OpenGL context without a screen, of the kind that $MUJOCO_GL names, else EGL, else OSMesa. Raises
    MissingExtra with the reasons why there is none."""
    named = os.environ.get("MUJOCO_GL", "").strip().lower()
    kinds = (named,) if named in ("egl", "osmesa") else ("egl", "osmesa")
    platform, reasons = os.environ.get("PYOPENGL_PLATFORM"), []
    for kind in kinds:
        try:
            return import_module(f"mujoco.{kind}").GLContext(*IMAGE_SIZE)
        except (ImportError, RuntimeError, AttributeError, OSError) as error:
            # PyOpenGL raises the last two where a library is missing.
            reasons.append(f"{kind}: {str(error).splitlines()[0] if str(error) else type(error).__name__}")
            os.environ.pop("PYOPENGL_PLATFORM", None)  # the import has set it
            if platform is not None:
                os.environ["PYOPENGL_PLATFORM"] = platform
    expected = "expected EGL or OSMesa (Debian: libegl1 or libosmesa6)"
    raise MissingExtra(f"images need software rendering, {expected}, got {'; '.join(reasons)}")
