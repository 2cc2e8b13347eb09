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
from handsight.objects.fields.grids import Fields
from handsight.objects.files.read import content, shape_of
from handsight.objects.geometry import Geometry, measured
from handsight.objects.meshes.triangles import Triangles, checked
from handsight.objects.surface import Surface

# What brings scipy is imported where it is needed: an object from the cache does without.


def of_mesh(vertices: ArrayLike, faces: ArrayLike) -> Geometry:
    """The geometry of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject."""
    mesh = checked(vertices, faces)
    name = cache.key("mesh", mesh.vertices, mesh.faces)
    return cache.remembered(name, lambda: measured(*_of_mesh(mesh)))


def of_points(points: ArrayLike, normals: ArrayLike | None) -> Geometry:
    """The geometry of surface points (n, 3) [m], normals outward or None; InvalidInput, InvalidObject."""
    places, directions = _checked_points(points, normals)
    name = cache.key("cloud", places, np.empty((0, 3)) if directions is None else directions)
    return cache.remembered(name, lambda: measured(*_of_points(places, directions)))


def of_file(path: str | os.PathLike[str], scale: float) -> Geometry:
    """The geometry of the mesh or cloud in a file whose unit is `scale` metres; raises InvalidFile, InvalidObject."""
    file, data = Path(path), content(path)
    # By name as well: remarks begin with it, and its end says what the bytes mean.
    name = cache.key(f"file {scale!r} {file.name}", np.frombuffer(data, dtype=np.uint8))
    return cache.remembered(name, lambda: _of_file(file, data, scale))


def _of_mesh(mesh: Triangles) -> tuple[Surface, Fields]:
    from handsight.objects.meshes.mesh_fields import mesh_fields
    from handsight.objects.meshes.repair import repaired

    mesh, tree, remarks = repaired(mesh)
    fields = mesh_fields(mesh, tree)
    return mesh, dataclasses.replace(fields, remarks=(*remarks, *fields.remarks))


def _checked_points(points: ArrayLike, normals: ArrayLike | None) -> tuple[Array, Array | None]:
    places = checks.finite(points, "points", (None, 3))
    return places, None if normals is None else checks.unit(normals, "normals", (len(places), 3))


def _of_points(points: Array, normals: Array | None) -> tuple[Surface, Fields]:
    from handsight.objects.cloud import cloud_fields, cloud_from

    cloud, remarks = cloud_from(points, normals)
    fields = cloud_fields(cloud)
    return cloud, dataclasses.replace(fields, remarks=(*remarks, *fields.remarks))


def _of_file(file: Path, data: bytes, scale: float) -> Geometry:
    shape = shape_of(file, data)
    points = scale * shape.vertices
    try:
        if shape.faces is None:
            surface, fields = _of_points(*_checked_points(points, shape.normals))
        else:
            surface, fields = _of_mesh(checked(points, shape.faces))
    except InvalidObject as error:
        raise InvalidObject(f"{file.name}: {error}") from None
    remarks = tuple(f"{file.name}: {remark}" for remark in (*shape.remarks, *fields.remarks))
    return measured(surface, dataclasses.replace(fields, remarks=remarks))
