"""BOP's errors of a pose, and the average recall (AR) over their thresholds.

As in T. Hodaň et al., "BOP Challenge 2020 on 6D Object Localization", ECCV Workshops 2020, section 2.2:

  VSD   share of the visible pixels in which the surfaces at both poses are farther than tau from each other; tau is .05
        to .5 of the diameter, and what lies up to 15 mm behind the measured surface is visible
  MSSD  largest distance of a surface point from where it is, of the diameter, for the symmetry for which it is least
  MSPD  the same in the image [pixels of an image 640 wide]

A pose is correct where its error is below a threshold: .05 to .5 for VSD and MSSD, 5 to 50 pixels for MSPD. The recall
is the share of objects with a correct pose, averaged over the thresholds (of VSD also over tau); AR is the mean of the
three. Here an error is measured on the convex hull's vertices and samples of the others, and a continuous symmetry is
sampled every degree.
"""

import functools
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.objects import Symmetries, about
from testbed.report import Array

SHARES = 0.05 * np.arange(1, 11)
"""Thresholds of VSD and MSSD, and tau [diameters]."""
PIXELS = 5.0 * np.arange(1, 11)
"""Thresholds of MSPD, of an image `IMAGE_WIDTH` wide."""
IMAGE_WIDTH = 640
BEHIND = 0.015
"""What lies up to so far behind the measured surface is visible [m]."""
SPINS = 360
"""Samples of a continuous symmetry."""
VERTICES = 600
"""Vertices beside the convex hull's whose largest distance in the image is taken."""


@dataclass(frozen=True)
class BopErrors:
    """`BopErrors` are the errors of a pose by which BOP judges it."""

    vsd: Array
    """(10,) for each tau of `SHARES`."""
    mssd: float
    """[diameters]"""
    mspd: float
    """[pixels of an image `IMAGE_WIDTH` wide]"""

    @property
    def recalls(self) -> tuple[float, float, float]:
        """The shares of thresholds at which the pose is correct, by VSD, MSSD and MSPD."""
        vsd = float((self.vsd[:, None] < SHARES).mean())
        return vsd, float((self.mssd < SHARES).mean()), float((self.mspd < PIXELS).mean())


def pose_errors(model: hs.ObjectModel, camera: Camera, measured: Array, T_true: Array, T: Array) -> BopErrors:
    """Returns the errors of a pose T_camera_object (4, 4) against the true one; measured (h, w) [m]: depth."""
    truth, estimate = (distances(camera, drawn(model, camera, at)) for at in (T_true, T))
    vsd = visible_discrepancy(distances(camera, measured), truth, estimate, model.diameter)
    return BopErrors(vsd, mssd(model, T_true, T), mspd(model, camera, T_true, T))


def drawn(model: hs.ObjectModel, camera: Camera, T: Array) -> Array:
    """Returns the depth (h, w) [m] of the object at T_camera_object (4, 4), 0 where it is not."""
    depth = camera.draw(se3.apply(T, model.vertices), model.faces).depth
    return np.asarray(np.where(np.isfinite(depth), depth, 0.0))


def distances(camera: Camera, depth: Array) -> Array:
    """Returns the distances (h, w) from the camera's centre [m] of depth (h, w) [m]; 0 where there is none."""
    length = np.sqrt((camera.rays.astype(np.float64) ** 2).sum(axis=2) + 1)
    return np.asarray(np.where(np.isfinite(depth), depth, 0.0) * np.nan_to_num(length))


def visible_discrepancy(measured: Array, truth: Array, estimate: Array, diameter: float) -> Array:
    """Returns VSD (10,) for each tau of `SHARES` from distances (h, w) [m] that are 0 where there is none."""
    unknown = measured == 0
    of_truth = (truth > 0) & ((truth - measured <= BEHIND) | unknown)
    of_estimate = (estimate > 0) & ((estimate - measured <= BEHIND) | unknown | of_truth)
    both, either = of_truth & of_estimate, int((of_truth | of_estimate).sum())
    if not either:
        return np.ones(len(SHARES))
    off = np.abs(truth[both] - estimate[both]) / diameter
    wrong = (off >= SHARES[:, None]).sum(axis=1) + either - both.sum()
    return np.asarray(wrong / either)


@functools.lru_cache(maxsize=128)
def hull(model: hs.ObjectModel) -> Array:
    """Returns the vertices (k, 3) of the convex hull [m]: the distance of two poses of a point is largest at one."""
    return np.asarray(model.vertices[ConvexHull(model.vertices).vertices])


@functools.lru_cache(maxsize=128)
def equivalents(symmetries: Symmetries) -> Array:
    """Returns the symmetries (k, 4, 4), continuous ones sampled; of a ball none but the identity, see `mssd`."""
    if not symmetries.axes or symmetries.round:
        return symmetries.rotations
    point, axis = symmetries.axes[0]
    turns = about(point, np.linspace(0, 2 * np.pi, SPINS, endpoint=False)[:, None] * axis)
    return np.asarray((turns[:, None] @ symmetries.rotations).reshape(-1, 4, 4))


def mssd(model: hs.ObjectModel, T_true: Array, T: Array) -> float:
    """Returns the largest distance of a surface point from where it is, modulo symmetry [diameters]."""
    points = hull(model)
    off = se3.apply(_truths(model, T_true, T), points) - se3.apply(T, points)
    return float(np.linalg.norm(off, axis=2).max(axis=1).min() / model.diameter)


def mspd(model: hs.ObjectModel, camera: Camera, T_true: Array, T: Array) -> float:
    """Returns the largest distance of a surface point in the image, modulo symmetry [pixels of one 640 wide]."""
    more = np.random.default_rng(0).permutation(len(model.vertices))[:VERTICES]
    points = np.concatenate([hull(model), model.vertices[more]])
    truths = _truths(model, T_true, T)
    at = se3.apply(truths, points).reshape(-1, 3)
    off = _pixels(camera, at).reshape(len(truths), -1, 2) - _pixels(camera, se3.apply(T, points))
    return float(np.linalg.norm(off, axis=2).max(axis=1).min() * IMAGE_WIDTH / camera.size[0])


def _pixels(camera: Camera, points: Array) -> Array:
    """Returns columns and rows (n, 2) of points (n, 3) of a pinhole, also beyond the image; far off behind it."""
    z = np.maximum(points[:, 2:], 1e-6)
    return np.asarray(points[:, :2] / z * camera.matrix[[0, 1], [0, 1]] + camera.matrix[:2, 2])


def _truths(model: hs.ObjectModel, T_true: Array, T: Array) -> Array:
    """Returns the true pose's equivalents (k, 4, 4); of a ball the one that is turned as T is."""
    if not model.symmetries.round:
        return np.asarray(T_true @ equivalents(model.symmetries))
    center = model.symmetries.axes[0][0]
    R = T[:3, :3]
    return se3.compose(R, se3.apply(T_true, center[None])[0] - R @ center)[None]
