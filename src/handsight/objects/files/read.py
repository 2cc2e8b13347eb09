"""Shapes read from files: meshes from STL, OBJ, PLY, OFF, GLB, DAE and 3MF, point clouds from PLY, OFF and XYZ.

trimesh reads the bytes of the named file and opens no other: no material, texture or other path inside it is followed.
It takes what is there of a file that was cut, so the triangles that a file states are compared with those that were
read. Nodes' transforms are applied; GLB, DAE and 3MF state their unit, and come in metres.
"""

import codecs
import io
import itertools
import json
import os
import re
import warnings
import zipfile
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn
from xml.parsers import expat

import numpy as np

from handsight.checks import Array
from handsight.errors import InvalidFile, MissingExtra, needing
from handsight.files import read_bytes
from handsight.objects.files.shape import Shape

if TYPE_CHECKING:
    from trimesh import Scene

LARGEST_FILE = 500_000_000  # the largest number of bytes that a file may have
MOST_TRIANGLES = 20_000_000
"""A scene may show one mesh many times, so that a small file could ask for any amount of memory."""


def read_shape(path: str | os.PathLike[str]) -> Shape:
    """Returns the mesh or cloud in a file, by its extension.

    Raises InvalidFile starting with the file's name, MissingExtra for a format that needs one.
    """
    return shape_of(Path(path), content(path))


def content(path: str | os.PathLike[str]) -> bytes:
    """Returns the bytes of a regular file with a known extension and a sensible size; raises InvalidFile."""
    file = Path(path)
    if file.suffix.lower() not in READERS:
        known = ", ".join(sorted(READERS))
        raise InvalidFile(f"{file.name}: expected one of {known}, got {file.suffix or 'no extension'}")
    data = read_bytes(file, LARGEST_FILE, file.name)
    if not data:
        raise InvalidFile(f"{file.name}: the file is empty")
    return data


def shape_of(file: Path, data: bytes) -> Shape:
    """Returns the mesh or cloud in the content of a file with this name; raises as `read_shape`.

    Points of a cloud that are not finite, as sensors write missing ones, or whose normal is not valid, are left out,
    and a remark says how many.
    """
    kind = file.suffix.lower()
    try:
        with warnings.catch_warnings():
            # NumPy warns of words that are no numbers, and returns the numbers before them.
            warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
            shape = READERS[kind](data.removeprefix(codecs.BOM_UTF8))
    except MissingExtra as error:
        raise MissingExtra(f"{file.name}: {error}") from None
    except MemoryError:
        raise InvalidFile(f"{file.name}: expected a shape that fits into memory, got a larger one") from None
    except Exception as error:  # readers raise whatever they meet
        came = str(error) or type(error).__name__
        raise InvalidFile(f"{file.name}: cannot be read as {kind[1:].upper()}: {came}") from None
    if not len(shape.vertices):
        raise InvalidFile(f"{file.name}: expected points or triangles, got none: is it cut short?")
    return shape if shape.faces is not None else _valid_points(shape)


def _valid_points(cloud: Shape) -> Shape:
    """Returns a cloud without the points that are not finite or have no valid normal or sigma, with normals only where
    they can be some; remarks say what was changed."""
    normals = cloud.normals
    sigmas = cloud.sigmas
    remarks = list[str]()
    if normals is not None and (doubt := _no_normals(normals)):
        normals = None
        remarks.append(f"the columns of normals {doubt}: normals are estimated from the points")
    good = np.isfinite(cloud.vertices).all(axis=1)
    if normals is not None:
        good &= np.isfinite(normals).all(axis=1) & normals.any(axis=1)
    if sigmas is not None:
        good &= np.isfinite(sigmas) & (sigmas >= 0)
    points = cloud.vertices[good]
    sigmas = None if sigmas is None else sigmas[good]
    if not good.all():
        remarks.append(f"{(~good).sum()} points that are not finite, or have no normal, were dropped")
    if normals is not None and len(points):
        from handsight.objects.scans.normals import with_outward_signs  # brings SciPy

        normals, remark = with_outward_signs(points, normals[good])
        remarks += [remark] if remark else []
    return Shape(points, None, normals, tuple(remarks), sigmas)


def _no_normals(numbers: Array) -> str:
    """Returns why numbers (n, 3) beside points are no normals; empty where they can be some."""
    known = numbers[np.isfinite(numbers).all(axis=1)]
    lengths = np.linalg.norm(known, axis=1)
    if not lengths.any():
        return "are all 0"
    # Normals of a surface point to all sides, or are of one length; colours do neither.
    one_length = np.quantile(lengths, 0.9) < 1.1 * np.quantile(lengths, 0.1)
    if known.min() >= 0 and not one_length:
        return "are colours"
    return ""


