"""How far a point is from the surface: handsight's field against closest-point searches on the mesh, in batch.

A can's mesh of about 16 000 triangles, queries within 20 mm of it. The field answers signed distance, gradient and
curvature; the others the closest point (Open3D's signed distance is listed too). The field rounds rims off, so its
error there is stated beside its time, as is that of a tree of surface samples. Truth is the cylinder itself.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import handsight as hs
from benchmarks import timing
from benchmarks.shapes import can
from benchmarks.workload import models

TRIANGLES = 14_000
REACH = 0.02
RIM = 0.004
"""Queries whose foot is this near to a rim count as rim [m]."""
SAMPLES = 200_000
Row = dict[str, Any]
Batch = tuple[Callable[[], Any], Callable[[Any], np.ndarray]]
"""A call on all queries, and how to read unsigned distances [m] out of its answer."""


def run(queries: int, seconds: float) -> tuple[list[Row], dict[str, Any], dict[str, str]]:
    """Returns rows, ratios of time per query (field / peer), and the missing peers with the reason."""
    vertices, faces = can(TRIANGLES, 0.033, 0.115)
    model = hs.ObjectModel.from_mesh(vertices, faces)
    points, truth, at_rim = drawn(queries)
    batches, missing = gathered(model, vertices, faces, points)
    trimesh_batch = batches.pop("trimesh closest_point", None)
    times = timing.in_turn([(name, call) for name, (call, _) in batches.items()], 0.8 * seconds, most=60)
    rows = [row(name, batches[name], times[name] / queries, truth, at_rim) for name in batches]
    if trimesh_batch is not None:  # minutes for as many queries: a hundredth of them
        few = max(queries // 100, 100)
        call, read = trimesh_batch(points[:few])
        took = timing.hot(call, 0.2 * seconds, least=2) / few
        rows.append(row("trimesh closest_point", (call, read), took, truth[:few], at_rim[:few]))
    mine = times["handsight field"]
    ratios = {
        f"field / {name}": timing.ratio(mine, times[name]) for name in batches if name != "handsight field"
    }
    return rows, ratios, missing


def drawn(queries: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns points (n, 3) near the can, their true unsigned distance, and which are near a rim."""
    exact = models()["can"]
    rng = np.random.default_rng(0)
    surface, normals = exact.sample(queries, seed=3)
    points = surface + rng.uniform(-0.25 * REACH, REACH, (queries, 1)) * normals
    points += 0.25 * REACH * rng.normal(size=points.shape)
    values = exact.fine.evaluate(points)
    foot = points - values.distance[:, None] * values.gradient
    to_rim = np.hypot(np.hypot(foot[:, 0], foot[:, 1]) - 0.033, np.abs(foot[:, 2]) - 0.0575)
    return points, np.abs(values.distance), to_rim < RIM


def gathered(
    model: hs.ObjectModel, vertices: np.ndarray, faces: np.ndarray, points: np.ndarray
) -> tuple[dict[str, Any], dict[str, str]]:
    """Returns the calls by name, with trees and scenes built, and the missing peers."""
    surface, normals = model.sample(SAMPLES)
    tree = cKDTree(surface)
    batches: dict[str, Any] = {
        "handsight field": (lambda: model.evaluate(points), lambda found: np.abs(found.distance)),
        "handsight smooth field": (
            lambda: model.evaluate(points, fine=False),
            lambda found: np.abs(found.distance),
        ),
        "scipy cKDTree of samples, 2 cores": (
            lambda: tree.query(points, workers=2),
            lambda found: np.abs(((points - surface[found[1]]) * normals[found[1]]).sum(axis=1)),
        ),
    }
    missing = {}
    try:
        batches |= open3d_batches(vertices, faces, points)
    except ImportError as error:
        missing["Open3D RaycastingScene"] = f"not installed ({error}); pip install 'handsight[bench]'"
    try:
        batches["trimesh closest_point"] = trimesh_batches(vertices, faces)
    except ImportError as error:
        missing["trimesh closest_point"] = f"not installed ({error}); pip install rtree"
    return batches, missing


def open3d_batches(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> dict[str, Batch]:
    """Returns calls for Open3D's closest points and signed distances (float32, all cores)."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    queries = o3d.core.Tensor(points.astype(np.float32))

    def length(found: Any) -> np.ndarray:
        return np.linalg.norm(found["points"].numpy() - points, axis=1)

    return {
        "Open3D closest points": (lambda: scene.compute_closest_points(queries), length),
        "Open3D signed distance": (
            lambda: scene.compute_signed_distance(queries),
            lambda found: np.abs(found.numpy()),
        ),
    }


def trimesh_batches(vertices: np.ndarray, faces: np.ndarray) -> Callable[[np.ndarray], Batch]:
    """Returns a call for trimesh's closest points of a batch."""
    import rtree  # noqa: F401 - trimesh finds out only when asked
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return lambda points: (lambda: trimesh.proximity.closest_point(mesh, points), lambda found: found[1])


def row(name: str, batch: Batch, per_query: np.ndarray, truth: np.ndarray, at_rim: np.ndarray) -> Row:
    """Returns the time per query, and the error on faces and at rims: median and 95 % quantile [mm]."""
    call, read = batch
    error = 1e3 * np.abs(read(call()) - truth)
    return {
        "name": name,
        "curvature": name.startswith("handsight"),
        "face_error_mm": float(np.median(error[~at_rim])),
        "rim_error_mm": float(np.median(error[at_rim])),
        "rim_error_95_mm": float(np.quantile(error[at_rim], 0.95)),
        "queries": len(truth),
    } | timing.summary(per_query)
