"""Shapes read from files: meshes from STL, OBJ, PLY and OFF, clouds from PLY, OFF, PCD and XYZ.

Only the named file is opened: no material, texture or other path inside it is followed.
"""

import io
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from handsight.checks import Array, Indices
from handsight.errors import InvalidFile
from handsight.files import read_bytes
from handsight.objects.files.pcd import pcd_columns
from handsight.objects.files.text import BadText, number_rows, off_shape

LARGEST_FILE = 500_000_000
"""Bytes; more is refused."""
_UNREADABLE = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, struct.error,
    EOFError, MemoryError, RuntimeError, StopIteration, ImportError,
)  # fmt: skip
"""What parsers raise on content that is not what it should be."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """What a file holds, in the file's own unit."""

    vertices: Array
    """(k, 3)"""
    faces: Indices | None = None
    """(m, 3); None: a cloud."""
    normals: Array | None = None
    """(k, 3) of a cloud, of any length; None: not in the file."""
    remarks: tuple[str, ...] = ()


def read_shape(path: str | os.PathLike[str]) -> Shape:
    """The mesh or cloud in a file, by its extension; raises InvalidFile starting with the file's name."""
    return shape_of(Path(path), content(path))


def shape_of(file: Path, data: bytes) -> Shape:
    """The mesh or cloud in the content of a file so called; raises InvalidFile."""
    try:
        shape = READERS[file.suffix.lower()](data)
    except BadText as error:
        raise InvalidFile(f"{file.name}: {error}") from None
    except _UNREADABLE as error:
        detail = f"{type(error).__name__}: {error}".split("\n")[0][:120]
        raise InvalidFile(f"{file.name}: not a readable {file.suffix[1:].upper()} file ({detail})") from error
    if not len(shape.vertices):
        raise InvalidFile(f"{file.name}: expected points or triangles, got none")
    return shape if shape.faces is not None else _finite_rows(shape)


def content(path: str | os.PathLike[str]) -> bytes:
    """What is in a regular file of a known kind and sensible size; raises InvalidFile."""
    file = Path(path)
    if file.suffix.lower() not in READERS:
        known = ", ".join(sorted(READERS))
        raise InvalidFile(f"{file.name}: expected one of {known}, got {file.suffix or 'no extension'}")
    data = read_bytes(file, LARGEST_FILE, file.name)
    if not data:
        raise InvalidFile(f"{file.name}: the file is empty")
    return data


def _finite_rows(shape: Shape) -> Shape:
    """A cloud without its missing points: sensors write those as NaN."""
    good = np.isfinite(shape.vertices).all(axis=1)
    if shape.normals is not None:
        good &= np.isfinite(shape.normals).all(axis=1) & (shape.normals != 0).any(axis=1)
    if good.all():
        return shape
    remark = f"{int((~good).sum())} points that are not finite, or have no normal, were dropped"
    normals = None if shape.normals is None else shape.normals[good]
    return Shape(shape.vertices[good], None, normals, (*shape.remarks, remark))


def _by_trimesh(data: bytes, kind: str) -> Shape:
    import trimesh  # long to import, and not needed for an object from the cache

    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, skip_materials=True)
    vertices, faces, start = [], [], 0
    for part in scene.geometry.values():
        points = np.asarray(part.vertices, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise BadText(f"expected 3 coordinates a point, got shape {points.shape}")
        vertices.append(points)
        faces.append(np.asarray(getattr(part, "faces", ()), dtype=np.int64).reshape(-1, 3) + start)
        start += len(points)
    if not any(map(len, faces)):
        raise BadText("expected triangles, got none")
    return Shape(np.concatenate(vertices), np.concatenate(faces))


def _stl(data: bytes) -> Shape:
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if not (count and len(data) >= 84 + 50 * count):
        if not data.lstrip()[:5].lower() == b"solid":
            raise BadText(
                f"expected {84 + 50 * count} bytes of binary STL, got {len(data)}: is it cut short?"
            )
        if b"endsolid" not in data[-4096:].lower():
            raise BadText("expected 'endsolid' at the end: is it cut short?")
        data = _plain(data)
    return _by_trimesh(data, "stl")


def _obj(data: bytes) -> Shape:
    return _by_trimesh(_plain(data), "obj")


def _plain(data: bytes) -> bytes:
    """Text whose comments may be in any encoding, as UTF-8."""
    return data.decode("latin-1").encode("utf-8")


def _ply(data: bytes) -> Shape:
    import trimesh  # as above

    geometry = trimesh.load(io.BytesIO(data), file_type="ply", process=False, skip_materials=True)
    elements: dict[str, Any] = geometry.metadata.get("_ply_raw", {})
    vertex = elements.get("vertex", {}).get("data")
    if vertex is None:
        raise BadText("expected an element 'vertex', got none")
    for name, element in elements.items():
        found = _rows(element.get("data"))
        if name in ("vertex", "face") and found != element["length"]:
            raise BadText(f"expected {element['length']} rows of '{name}', got {found}: is it cut short?")
    columns = _columns(vertex, ("x", "y", "z"))
    if columns is None:
        raise BadText("expected the vertex properties x, y, z")
    faces = getattr(geometry, "faces", None)
    if faces is not None and len(faces):
        return Shape(columns, np.asarray(faces, dtype=np.int64))
    return Shape(columns, None, _columns(vertex, ("nx", "ny", "nz")))


def _rows(data: Any) -> int:
    """How many rows a PLY element came with: trimesh keeps a dict of columns or a structured array."""
    if isinstance(data, dict):
        data = next(iter(data.values()), None)
    return 0 if data is None else len(data)


def _columns(table: Any, names: tuple[str, ...]) -> Array | None:
    """(k, 3) of the named columns, or None where one is missing."""
    have = table.keys() if isinstance(table, dict) else (table.dtype.names or ())
    if not all(name in have for name in names):
        return None
    return np.stack([np.asarray(table[name], dtype=np.float64).reshape(-1) for name in names], axis=1)


def _off(data: bytes) -> Shape:
    vertices, normals, faces = off_shape(data)
    return Shape(vertices, faces if len(faces) else None, normals)


def _pcd(data: bytes) -> Shape:
    columns = pcd_columns(data)
    points = _columns(columns, ("x", "y", "z"))
    if points is None:
        raise BadText(f"expected the fields x y z, got {' '.join(columns)}")
    return Shape(points, None, _columns(columns, ("normal_x", "normal_y", "normal_z")))


def _xyz(data: bytes) -> Shape:
    rows = number_rows(data)
    if rows.shape[1] not in (3, 6):
        raise BadText(f"expected 3 or 6 columns, got {rows.shape[1]}")
    return Shape(rows[:, :3], None, rows[:, 3:] if rows.shape[1] == 6 else None)


READERS: dict[str, Callable[[bytes], Shape]] = {
    ".stl": _stl, ".obj": _obj, ".ply": _ply, ".off": _off, ".pcd": _pcd, ".xyz": _xyz,
}  # fmt: skip
"""Extension to reader; a new format is a new entry."""
