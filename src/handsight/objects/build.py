"""Objects from meshes, clouds and files: read, repaired, their fields built or remembered."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidObject
from handsight.objects import cache
from handsight.objects.cloud import cloud_fields, cloud_from
from handsight.objects.fields.field import GridField
from handsight.objects.fields.grids import Fields
from handsight.objects.files.read import shape_of
from handsight.objects.geometry import Made, diameter
from handsight.objects.meshes.mesh_fields import mesh_fields
from handsight.objects.meshes.repair import repaired
from handsight.objects.meshes.triangles import Faces, Surface

_KEPT = {"coarse", "coarse_grid", "fine", "fine_grid", "closed", "remarks"}


def made_of_mesh(vertices: ArrayLike, faces: ArrayLike, *, keep: bool = True) -> Made:
    """The object of `vertices` (k, 3) [m] and `faces` (m, 3); raises InvalidObject.

    `keep`: whether its fields are looked for on disk and put there.
    """
    mesh, parts, remarks = repaired(vertices, faces)
    size = diameter(mesh.vertices)

    def build() -> Fields:
        return mesh_fields(mesh, size, parts)

    fields = _remembered("mesh", build, mesh.vertices, mesh.faces) if keep else build()
    return dataclasses.replace(_made(mesh, mesh.vertices, mesh.faces, fields, remarks), diameter=size)


def made_of_points(points: ArrayLike, normals: ArrayLike | None, *, keep: bool = True) -> Made:
    """The object of surface points (n, 3) [m], normals outward or None; InvalidInput, InvalidObject.

    `keep`: as of a mesh.
    """
    array = checks.finite(points, "points", (None, 3))
    directions = None
    if normals is not None:
        directions = checks.unit(normals, "normals", (len(array), 3))
    cloud, remarks = cloud_from(array, directions)
    size = diameter(cloud.points)

    def build() -> Fields:
        return cloud_fields(cloud, size)

    fields = _remembered("cloud", build, cloud.points, cloud.normals) if keep else build()
    made = _made(cloud, cloud.points, np.empty((0, 3), dtype=np.int64), fields, remarks)
    return dataclasses.replace(made, diameter=size)


def made_of_file(file: Path, data: bytes, scale: float) -> Made:
    """The object in the content of a file whose unit is `scale` metres; raises InvalidFile and InvalidObject.

    Nothing of it is kept on disk: who asks keeps the whole.
    """
    shape = shape_of(file, data)
    try:
        if shape.faces is None:
            made = made_of_points(scale * shape.vertices, shape.normals, keep=False)
        else:
            made = made_of_mesh(scale * shape.vertices, shape.faces, keep=False)
    except InvalidObject as error:
        raise InvalidObject(f"{file.name}: {error}") from None
    remarks = tuple(f"{file.name}: {remark}" for remark in (*shape.remarks, *made.remarks))
    return dataclasses.replace(made, name=file.stem, remarks=remarks)


def _made(surface: Surface, vertices: Array, faces: Faces, fields: Fields, remarks: tuple[str, ...]) -> Made:
    return Made(
        "",
        surface,
        vertices,
        faces,
        fields.fine,
        coarse=fields.coarse,
        closed=fields.closed,
        remarks=(*remarks, *fields.remarks),
    )


def _remembered(kind: str, build: Callable[[], Fields], points: Array, second: NDArray[Any]) -> Fields:
    """The fields from the cache, or built and put there."""

    def arrays() -> cache.Arrays:
        """What is kept of the fields."""
        fields = build()
        return {
            "coarse": fields.coarse.values,
            "coarse_grid": np.append(fields.coarse.origin, fields.coarse.cell),
            "fine": fields.fine.values,
            "fine_grid": np.append(fields.fine.origin, fields.fine.cell),
            "closed": np.array(fields.closed),
            "remarks": np.array(fields.remarks, dtype=np.str_),
        }

    kept = cache.remembered(cache.key(kind, "", points, second), _KEPT, arrays)
    coarse, fine = (
        GridField(kept[f"{k}_grid"][:3], float(kept[f"{k}_grid"][3]), kept[k]) for k in ("coarse", "fine")
    )
    return Fields(coarse, fine, bool(kept["closed"]), tuple(str(remark) for remark in kept["remarks"]))
