"""An object's surface from depth images of many sides of it, their poses given or found by the growing surface."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are used
from numpy.typing import NDArray

from handsight import se3
from handsight._compiled.records import MODEL
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.vision.candidates import NOTHING_KNOWN, candidates_at, poses_of
from handsight.vision.kernels import depth_term
from handsight.vision.kernels.vision_records import OUT, STAGE
from handsight.vision.object.region import Scene, observed_points
from handsight.vision.reconstruction.volume import Volume

VOLUME_CELL = 0.002  # of the volume [m]: finer is below what depth cameras resolve
MAX_CELLS = 160  # along the longest side of a large one
COARSE_FACTOR = 4  # how much larger the cells are of the volume that aligns a view first
VOLUME_SPACING = 0.003  # of the points that align a view with the surface [m]
MAX_POINTS = 3000  # of them
MIN_FIT = 0.4  # share of a view's points on the surface so far, or the view is left out
MIN_POINTS = 100  # of a view, on the surface so far
VOLUME_NEAR = 0.5  # a point on the surface is nearer to it than this [bounds]
MIN_MOTION = (0.02, float(np.deg2rad(3)))
"""A view is fused if the camera has moved or turned so far since the last one [m, rad]."""

STAGES = np.array([(0, 1.0, 0.5, 6, 1), (1, 1.0, 0.6, 8, 1)], dtype=STAGE)
"""How a view is aligned with the coarse and then the fine volume, with bounds in those of the volume."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A depth image of the object."""

    depth: Depth  # (h, w) along the optical axis [m]; 0 or NaN where there is none, or where it is the hand's
    T_camera_object: Array  # (4, 4) as far as known; the object's frame is any that moves with it
    tips_object: Array | None = None
    """(k, 3) centres of the fingertips that hold the object, in its frame [m]; None: it is not in a hand."""


class Reconstruction:
    """A surface that grows view by view."""

    def __init__(
        self,
        camera: Camera,
        bounds_object: Array,
        *,
        min_motion: tuple[float, float] = MIN_MOTION,
    ) -> None:
        """`bounds_object` (2, 3): the least and the largest coordinates of the object [m].

        min_motion: a view is fused if the camera has moved or turned more than that since the last one [m, rad].
        """
        self._min_motion = min_motion
        self.camera = camera
        self.bounds_object = bounds_object
        longest = float((bounds_object[1] - bounds_object[0]).max())
        cell = max(VOLUME_CELL, longest / MAX_CELLS)
        self.volume = Volume(bounds_object, cell)
        self._coarse = Volume(bounds_object, COARSE_FACTOR * cell)
        self._surface: Surface | None = None
        self._fused: View | None = None
        self._last: tuple[View, View] | None = None

    def grow(self, view: View, *, estimate: bool = True) -> View | None:
        """Fuses a view, and returns it with its pose; None, and nothing changes, where it does not fit the surface.

        estimate: the pose is found by the surface so far, from that of the last view on, moved as the views' own poses
        say; else it is the view's own. A view that has hardly moved is aligned, but not fused.
        """
        found: View | None = view
        if estimate and self._last is not None:
            moved = view.T_camera_object @ se3.inverse(self._last[0].T_camera_object)
            found = self.aligned(View(view.depth, moved @ self._last[1].T_camera_object))
        if found is None:
            return None
        self._last = view, found
        moved = np.full(6, np.inf)
        if self._fused is not None:  # how the camera has moved, seen from the object
            poses = (se3.inverse(each.T_camera_object) for each in (found, self._fused))
            moved = se3.difference(*poses)
        shift = np.linalg.norm(moved[:3])
        turn = np.linalg.norm(moved[3:])
        if shift > self._min_motion[0] or turn > self._min_motion[1]:
            for volume in (self.volume, self._coarse):
                volume.fuse(self.camera, found.depth, found.T_camera_object)
            self._fused = found
            self._surface = None
        return found

    @property
    def views(self) -> int:
        """Number of views in the surface."""
        return self.volume.views

    def surface(self) -> "Surface":
        """Returns the surface so far."""
        self._surface = self._surface or Surface(self._coarse, self.volume)
        return self._surface

    def aligned(self, view: View) -> View | None:
        """Returns the view at the pose where its points lie on the surface so far; None where they do not."""
        inside = within(self.camera, view, self.bounds_object)
        labels = np.where(inside, 0, OUT).astype(np.int32)
        sizes = np.array([float(inside.sum())])
        scene = Scene(self.camera, view.depth, labels, sizes)
        points = observed_points(scene, VOLUME_SPACING, MAX_POINTS)
        T, some = self.placed(points, view.T_camera_object)
        off = np.abs(self.surface().fine.evaluate(se3.apply(se3.inverse(T), some["point"])).distance)
        enough = max(MIN_FIT * len(some), MIN_POINTS)
        return View(view.depth, T) if (off < VOLUME_NEAR * self.volume.bound).sum() > enough else None

    def placed(self, points: NDArray[np.void], T: Array) -> tuple[Array, NDArray[np.void]]:
        """Returns the pose near T_camera_object (4, 4) at which DEPTH_POINT (n,) lie on the surface so far. And those
        of the points that were in places that have been observed."""
        surface = self.surface()
        for stage, volume, known in zip(STAGES, (self._coarse, self.volume), surface.known, strict=True):
            # Places that no view has observed yet would be pulled onto known surfaces.
            some = points[volume.among(known, se3.apply(se3.inverse(T), points["point"]))]
            candidate = candidates_at(T[None])
            stages = np.atleast_1d(stage)
            depth_term.refine_poses(*surface.record, some, stages, volume.bound, NOTHING_KNOWN, candidate)
            T = poses_of(candidate)[0]
        return T, some


def within(camera: Camera, view: View, bounds_object: Array) -> Mask:
    """Returns (h, w) whether the point of each pixel of a view lies in bounds (2, 3) [m]."""
    points_camera = camera.points(view.depth).reshape(-1, 3).astype(np.float64)
    points = se3.apply(se3.inverse(view.T_camera_object), points_camera).reshape(*view.depth.shape, 3)
    low, high = bounds_object
    with np.errstate(invalid="ignore"):
        return np.asarray(((points > low) & (points < high)).all(axis=-1) & (view.depth > 0))


class Surface:
    """The surface so far, as a model that views are aligned with."""

    def __init__(self, coarse: Volume, fine: Volume) -> None:
        self.known = [scipy.ndimage.binary_erosion(volume.observed()) for volume in (coarse, fine)]
        """Which nodes of each volume any view has observed (nx, ny, nz)."""
        self.fine = fine.field()
        fields = [coarse.field().record, self.fine.record]
        low, high = fine.bounds_object
        model = np.zeros(1, dtype=MODEL)
        model["coarse"], model["fine"] = (record for record, _ in fields)
        model["fine"]["nodes"] = len(fields[0][1])
        model["radius"] = np.linalg.norm(high - low) / 2
        model["center"] = (low + high) / 2
        self.record = model, np.concatenate([nodes for _, nodes in fields])
        """MODEL (1,), and the nodes of both fields."""
