"""Geometries of meshes, clouds and files: from the cache, or read, repaired and measured."""

import dataclasses
import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.objects import cache
from handsight.objects.files.read import content, shape_of
from handsight.objects.geometry import Geometry
from handsight.objects.surface import Triangles

# What brings scipy is imported where it is needed: an object from the cache does without.


def of_mesh(vertices: ArrayLike, faces: ArrayLike) -> Geometry:
    """The geometry of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject."""
    mesh = _checked_mesh(vertices, faces)
    return cache.remembered(cache.key("mesh", mesh.vertices, mesh.faces), lambda: _of_mesh(mesh))


def of_points(points: ArrayLike, normals: ArrayLike | None) -> Geometry:
    """The geometry of surface points (n, 3) [m], normals outward or None; InvalidInput, InvalidObject."""
    places, directions = _checked_points(points, normals)
    name = cache.key("cloud", places, np.empty((0, 3)) if directions is None else directions)
    return cache.remembered(name, lambda: _of_points(places, directions))


def of_file(path: str | os.PathLike[str], scale: float) -> Geometry:
    """The geometry of the mesh or cloud in a file whose unit is `scale` metres; raises InvalidFile, InvalidObject."""
    file, data = Path(path), content(path)
    # By name as well: remarks begin with it, and its end says what the bytes mean.
    name = cache.key(f"file {scale!r} {file.name}", np.frombuffer(data, dtype=np.uint8))
    return cache.remembered(name, lambda: _of_file(file, data, scale))


def _of_mesh(mesh: Triangles) -> Geometry:
    from handsight.objects.meshes.mesh_geometry import mesh_geometry

    return mesh_geometry(mesh)


def _of_points(points: Array, normals: Array | None) -> Geometry:
    from handsight.objects.cloud import cloud_geometry

    return cloud_geometry(points, normals)


def _of_file(file: Path, data: bytes, scale: float) -> Geometry:
    shape = shape_of(file, data)
    points = scale * shape.vertices
    try:
        if shape.faces is None:
            geometry = _of_points(*_checked_points(points, shape.normals))
        else:
            geometry = _of_mesh(_checked_mesh(points, shape.faces))
    except InvalidObject as error:
        raise InvalidObject(f"{file.name}: {error}") from None
    remarks = tuple(f"{file.name}: {remark}" for remark in (*shape.remarks, *geometry.remarks))
    return dataclasses.replace(geometry, remarks=remarks)


def _checked_points(points: ArrayLike, normals: ArrayLike | None) -> tuple[Array, Array | None]:
    places = checks.finite(points, "points", (None, 3))
    return places, None if normals is None else checks.unit(normals, "normals", (len(places), 3))


def _checked_mesh(vertices: ArrayLike, faces: ArrayLike) -> Triangles:
    """The mesh of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject where these are none."""
    try:
        points, triangles = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    except (TypeError, ValueError):
        raise InvalidObject("mesh: expected numbers for vertices (k, 3) and faces (m, 3)") from None
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InvalidObject(f"vertices: expected shape (k, 3) with k ≥ 3, got {points.shape}")
    if triangles.size == 0:
        raise InvalidObject("faces: expected at least one triangle, got none")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
        raise InvalidObject(
            f"faces: expected whole numbers of shape (m, 3), got {triangles.dtype} {triangles.shape}"
        )
    if triangles.min() < 0 or triangles.max() >= len(points):
        raise InvalidObject(
            f"faces: expected indices 0 to {len(points) - 1}, got {triangles.min()} to {triangles.max()}"
        )
    return Triangles(points, triangles.astype(np.int64))
