"""An object's surface out of depth images of many sides of it, their poses given or found by the growing surface."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from handsight import se3
from handsight._kernels.image import depth_term
from handsight._kernels.image.pose_score import OUT
from handsight._kernels.image.vision_records import CANDIDATE
from handsight._kernels.records import MODEL
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.vision.object.region import Scene, observed_points
from handsight.vision.reconstruction.volume import Volume


class ReconstructionOptions(NamedTuple):
    """`ReconstructionOptions` say how views are aligned and fused."""

    cell: float = 0.002  # of the volume [m]: finer is below what depth cameras resolve
    max_cells: int = 160  # along the longest side of a large one
    coarse_factor: int = 4  # how much larger the cells are with which a pose from farther away is aligned
    spacing: float = 0.003  # of the points that align a view with the surface [m]
    max_points: int = 3000  # of them
    min_fit: float = 0.4  # of a view's points, on the surface so far, or the view is left out
    min_points: int = 100  # of a view
    near: float = 0.5  # what fits is nearer than this [bounds]
    min_shift: float = 0.02  # a view that has not moved so far since the last one says nothing new [m]
    min_rotation: float = np.deg2rad(3)  # or turned so much [rad]


RECONSTRUCTION = ReconstructionOptions()

STAGES = ((False, 1.0, 0.5, 6), (True, 1.0, 0.6, 8))
"""Whether on the fine volume, Tukey's bound at first and at last [bounds], and steps."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A `View` is a depth image of the object."""

    depth: Depth
    """(h, w) along the optical axis [m]; 0 or NaN where there is none, or where it is the hand's."""
    T_camera_object: Array
    """(4, 4) as far as it is known; the object's frame is any that goes with the object."""


class Reconstruction:
    """A `Reconstruction` is a surface that grows view by view."""

    def __init__(self, camera: Camera, bounds_object: Array) -> None:
        """`bounds_object` (2, 3): the least and the largest coordinates of what is looked at [m]."""
        self.camera, self.bounds_object = camera, bounds_object
        cell = max(
            RECONSTRUCTION.cell, float((bounds_object[1] - bounds_object[0]).max()) / RECONSTRUCTION.max_cells
        )
        self.volume, self._coarse = (
            Volume(bounds_object, k * cell) for k in (1, RECONSTRUCTION.coarse_factor)
        )
        self._surface: _Surface | None = None
        self._fused: View | None = None
        self._last: tuple[View, View] | None = None

    def grow(self, view: View, *, estimate: bool = True) -> View | None:
        """Fuses a view, and says at which pose; None, and nothing happened, where it does not fit the surface so far.

        estimate: where it is the surface so far says, begun at the last one moved on as the views' own poses say; else
        it is where its own pose says. A view that has hardly moved is fitted, and not fused.
        """
        found: View | None = view
        if estimate and self._last is not None:
            moved = view.T_camera_object @ se3.inverse(self._last[0].T_camera_object)
            found = self.laid_on(View(view.depth, moved @ self._last[1].T_camera_object))
        if found is None:
            return None
        self._last = view, found
        if self._fused is None or _has_moved(self._fused.T_camera_object, found.T_camera_object):
            for volume in (self.volume, self._coarse):
                volume.fuse(self.camera, found.depth, found.T_camera_object)
            self._fused, self._surface = found, None
        return found

    def laid_on(self, view: View) -> View | None:
        """Returns the view at the pose where its points lie on the surface so far; None where they do not."""
        surface = self._surface = self._surface or _Surface(self._coarse, self.volume)
        points, T = (
            observed_points(self._scene(view), RECONSTRUCTION.spacing, RECONSTRUCTION.max_points),
            view.T_camera_object,
        )
        for fine, first, last, steps in STAGES:
            bound = (self.volume if fine else self._coarse).bound
            known = points[surface.tells(fine, se3.apply(se3.inverse(T), points["point"]))]
            T = surface.refined(known, T, np.array([fine, first * bound, last * bound, steps]))
        off = surface.distances(se3.apply(se3.inverse(T), known["point"]))
        fits = (np.abs(off) < RECONSTRUCTION.near * self.volume.bound).sum() > max(
            RECONSTRUCTION.min_fit * len(known), RECONSTRUCTION.min_points
        )
        return View(view.depth, T) if fits else None

    def _scene(self, view: View) -> Scene:
        """Returns the view's pixels that are in the bounds, as one part."""
        inside = within(self.camera, view, self.bounds_object)
        labels = np.where(inside, 0, OUT).astype(np.int32)
        return Scene(self.camera, view.depth, labels, np.array([float(inside.sum())]))


def within(camera: Camera, view: View, bounds_object: Array) -> Mask:
    """Returns (h, w) which pixels of a view show what lies in bounds (2, 3) [m]."""
    points_camera = camera.points(view.depth).reshape(-1, 3).astype(np.float64)
    points = se3.apply(se3.inverse(view.T_camera_object), points_camera).reshape(*view.depth.shape, 3)
    low, high = bounds_object
    with np.errstate(invalid="ignore"):
        return np.asarray(((points > low) & (points < high)).all(axis=-1) & (view.depth > 0))


class _Surface:
    """A `_Surface` is a growing surface as what views are laid on."""

    def __init__(self, coarse: Volume, fine: Volume) -> None:
        self._volumes = {False: coarse, True: fine}
        self._known = {scale: binary_erosion(volume.observed()) for scale, volume in self._volumes.items()}
        self._fine = fine.field()
        fields = [field.record for field in (coarse.field(), self._fine)]
        self._model, self._nodes = np.zeros(1, dtype=MODEL), np.concatenate([nodes for _, nodes in fields])
        self._model["coarse"], self._model["fine"] = (record for record, _ in fields)
        self._model["fine"]["nodes"] = len(fields[0][1])
        low, high = fine.bounds_object
        self._model["radius"], self._model["center"] = np.linalg.norm(high - low) / 2, (low + high) / 2

    def tells(self, fine: bool, points_object: Array) -> Mask:
        """Returns (n,) whether any view told what is at points (n, 3): else what is new would be drawn onto what is
        known."""
        return self._volumes[fine].among(self._known[fine], points_object)

    def distances(self, points_object: Array) -> Array:
        """Returns (n,) [m] from the surface."""
        return self._fine.evaluate(points_object).distance

    def refined(self, points: NDArray[np.void], T: Array, stage: Array) -> Array:
        """Returns T_camera_object (4, 4) where DEPTH_POINT (n,) lie on the surface, begun at T; stage: as of
        `refine_poses`."""
        candidate = np.zeros(1, dtype=CANDIDATE)
        candidate["pose"]["rotation"], candidate["pose"]["position"] = T[:3, :3], T[:3, 3]
        depth_term.refine_poses(self._model, self._nodes, points, stage, candidate)
        return se3.compose(candidate["pose"]["rotation"][0], candidate["pose"]["position"][0])


def _has_moved(T_camera_object: Array, to: Array) -> bool:
    """Returns whether the camera has, seen from the object."""
    shift, turn = np.split(se3.difference(se3.inverse(to), se3.inverse(T_camera_object)), 2)
    return bool(
        np.linalg.norm(shift) > RECONSTRUCTION.min_shift or np.linalg.norm(turn) > RECONSTRUCTION.min_rotation
    )
