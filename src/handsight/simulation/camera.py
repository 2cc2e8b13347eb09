"""The depth camera at the shoulder: its calibrated pose and its error, its images and the errors of their depth.

Images of the scene are drawn without a screen, from any pose.
"""

import os
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import fftfreq, irfft2, rfft2
from scipy.ndimage import minimum_filter
from scipy.special import ndtri

from handsight import checks, se3
from handsight.camera import Depth
from handsight.checks import Array
from handsight.errors import MissingExtra
from handsight.simulation.scenario import Scenario
from handsight.simulation.scene import (
    FOCAL_LENGTH,
    IMAGE_SIZE,
    SimulatedScene,
    mujoco_module,
)
from handsight.simulation.tables import tables
from handsight.vision import DepthNoise
from handsight.vision.pixels import Color

if TYPE_CHECKING:
    from mujoco.gl_context import GLContext


TARGET = np.array(tables()["camera"]["target"])
"""The point that the camera faces, and about which its calibration is turned, in the world [m]."""
INTRINSICS = np.diag([FOCAL_LENGTH, FOCAL_LENGTH, 1.0])
INTRINSICS[:2, 2] = (np.array(IMAGE_SIZE) - 1) / 2
"""The camera matrix (3, 3) [pixels]; the centres of pixels have integer coordinates."""
EDGE = 0.02
"""How much nearer a surface at less than 1 m must be for depth to be lost beside it [m]; at z > 1 m it is `EDGE` z², as
a step in disparity is."""


def camera_facing(eye: ArrayLike, at: ArrayLike) -> Array:
    """Returns T_world_camera (4, 4) of an upright camera at `eye` (3,) [m] that faces the point `at` (3,) [m].

    Optical frame: x right, y down, z forward.
    """
    origin = checks.finite(eye, "eye", (3,))
    z = checks.unit(checks.finite(at, "at", (3,)) - origin, "at - eye", (3,))
    x = checks.unit(np.cross(z, [0.0, 0, 1]), "at - eye, seen from above", (3,))
    return se3.compose(np.column_stack([x, np.cross(z, x), z]), origin)


CALIBRATED_CAMERA = camera_facing(
    tables()["camera"]["eye"], TARGET
)  # T_world_camera (4, 4) of the robot's rig


def calibration_error(scenario: Scenario) -> Array:
    """Returns T_measured_true (4, 4) in the world: it maps true poses to where the wrong calibration places them. It is
    a constant rotation about `TARGET` and a constant shift, drawn by the seed."""
    nuisances = scenario.nuisances
    draw = scenario.stream(4).normal(size=6)
    # The mean length of a Gaussian in the plane is √(π/2) of its sigma.
    plane = nuisances.camera_position / np.sqrt(np.pi / 2)
    shift = draw[:3] * [plane, plane, nuisances.camera_height]
    return moved_about_target(shift, nuisances.camera_rotation * draw[3:])


def moved_about_target(shift: Array, rotation: Array) -> Array:
    """Returns the rigid motion (4, 4) of a rotation (3,) [rad] about `TARGET`, and of a shift (3,) [m]."""
    R = se3.rotation_exp(rotation)
    return se3.compose(R, TARGET + shift - R @ TARGET)


def true_camera(scenario: Scenario) -> Array:
    """Returns the true T_camera_world (4, 4) of the robot's camera; the rig's own is wrong by `calibration_error`."""
    return se3.inverse(CALIBRATED_CAMERA) @ calibration_error(scenario)


