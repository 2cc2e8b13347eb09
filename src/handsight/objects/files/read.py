"""Shapes read from files: meshes from STL, OBJ, PLY and OFF, point clouds from PLY, OFF, PCD and XYZ.

Only the named file is opened: no material, texture or other path inside it is followed. Text is read line by line, so
that only the numbers of a large file are kept in memory. The counts that a file states are compared with its content: a
file that was cut, or whose header is wrong, is refused; general mesh libraries read it in part.
"""

import codecs
import os
from array import array
from collections.abc import Callable, Iterator
from itertools import chain, islice
from pathlib import Path

import numpy as np

from handsight.errors import InvalidFile
from handsight.files import read_bytes
from handsight.objects.files.pcd import pcd_shape
from handsight.objects.files.ply import ply_shape
from handsight.objects.files.shape import BadText, Shape, number_table, numbers, rows, text_lines, triangles

LARGEST_FILE = 500_000_000  # the largest number of bytes that a file may have


def read_shape(path: str | os.PathLike[str]) -> Shape:
    """Returns the mesh or cloud in a file, by its extension; raises InvalidFile starting with the file's name."""
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
    """Returns the mesh or cloud in the content of a file with this name; raises InvalidFile.

    Points of a cloud that are not finite, as sensors write missing ones, or whose normal is not valid, are left out,
    and a remark says how many.
    """
    try:
        shape = READERS[file.suffix.lower()](data)
    except BadText as error:
        raise InvalidFile(f"{file.name}: {error}") from None
    except MemoryError:
        raise InvalidFile(f"{file.name}: expected a shape that fits into memory, got a larger one") from None
    if not len(shape.vertices):
        raise InvalidFile(f"{file.name}: expected points or triangles, got none")
    if shape.faces is not None:
        return shape
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
    return Shape(shape.vertices[good], None, normals, (remark,), sigmas)


def xyz_shape(data: bytes) -> Shape:
    """Returns the cloud in an XYZ text: rows of 3 coordinates, or these and a normal, separated by spaces or commas."""
    found = rows(text_lines(data), ",")
    first = next(found, None)
    if first is None:
        raise BadText("expected rows of numbers, got none")
    width = len(first)
    if width not in (3, 6):
        raise BadText(f"expected 3 or 6 columns, got {width}")

    def checked() -> Iterator[list[str]]:
        """Yields the rows; raises BadText for one of another width."""
        for k, words in enumerate(chain([first], found), start=1):
            if len(words) != width:
                raise BadText(f"row {k}: expected {width} columns, got {len(words)}")
            yield words

    table = numbers(chain.from_iterable(checked())).reshape(-1, width)
    return Shape(table[:, :3], None, table[:, 3:] if width == 6 else None)


def off_shape(data: bytes) -> Shape:
    """Returns the mesh in an Object File Format text (OFF, NOFF, COFF, CNOFF), or the cloud if it has no faces."""
    found = rows(text_lines(data), ",")
    words = next(found, [""])
    header = words[0].upper()
    if header not in ("OFF", "NOFF", "COFF", "CNOFF"):
        raise BadText(f"expected OFF, NOFF, COFF or CNOFF, got {header[:20]!r}")
    # The counts may be on the header's line.
    sizes = (words[1:] or next(found, []))[:2]
    if len(sizes) < 2 or not all(word.isdecimal() and len(word) < 19 for word in sizes):
        raise BadText("expected the counts of vertices and faces after the header")
    count, polygons = map(int, sizes)
    width = 6 if "N" in header else 3
    table = number_table(islice(found, count), width, "vertex")
    corners, counts = array("q"), array("q")
    for words in islice(found, polygons):  # a number of corners, their indices, and perhaps a colour
        message = f"face {len(counts)}: expected"
        try:
            n = int(words[0])
            index = array("q", map(int, words[1 : 1 + max(n, 0)]))
        except (ValueError, OverflowError):
            raise BadText(f"{message} whole numbers, got {' '.join(words)[:40]!r}") from None
        if n < 3 or len(index) < n:
            raise BadText(f"{message} at least 3 corners, all there, got {' '.join(words)[:40]!r}")
        corners.extend(index)
        counts.append(n)
    if len(table) < count or len(counts) < polygons:
        got = len(table) + len(counts)
        raise BadText(f"expected {count} vertices and {polygons} faces, got {got} rows")
    faces = triangles(corners, counts) if polygons else None
    return Shape(table[:, :3], faces, table[:, 3:] if width == 6 else None)


def obj_shape(data: bytes) -> Shape:
    """Returns the mesh in a Wavefront OBJ text; materials, normals and groups are ignored."""
    vertices, corners, counts = array("d"), array("q"), array("q")
    for ending in (b"\\\n", b"\\\r\n"):  # a line that goes on in the next
        data = data.replace(ending, b"")
    for k, words in enumerate(rows(text_lines(data))):
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])
                vertices.extend((x, y, z))
            elif words[0] == "f":
                # A corner is written vertex/texture/normal.
                texts = [w.partition("/")[0] for w in words[1:]] if "/" in words[-1] else words[1:]
                index = list(map(int, texts))
                if min(index) < 1:  # -1 is the last vertex before this line
                    known = len(vertices) // 3
                    if (wrong := next((i for i in index if i < -known or i == 0), None)) is not None:
                        message = f"expected vertices from 1, or from -1 to -{known} backwards, got {wrong}"
                        raise BadText(f"faces: {message}")
                    index = [i if i > 0 else known + 1 + i for i in index]
                corners.extend(index)
                counts.append(len(index))
        except (ValueError, OverflowError):
            kind = "3 numbers" if words[0] == "v" else "whole numbers"
            raise BadText(f"row {k + 1}: expected {kind}, got {' '.join(words[1:])[:40]!r}") from None
    if not counts:
        raise BadText("expected triangles, got none")
    if max(corners) > len(vertices) // 3:
        raise BadText(f"faces: expected vertices 1 to {len(vertices) // 3}, got {max(corners)}")
    return Shape(np.array(vertices).reshape(-1, 3), triangles(corners, counts) - 1)


def stl_shape(data: bytes) -> Shape:
    """Returns the mesh in an STL file, binary or text; each triangle has three vertices of its own."""
    count = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    if count and len(data) >= 84 + 50 * count:
        triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(data, triangle, count, offset=84)["corners"]
        vertices = corners.reshape(-1, 3).astype(np.float64)
    elif data.removeprefix(codecs.BOM_UTF8).lstrip()[:5].lower() != b"solid":
        raise BadText(f"expected {84 + 50 * count} bytes of binary STL, got {len(data)}: is it cut short?")
    elif b"endsolid" not in data[-4096:].lower():
        raise BadText("expected 'endsolid' at the end: is it cut short?")
    else:
        lines = (line for line in text_lines(data) if "vertex" in line.lower())
        found = (words[1:] for words in rows(lines) if words[0].lower() == "vertex")
        vertices = number_table(found, 3, "vertex")
        if not len(vertices) or len(vertices) % 3:
            raise BadText(f"expected 3 vertices a triangle, got {len(vertices)} vertices")
    return Shape(vertices, np.arange(len(vertices)).reshape(-1, 3))


READERS: dict[str, Callable[[bytes], Shape]] = {
    ".stl": stl_shape, ".obj": obj_shape, ".ply": ply_shape, ".off": off_shape, ".pcd": pcd_shape, ".xyz": xyz_shape,
}  # fmt: skip
"""The reader for each extension; a new format is a new entry."""
