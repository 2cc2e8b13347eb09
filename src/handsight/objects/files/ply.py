"""The Polygon File Format, read as text or binary and written as binary: http://paulbourke.net/dataformats/ply/."""

import codecs
import struct
from array import array
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Mask
from handsight.objects.files.shape import (
    BadText,
    Shape,
    number_table,
    rows,
    text_lines,
    three_columns,
    triangles,
)

_TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "int64": "q", "uint64": "Q",
    "float16": "e", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
"""The letters of the struct module, which are NumPy's too, by the type names of PLY."""
_FLOATS = "efd"


class _Element(NamedTuple):
    """A table of the file, such as the one of the vertices."""

    name: str
    rows: int
    properties: list[tuple[str, str, str]]
    """Name, letter of the numbers' type, and letter of the type of a list's length, empty for one number a row."""

    def cut_short(self, got: int) -> BadText:
        """Returns the error for a file that has only `got` rows of the table."""
        return BadText(f"expected {self.rows} rows of '{self.name}', got {got}: is it cut short?")


Column = tuple[NDArray[np.generic], NDArray[np.generic] | None]
"""The values of a property, row after row, and the length of each row's list; None for a property that is no list."""
Table = dict[str, Column]  # the columns of an element by the names of its properties


def ply_shape(data: bytes) -> Shape:
    """Returns the mesh in a PLY file, or the cloud if the file has no faces; raises BadText. The vertex property
    `sigma` is the standard deviation of a cloud's points."""
    order, elements, at = _header(data)
    lines = iter(()) if order else rows(text_lines(data[at:]))
    tables: dict[str, Table] = {}
    for element in elements:
        if element.rows and order:
            tables[element.name], at = _binary_table(data, at, order, element)
        elif element.rows:
            tables[element.name] = _text_table(lines, element)
        if {"vertex", "face"} <= tables.keys():
            break  # edges, materials and the like follow
    if "vertex" not in tables:
        raise BadText("expected an element 'vertex', got none")
    vertex = {
        name: np.asarray(values, dtype=np.float64)
        for name, (values, lengths) in tables["vertex"].items()
        if lengths is None
    }
    points = three_columns(vertex, "x", "y", "z")
    if points is None:
        raise BadText("expected the vertex properties x, y, z")
    if "face" not in tables:
        return Shape(points, None, three_columns(vertex, "nx", "ny", "nz"), sigmas=vertex.get("sigma"))
    # The triangles are in the list `vertex_indices` or `vertex_index`, or else in the only list.
    usual, face = ("vertex_indices", "vertex_index"), tables["face"]
    lists = [name for name, (v, counts) in face.items() if counts is not None and v.dtype.kind in "iu"]
    name = next((name for name in (*usual, *lists) if name in lists), "")
    if not name or (name not in usual and len(lists) > 1):
        raise BadText(f"expected a list {usual[0]} of each face, got {', '.join(face)[:80]}")
    corners, counts = face[name]
    return Shape(points, triangles(corners, [] if counts is None else counts))


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Returns the byte order (empty for text), the elements, and the offset behind the header; raises BadText."""
    orders = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    most = 10_000  # lines, and bytes in each
    order, elements = None, list[_Element]()
    at = len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0
    for k in range(most):
        end = data.find(b"\n", at, at + most)
        if end < 0:
            break
        words, at = data[at:end].decode("latin-1").split(), end + 1
        if k == 0 and words != ["ply"]:
            raise BadText(f"expected 'ply' in the first line, got {' '.join(words)[:20]!r}")
        match words:
            case ["format", kind, *_]:
                order = orders.get(kind)
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append(_Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case ["property", "list", count, kind, name] if (
                elements and {count, kind} <= _TYPES.keys() and _TYPES[count] not in _FLOATS
            ):
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[count]))
            case ["element" | "property", *_]:
                raise BadText(f"expected an element or a property of one, got {' '.join(words)[:60]!r}")
            case ["end_header"]:
                if order is None:
                    raise BadText(f"expected the format {', '.join(orders)}")
                if empty := [each.name for each in elements if each.rows and not each.properties]:
                    raise BadText(f"{empty[0]}: expected properties, got none")
                return order, elements, at
    raise BadText("expected a PLY header that ends with end_header")


def _text_table(lines: Iterator[list[str]], element: _Element) -> Table:
    """Returns the next rows of a text body, a line each; raises BadText."""
    properties = element.properties
    if not any(length for _, _, length in properties):
        table = number_table(islice(lines, element.rows), len(properties), element.name)
        if len(table) < element.rows:
            raise element.cut_short(len(table))
        return {name: (table[:, k], None) for k, (name, _, _) in enumerate(properties)}

    def row() -> list[list[float]]:
        """Returns the numbers of each property in the next line; raises BadText, StopIteration where there is none."""
        words = next(lines)
        left, found = iter(words), list[list[float]]()
        try:
            for _, kind, length in properties:
                n = int(next(left)) if length else 1
                found.append(list(map(float if kind in _FLOATS else int, islice(left, n))))
                if len(found[-1]) < n:
                    raise ValueError
        except (ValueError, StopIteration):
            message = f"expected numbers, as many as there are properties, got {' '.join(words)[:40]!r}"
            raise BadText(f"{element.name}: {message}") from None
        return found

    return _table_of_rows(element, row)


def _binary_table(data: bytes, at: int, order: str, element: _Element) -> tuple[Table, int]:
    """Returns the rows of a binary body that begin at the offset `at`, and the offset behind them; raises BadText."""
    start, properties = at, element.properties

    def row() -> list[tuple[Any, ...]]:
        """Returns the numbers of each property in the next row; raises struct.error where the file ends before."""
        nonlocal at
        found = []
        for _, kind, length in properties:
            n = 1
            if length:
                (n,) = struct.unpack_from(order + length, data, at)
                at += struct.calcsize(order + length)
            found.append(struct.unpack_from(f"{order}{n}{kind}", data, at))
            at += struct.calcsize(f"{order}{n}{kind}")
        return found

    # In most files each list is as long in every row as in the first, so that all rows have one layout.
    try:
        first = row()
    except struct.error:
        raise element.cut_short(0) from None
    size, at = at - start, start
    if element.rows <= (len(data) - at) // size:
        parts: list[Any] = []
        for k, ((_, kind, length), values) in enumerate(zip(properties, first, strict=True)):
            parts += [(f"n{k}", order + length)] if length else []
            parts.append((f"v{k}", order + kind, (len(values),)))
        table = np.frombuffer(data, np.dtype(parts), element.rows, at)
        counts = {k: table[f"n{k}"] for k, (_, _, length) in enumerate(properties) if length}
        if all((count == len(first[k])).all() for k, count in counts.items()):
            columns = [(table[f"v{k}"].reshape(-1), counts.get(k)) for k in range(len(properties))]
            return {name: columns[k] for k, (name, _, _) in enumerate(properties)}, at + element.rows * size
    found = _table_of_rows(element, row)
    return found, at


def _table_of_rows(element: _Element, row: Callable[[], Sequence[Sequence[Any]]]) -> Table:
    """Returns an element's table; `row` returns the numbers of every property in the next row. Raises BadText."""
    values = [array("d" if kind in _FLOATS else "q") for _, kind, _ in element.properties]
    counts = [array("q") for _ in element.properties]
    for done in range(element.rows):
        try:
            for k, numbers in enumerate(row()):
                values[k].extend(numbers)
                counts[k].append(len(numbers))
        except (struct.error, StopIteration):
            raise element.cut_short(done) from None
        except OverflowError:
            raise BadText(f"{element.name}: expected numbers of 64 bits, got a larger one") from None
    columns = zip(element.properties, values, counts, strict=True)
    return {name: (np.array(v), np.array(n) if length else None) for (name, _, length), v, n in columns}


def ply_bytes(shape: Shape, scale: float, measured: Mask | None = None) -> bytes:
    """Returns the content of a PLY file with a mesh or a cloud, its coordinates times `scale` as doubles.

    `measured` (k,): which vertices were measured; it is written as the property `measured`, 1 or 0.
    """
    names, columns = ["x", "y", "z"], [scale * shape.vertices]
    if shape.normals is not None:
        names, columns = [*names, "nx", "ny", "nz"], [*columns, shape.normals]
    if shape.sigmas is not None:
        names, columns = [*names, "sigma"], [*columns, scale * shape.sigmas[:, None]]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(shape.vertices)}"]
    header += [f"property double {name}" for name in names]
    kinds: list[Any] = [("numbers", "<f8", len(names))]
    if measured is not None:
        header.append("property uchar measured")
        kinds.append(("measured", "u1"))
    table = np.empty(len(shape.vertices), kinds)
    table["numbers"] = np.hstack(columns)
    if measured is not None:
        table["measured"] = measured
    body = table.tobytes()
    if shape.faces is not None:
        header += [f"element face {len(shape.faces)}", "property list uchar int vertex_indices"]
        faces = np.empty(len(shape.faces), [("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, shape.faces
        body += faces.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body