def _scene(kind: str, data: bytes, **options: Any) -> "Scene":
    """Returns what trimesh reads from the content of a file; `options` are those of its reader."""
    import trimesh  # takes a second, which an object from the cache should not wait for

    return trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False, **options)


def _mesh(scene: "Scene", expected: int | None) -> Shape:
    """Returns all triangles of a scene, in metres where it states its unit.

    Raises ValueError where they are not as many as expected, or too many.
    """
    from trimesh.units import unit_conversion

    shown = [scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry]
    count = sum(len(getattr(each, "faces", ())) for each in shown)
    if count > MOST_TRIANGLES or (expected is not None and count != expected):
        most = MOST_TRIANGLES if expected is None else expected
        raise ValueError(f"expected {most} triangles, got {count}: is it cut short?")
    if not count:
        raise ValueError("expected triangles, got none: is it cut short?")
    mesh = scene.to_mesh()
    unit = 1.0 if scene.units is None else unit_conversion(scene.units, "meters")
    return Shape(unit * np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))


def _stl(data: bytes) -> Shape:
    """Returns the mesh in an STL file, binary or text; each triangle has three vertices of its own."""
    binary = len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    stated = None if binary else len(re.findall(rb"(?im)^\s*endfacet\b", data))
    return _mesh(_scene("stl", data), stated)


def _obj(data: bytes) -> Shape:
    """Returns the mesh in a Wavefront OBJ text.

    Only vertices and corners are handed on: materials, textures and normals would change the order of triangles, and
    trimesh counts backwards from the last vertex of the file, not from the line.
    """
    lines = list[bytes]()
    known = 0
    stated = 0
    for line in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        words = line.partition(b"#")[0].split()
        if words[:1] == [b"v"]:
            lines.append(b" ".join(words[:4]))
            known += 1
        elif words[:1] == [b"f"]:
            corners = [int(word.partition(b"/")[0]) for word in words[1:]]
            if len(corners) < 3 or min(corners) < -known or 0 in corners:
                raise ValueError(
                    f"expected three vertices or more from 1 or from -1 to -{known}, got {corners}"
                )
            forward = [corner if corner > 0 else known + 1 + corner for corner in corners]
            lines.append(b"f " + b" ".join(b"%d" % corner for corner in forward))
            stated += len(corners) - 2
    return _mesh(_scene("obj", b"\n".join(lines), maintain_order=True), stated)


def _ply(data: bytes) -> Shape:
    """Returns the mesh in a PLY file, or the cloud if the file has no faces.

    The vertex property `sigma` is the standard deviation of a cloud's points.
    """
    scene = _scene("ply", data, fix_texture=False, skip_materials=True)
    (geometry,) = scene.geometry.values()
    elements = geometry.metadata["_ply_raw"]
    for name in ("vertex", "face"):
        element = elements.get(name, {"length": 0})
        if not element["length"]:
            continue
        table = element["data"]  # a structured array, or columns by name
        read = len(next(iter(table.values()))) if isinstance(table, dict) else len(table)
        if read != element["length"]:
            raise ValueError(f"expected {element['length']} rows of {name}, got {read}: is it cut short?")
    if elements.get("face", {"length": 0})["length"]:
        return _mesh(scene, _text_triangles(data, elements))
    vertex = elements["vertex"]["data"]
    normals = None
    if {"nx", "ny", "nz"} <= elements["vertex"]["properties"].keys():
        normals = np.column_stack([vertex[name] for name in ("nx", "ny", "nz")]).astype(np.float64)
    sigmas = None
    if "sigma" in elements["vertex"]["properties"]:
        sigmas = np.asarray(vertex["sigma"], dtype=np.float64).reshape(-1)
    return Shape(np.array(geometry.vertices, dtype=np.float64), None, normals, sigmas=sigmas)


def _text_triangles(data: bytes, elements: dict[str, Any]) -> int | None:
    """Returns how many triangles the rows of a text PLY state; None for another PLY, or rows that begin otherwise."""
    (first, *_) = elements["face"]["properties"].values()
    if b"format ascii" not in data[:200] or "$LIST" not in first:
        return None
    names = list(elements)
    start = 1 + sum(elements[name]["length"] for name in names[: names.index("face")])
    rows = data.partition(b"end_header")[2].splitlines()[start : start + elements["face"]["length"]]
    return sum(int(row.split()[0]) - 2 for row in rows)