def add_depth_noise(depth: Depth, noise: DepthNoise, rng: np.random.Generator, seed: int) -> Depth:
    """Returns the depth image (h, w) [m] that a camera measures of true depth (h, w) [m]; NaN where it has none.

    `rng` draws the noise of this image; `seed` (at least 0) draws the constant errors, so another seed is another
    camera. Without noise, depth in range is exact.
    """
    z = np.asarray(depth, dtype=np.float32)
    known = (z > noise.nearest) & (z < noise.farthest)  # False for NaN
    dropouts = np.full(z.shape, noise.dropouts, dtype=np.float32)
    if noise.edges > 0:  # more behind edges
        there = np.where(z > 0, z, np.float32(np.inf))
        nearest = minimum_filter(there, 2 * noise.edge_width + 1, mode="constant", cval=np.inf)
        behind = z > nearest + np.float32(EDGE) * np.square(np.maximum(nearest, 1))
        dropouts[behind] = noise.edges
    known &= rng.random(z.shape, dtype=np.float32) >= dropouts
    z = _laterally_displaced(z, noise.lateral, rng)
    known &= (z > noise.nearest) & (z < noise.farthest)
    z = np.where(known, z, np.float32(1))
    a, b, c = map(np.float32, noise.axial)
    coarse = np.float32(noise.step)
    step = coarse * z * z
    # The axial noise includes rounding, which is uniform over a step.
    axial = a + z * (b + z * c)
    sigma = np.sqrt(np.maximum(np.square(axial) - step * step / 12, 0))
    # Part of the noise is correlated; both parts come from the same numbers, half an image apart.
    drawn = _white(z.shape, rng)
    share = np.float32(noise.correlated)
    grain = _smoothed(drawn, noise.correlation)
    grain *= np.sqrt(share)
    grain += np.sqrt(1 - share) * np.roll(drawn, (z.shape[0] // 2, z.shape[1] // 2), axis=(0, 1))
    offset, smooth = _constant_errors(z.shape, noise.smooth_length, seed)
    constant = np.float32(noise.offset) * offset + np.float32(noise.smooth) * smooth * z * z
    z = z + sigma * grain + constant
    if noise.step > 0:
        disparity = np.rint(1 / (coarse * np.maximum(z, np.float32(0.01))))
        z = np.asarray(1 / (coarse * np.maximum(disparity, 1)), dtype=np.float32)
    return np.where(known, z, np.float32(np.nan))


def _laterally_displaced(z: Depth, sigma: float, rng: np.random.Generator) -> Depth:
    """Returns the image (h, w) in which each pixel has the depth of a pixel near it, `sigma` pixels along each axis."""
    if sigma == 0:
        return z
    offsets = np.rint(sigma * _quantiles(256)).astype(np.int32)  # whole pixels, a byte for each axis
    largest = int(offsets.max())
    around = np.pad(z, largest, mode="edge")
    width = around.shape[1]
    pairs = (offsets[:, None] * width + offsets).ravel()
    places = pairs[rng.integers(1 << 16, size=z.shape, dtype=np.uint16)]
    places += width * np.arange(largest, largest + z.shape[0], dtype=np.int32)[:, None]
    places += np.arange(largest, largest + z.shape[1], dtype=np.int32)
    return np.asarray(around.ravel()[places])


@lru_cache(maxsize=8)
def _constant_errors(shape: tuple[int, ...], length: float, seed: int) -> tuple[np.float32, Depth]:
    """Returns one camera's standard normal offset, and its smooth field (h, w) of unit variance."""
    rng = np.random.default_rng((seed, 10))
    return np.float32(rng.normal()), _smoothed(_white(shape, rng), length)


def _white(shape: tuple[int, ...], rng: np.random.Generator) -> Depth:
    """Returns (h, w) standard normal numbers, rounded to 65 536 values, which takes a third of the time."""
    return _quantiles(1 << 16)[rng.integers(1 << 16, size=shape, dtype=np.uint16)]


@lru_cache(maxsize=2)
def _quantiles(number: int) -> Depth:
    """Returns (number,) equally likely values of a standard normal distribution."""
    return np.asarray(ndtri((np.arange(number) + 0.5) / number), dtype=np.float32)


def _smoothed(white: Depth, length: float) -> Depth:
    """Returns noise (h, w) of unit variance and correlation exp(-d²/length²) at distance d [pixels], periodic."""
    rows, columns = (np.exp(-0.5 * np.square(np.pi * length * fftfreq(n))) for n in white.shape)
    scale = (np.square(rows).mean() * np.square(columns).mean()) ** -0.5
    weights = np.outer(scale * rows, columns[: len(columns) // 2 + 1]).astype(np.float32)
    return np.asarray(irfft2(rfft2(white) * weights, s=white.shape), dtype=np.float32)


class Renderer:
    """Draws one scene from any camera pose; it must be closed before the next is opened."""

    def __init__(self, built: SimulatedScene) -> None:
        """Raises MissingExtra where neither EGL nor OSMesa can draw."""
        mujoco = self.mujoco = mujoco_module()
        self.scene = built
        self.data = mujoco.MjData(built.model)
        # An own context, for the kind of mujoco.Renderer's is fixed when mujoco is first imported.
        self._context = _context()
        self._context.make_current()
        self.drawn = mujoco.MjvScene(built.model, maxgeom=400)
        self._option = mujoco.MjvOption()
        # Neither the hand's collision shapes (group 4) nor hidden geoms (5) are drawn.
        self._option.geomgroup[:] = [1, 1, 0, 0, 0, 0]
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = 0  # the only one
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
        self.pose(configuration, T_world_camera)
        self.drawn.flags[self.mujoco.mjtRndFlag.mjRND_SHADOW] = 0  # takes half of the time
        color, buffer = self.pixels()
        planes = self.scene.model.vis.map  # in units of the scene's extent, which is 1
        # The buffer is linear in 1 / z, from 1 at the near plane to 0 at the far one.
        near, far = np.float32(planes.znear), np.float32(planes.zfar)
        return color, near * far / (near + buffer * (far - near))

    def pose(self, configuration: Array, T_world_camera: Array) -> None:
        """Moves the scene to a configuration and the camera to its pose, for the next picture."""
        model = self.scene.model
        data = self.data
        data.qpos[:] = configuration
        self.mujoco.mj_kinematics(model, data)
        self.mujoco.mj_camlight(model, data)
        camera = data.camera("camera")
        # OpenGL looks along -z, y up.
        camera.xpos[:] = T_world_camera[:3, 3]
        camera.xmat[:] = (T_world_camera[:3, :3] * [1, -1, -1]).ravel()
        every = self.mujoco.mjtCatBit.mjCAT_ALL.value
        self.mujoco.mjv_updateScene(model, data, self._option, None, self._camera, every, self.drawn)

    def pixels(self, *, finer: int = 1) -> tuple[Color, Depth]:
        """Returns colour (h, w, 3) and the depth buffer (h, w), of `finer` times the image's size."""
        self._context.make_current()
        width, height = finer * np.array(IMAGE_SIZE)
        color = np.empty((height, width, 3), np.uint8)
        depth = np.empty((height, width), np.float32)
        rectangle = self.mujoco.MjrRect(0, 0, width, height)
        self.mujoco.mjr_render(rectangle, self.drawn, self._device)
        self.mujoco.mjr_readPixels(color, depth, rectangle, self._device)
        return color[::-1].copy(), depth[::-1].copy()  # OpenGL's first row is the lowest


def _context() -> "GLContext":
    """Returns an OpenGL context without a screen, of the kind that $MUJOCO_GL names, else EGL, else OSMesa. Raises
    MissingExtra with the reasons why there is none."""
    named = os.environ.get("MUJOCO_GL", "").strip().lower()
    kinds = (named,) if named in ("egl", "osmesa") else ("egl", "osmesa")
    reasons = []
    for kind in kinds:
        os.environ["PYOPENGL_PLATFORM"] = kind
        try:
            return import_module(f"mujoco.{kind}").GLContext(*IMAGE_SIZE)
        except (ImportError, RuntimeError, AttributeError, OSError) as error:
            # PyOpenGL raises the last two where a library is missing.
            reasons.append(f"{kind}: {str(error).partition(chr(10))[0] or type(error).__name__}")
    expected = "expected EGL or OSMesa (Debian: libegl1 or libosmesa6)"
    raise MissingExtra(f"images need software rendering, {expected}, got {'; '.join(reasons)}")
