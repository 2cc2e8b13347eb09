"""How far a point is from the surface: handsight's field against a tree of samples, in batch.

A can's mesh, queries within 20 mm of it. The field has signed distance, gradient and curvature. It rounds rims off, so
its error there is stated beside its time, as is the tree's. Truth is the cylinder itself.
"""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import handsight as hs
from benchmarks import timing
from benchmarks.shapes import can
from benchmarks.workload import models

REACH = 0.02
RIM = 0.004
"""Queries whose foot is this near to a rim count as rim [m]."""
SAMPLES = 200_000
TREE = "scipy cKDTree of samples, 2 cores"
Row = dict[str, Any]


def run(queries: int, seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """Returns rows, and ratios of time per query (field / peer)."""
    model = hs.ObjectModel.from_mesh(*can(0.033, 0.115))
    points, truth, at_rim = drawn(queries)
    surface, normals = model.sample(SAMPLES)
    tree = cKDTree(surface)
    times = timing.in_turn(
        [("handsight field", lambda: model.evaluate(points)), (TREE, lambda: tree.query(points, workers=2))],
        seconds,
        most=60,
    )
    nearest = tree.query(points)[1]
    found = {
        "handsight field": model.evaluate(points).distance,
        TREE: ((points - surface[nearest]) * normals[nearest]).sum(axis=1),
    }
    rows = []
    for name, distances in found.items():
        error = 1e3 * np.abs(np.abs(distances) - truth)
        row: Row = {"name": name, "queries": queries, "face_error_mm": float(np.median(error[~at_rim]))}
        row |= {"rim_error_mm": float(np.median(error[at_rim]))}
        rows.append(row | timing.summary(times[name] / queries))
    return rows, {f"field / {TREE}": timing.ratio(times["handsight field"], times[TREE])}


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