def _off(data: bytes) -> Shape:
    """Returns the mesh in an Object File Format text (OFF, NOFF, COFF, CNOFF), or the cloud if it has no faces."""
    lines = (line.partition(b"#")[0].split() for line in data.splitlines())
    rows = [words for words in lines if words]
    counts = re.match(rb"(C?)(N?)OFF\s*(\d+)\s+(\d+)", b" ".join(itertools.chain(*rows[:2])))
    if counts is None:
        raise ValueError("expected OFF, NOFF, COFF or CNOFF, and the counts of vertices and faces")
    vertices = int(counts[3])
    polygons = int(counts[4])
    rows = (
        rows[2:] if rows[0][0].isalpha() and len(rows[0]) == 1 else rows[1:]
    )  # counts may be on a line of their own
    if len(rows) < vertices + polygons:
        raise ValueError(f"expected {vertices} vertices and {polygons} faces, got {len(rows)} rows")
    if polygons:
        # As OBJ, which counts from 1: trimesh's own reader fails at polygons of five corners.
        text = [b"v " + b" ".join(row[:3]) for row in rows[:vertices]]
        for row in rows[vertices : vertices + polygons]:
            size = int(row[0])
            corners = [int(word) for word in row[1 : 1 + size]]
            if len(corners) != size or min(corners, default=0) < 0:
                raise ValueError(f"expected {size} corners from 0, got {corners}: is it cut short?")
            text.append(b"f " + b" ".join(b"%d" % (corner + 1) for corner in corners))
        return _obj(b"\n".join(text))
    table = np.array(rows[:vertices], dtype=np.float64)
    return Shape(table[:, :3], None, table[:, 3:6] if counts[2] else None)


def _glb(data: bytes) -> Shape:
    """Returns the mesh in a binary glTF file, in metres; other files that it names are not read."""
    stated, size = (int.from_bytes(data[at : at + 4], "little") for at in (8, 12))
    if stated != len(data):
        raise ValueError(f"expected {stated} bytes, got {len(data)}: is it cut short?")
    header = json.loads(data[20 : 20 + size])
    nodes = header.get("nodes", [])
    children = sum(len(node.get("children", [])) for node in nodes)
    counts = [accessor["count"] for accessor in header.get("accessors", [])]
    if children > len(nodes) or max(counts, default=0) > len(data):
        raise ValueError("expected a tree of nodes, and numbers that fit into the file")
    return _mesh(_scene("glb", data, skip_materials=True), None)


def _dae(data: bytes) -> Shape:
    """Returns the mesh in a COLLADA file, in metres."""
    with needing("DAE needs pycollada and lxml", "meshes"):
        import_module("collada")
        import_module("lxml")
    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refused_doctype
    parser.Parse(data, True)
    return _mesh(_scene("dae", data), None)


def _refused_doctype(*_: object) -> NoReturn:
    """Raises ValueError, as a DOCTYPE could name other files, or grow without bound."""
    raise ValueError("expected a document without DOCTYPE, got one")


def _3mf(data: bytes) -> Shape:
    """Returns the mesh in a 3MF archive, in metres."""
    with needing("3MF needs lxml and networkx", "meshes"):
        import_module("lxml")
        import_module("networkx")
    size = sum(each.file_size for each in zipfile.ZipFile(io.BytesIO(data)).infolist())
    if size > LARGEST_FILE:
        raise ValueError(f"expected at most {LARGEST_FILE} bytes unpacked, got {size}")
    return _mesh(_scene("3mf", data), None)


def _xyz(data: bytes) -> Shape:
    """Returns the cloud in a text of rows of 3 coordinates, or these and a normal, separated by spaces or commas."""
    table = np.loadtxt(io.BytesIO(data.replace(b",", b" ")), encoding="latin-1", ndmin=2)
    width = table.shape[1]
    if width not in (3, 6):
        raise ValueError(f"expected 3 or 6 columns, got {width}")
    return Shape(table[:, :3], None, table[:, 3:] if width == 6 else None)


READERS: dict[str, Callable[[bytes], Shape]] = {
    ".stl": _stl, ".obj": _obj, ".ply": _ply, ".off": _off, ".glb": _glb, ".dae": _dae, ".3mf": _3mf, ".xyz": _xyz,
}  # fmt: skip
"""The reader for each extension; a new format is a new entry."""
