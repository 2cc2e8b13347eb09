"""Ten YCB objects, and data that others have recorded of them.

The data are not part of handsight. Without them an experiment prints one line and succeeds.
"""

import functools
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import handsight as hs
from handsight import se3
from handsight.objects import ObjectWarning, propose_symmetries
from testbed import report, scenes
from testbed.report import Array

ESTIMATORS = {
    "CosyPose": "cosypose",
    "PoseCNN": "posecnn_rss2018",
    "AAE": "sundermeyer",
    "PoseCNN+ICP": "posecnn_icp_rss2018",
}
"""Folders of estimators' poses by their label."""
QUERIES, SURFACE = 1000, 20_000
"""How many points of the object are compared with the surface, and how many samples represent the surface."""


def data_folder() -> Path | None:
    """Returns $HANDSIGHT_DATA, else `shared/data` beside the checkout; None where there are no YCB meshes in it."""
    named = os.environ.get("HANDSIGHT_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    return folder if (folder / "ycb_meshes").is_dir() else None


def data_or_goodbye() -> Path:
    """Returns `data_folder`; without data it prints why, and ends the program with exit code 0."""
    folder = data_folder()
    if folder is None:
        named = os.environ.get("HANDSIGHT_DATA")
        why = f"HANDSIGHT_DATA={named} has no ycb_meshes" if named else "set HANDSIGHT_DATA to their folder"
        print(f"skipped: the YCB data that this experiment reads are not here ({why}).")
        sys.exit(0)
    return folder


@dataclass(frozen=True)
class YcbObject:
    """An object's model with symmetries, and its surface to judge poses by."""

    model: hs.ObjectModel
    queries_object: Array
    """(QUERIES, 3) [m]."""
    tree: cKDTree
    """Search tree of `SURFACE` points of the surface."""
    normals: Array
    """(SURFACE, 3) of these points."""
    gap: float
    """Upper bound of the distance between neighbouring points [m]."""

    def closest_point_error(self, T_hat: Array, T_true: Array) -> float:
        """Returns ADD-S, or ADI [m]: the mean distance of the points at one pose from the surface at the other.

        The distance is to the plane of the nearest sample; else the samples' spacing would count as an error of
        millimetres where a can turns about its own axis.
        """
        moved = se3.apply(se3.inverse(T_true) @ T_hat, self.queries_object)
        distance, nearest = self.tree.query(moved)
        height = ((moved - self.tree.data[nearest]) * self.normals[nearest]).sum(axis=1)
        lateral = np.sqrt(np.maximum(distance**2 - height**2, 0.0))
        return float(np.hypot(height, np.maximum(lateral - self.gap, 0.0)).mean())

    def turn(self, T_hat: Array, T_true: Array) -> float:
        """Returns the angle [rad] between two poses, modulo the object's symmetries."""
        nearest = scenes.nearest_truth(self.model, T_true, T_hat)
        return float(np.linalg.norm(se3.rotation_log(T_hat[:3, :3] @ nearest[:3, :3].T)))


@functools.cache
def load(folder: Path, name: str) -> YcbObject:
    """Returns the object of that name, with the symmetries of its shape."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ObjectWarning)  # the marker's mesh has triangles without area
        model = hs.ObjectModel.from_file(folder / "ycb_meshes" / f"{name}.ply")
    model = model.with_symmetries(propose_symmetries(model))
    points, normals = model.sample(SURFACE, seed=2)
    gap = 2 * float(np.sqrt(model.area / SURFACE))
    return YcbObject(model, model.sample(QUERIES, seed=1)[0], cKDTree(points), normals, gap)


def area_under_curve(errors: Any, limit: float) -> float:
    """Returns the AUC [%]: the share of errors below a threshold, averaged over thresholds from 0 to `limit`."""
    return 100 * float(np.clip(1 - np.asarray(errors) / limit, 0, 1).mean())


def surface_samples(folder: Path, name: str) -> scenes.Surface:
    """Returns about 2000 points and outward normals of the object's surface in its own frame, sampled by others."""
    rows = np.loadtxt(folder / "surface_samples" / f"{name}_2000.off", skiprows=2)
    return rows[:, :3], rows[:, 3:6] / np.linalg.norm(rows[:, 3:6], axis=1, keepdims=True)


def read_poses(path: Path) -> tuple[Array, Array]:
    """Returns the poses `T_camera_object` (n, 4, 4) of a file, and which of them were detected at all, (n,)."""
    rows = np.loadtxt(path, ndmin=2)
    detected = np.abs(rows[:, :4]).sum(axis=1) > 0
    quaternions_xyzw = np.where(detected[:, None], rows[:, [1, 2, 3, 0]], [0.0, 0.0, 0.0, 1.0])
    return se3.compose(se3.rotation_from_quaternion(quaternions_xyzw), rows[:, 4:7]), detected


def triplets(folder: Path) -> list[tuple[str, int, Array, Array]]:
    """Returns the three-finger problems: (object, number, points (3, 3), outward normals (3, 3)), all at one pose."""
    found = []
    for path in sorted((folder / "tactile_triplets").glob("*/triplet_*/poses_sensors.txt")):
        rows = np.loadtxt(path)
        R = se3.rotation_exp(rows[:, 3:6] * rows[:, 6:])
        points = rows[:, :3] + R @ np.array([0.02, 0.0, 0.015])
        found.append((path.parts[-3], int(path.parts[-2].split("_")[1]), points, -R[:, :, 0]))
    return found


TRIPLET_TRUTH = se3.compose(np.eye(3), np.array([0.1, 0.0, 0.2]))
"""`T_world_object` of every triplet."""


def in_parallel(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], what: str) -> list[Any]:
    """Returns the results of the tasks in order, computed by a process per core, with a progress bar on stderr."""
    # One thread each: the arrays are small, and the processes would compete for the cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    workers = min(os.cpu_count() or 1, len(tasks))
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(function, *task) for task in tasks]
        return [future.result() for future in report.progress(futures, what)]
