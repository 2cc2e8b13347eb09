"""Shapes read from files: meshes from STL, OBJ, PLY and OFF, clouds from PLY, OFF, PCD and XYZ.

Only the named file is opened: no material, texture or other path inside it is followed.
"""

import codecs
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array, Indices
from handsight.errors import InvalidFile
from handsight.files import read_bytes
from handsight.objects.files.pcd import pcd_columns
from handsight.objects.files.ply import ply_shape, ply_sigmas
from handsight.objects.files.text import BadText, number_rows, obj_shape, off_shape, stl_shape

LARGEST_FILE = 500_000_000
"""Bytes; more is refused."""
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A `Shape` is what a file holds, in the file's own unit."""

    vertices: Array
    """(k, 3)"""
    faces: Indices | None = None
    """(m, 3); None: a cloud."""
    normals: Array | None = None
    """(k, 3) of a cloud, of any length; None: not in the file."""
    remarks: tuple[str, ...] = ()
    sigmas: Array | None = None
    """(k,) how far a cloud's points may be off, together with their neighbours; None: the file does not say."""


def read_shape(path: str | os.PathLike[str]) -> Shape:
    """Returns the mesh or cloud in a file, by its extension; raises InvalidFile starting with the file's name."""
    return shape_of(Path(path), content(path))


def shape_of(file: Path, data: bytes) -> Shape:
    """Returns the mesh or cloud in the content of a file so called; raises InvalidFile."""
    try:
        shape = READERS[file.suffix.lower()](data)
    except BadText as error:
        raise InvalidFile(f"{file.name}: {error}") from None
    except MemoryError:
        raise InvalidFile(f"{file.name}: expected a shape that memory holds, got one beyond it") from None
    if not len(shape.vertices):
        raise InvalidFile(f"{file.name}: expected points or triangles, got none")
    return shape if shape.faces is not None else _finite_rows(shape)


def content(path: str | os.PathLike[str]) -> bytes:
    """Returns what is in a regular file of a known kind and sensible size; raises InvalidFile."""
    file = Path(path)
    if file.suffix.lower() not in READERS:
        known = ", ".join(sorted(READERS))
        raise InvalidFile(f"{file.name}: expected one of {known}, got {file.suffix or 'no extension'}")
    data = read_bytes(file, LARGEST_FILE, file.name)
    if not data:
        raise InvalidFile(f"{file.name}: the file is empty")
    return data


def _finite_rows(shape: Shape) -> Shape:
    """Returns a cloud without its missing points: sensors write those as NaN."""
    good = np.isfinite(shape.vertices).all(axis=1)
    if shape.normals is not None:
        good &= np.isfinite(shape.normals).all(axis=1) & (shape.normals != 0).any(axis=1)
    if shape.sigmas is not None:
        good &= np.isfinite(shape.sigmas) & (shape.sigmas >= 0)
    if good.all():
        return shape
    remark = f"{int((~good).sum())} points that are not finite, or have no normal, were dropped"
    normals = None if shape.normals is None else shape.normals[good]
    sigmas = None if shape.sigmas is None else shape.sigmas[good]
    return Shape(shape.vertices[good], None, normals, (*shape.remarks, remark), sigmas)


def _stl(data: bytes) -> Shape:
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if count and len(data) >= 84 + 50 * count:
        corners = np.frombuffer(data, _STL_TRIANGLE, count, offset=84)["corners"]
        return Shape(corners.reshape(-1, 3).astype(np.float64), np.arange(3 * count).reshape(-1, 3))
    if not data.removeprefix(codecs.BOM_UTF8).lstrip()[:5].lower() == b"solid":
        raise BadText(f"expected {84 + 50 * count} bytes of binary STL, got {len(data)}: is it cut short?")
    if b"endsolid" not in data[-4096:].lower():
        raise BadText("expected 'endsolid' at the end: is it cut short?")
    return Shape(*stl_shape(data))


def _ply(data: bytes) -> Shape:
    vertices, normals, faces = ply_shape(data)
    return Shape(vertices, faces, normals, sigmas=ply_sigmas(data))


def _off(data: bytes) -> Shape:
    vertices, normals, faces = off_shape(data)
    return Shape(vertices, faces if len(faces) else None, normals)


def _pcd(data: bytes) -> Shape:
    columns = pcd_columns(data)
    points = _three(columns, ("x", "y", "z"))
    if points is None:
        raise BadText(f"expected the fields x y z, got {' '.join(columns)}")
    return Shape(points, None, _three(columns, ("normal_x", "normal_y", "normal_z")))


def _three(columns: dict[str, NDArray[np.generic]], names: tuple[str, str, str]) -> Array | None:
    """Returns (k, 3) of the columns so named, or None where one is missing."""
    if not all(name in columns for name in names):
        return None
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def _xyz(data: bytes) -> Shape:
    rows = number_rows(data)
    return Shape(rows[:, :3], None, rows[:, 3:] if rows.shape[1] == 6 else None)


READERS: dict[str, Callable[[bytes], Shape]] = {
    ".stl": _stl, ".obj": lambda data: Shape(*obj_shape(data)), ".ply": _ply, ".off": _off, ".pcd": _pcd, ".xyz": _xyz,
}  # fmt: skip
"""Extension to reader; a new format is a new entry."""
