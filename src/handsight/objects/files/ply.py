"""The Polygon File Format, in words or binary: http://paulbourke.net/dataformats/ply/."""

import codecs
import struct
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array, Indices
from handsight.objects.files.text import BadText, number_table, rows, text_lines, triangles, wide

_TYPES = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "int64": "q", "uint64": "Q",
    "float16": "e", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
"""The struct module's letters, which are NumPy's too."""
_FLOATS = "efd"
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_LINES = 10_000
"""Of a header, and bytes of each."""
_CORNERS = ("vertex_indices", "vertex_index")
"""What the list of a face's corners is called, where it is not its only list."""


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    """Letter of its numbers."""
    count: str = ""
    """Letter of how many there are, of a list."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    rows: int
    properties: list[_Property] = field(default_factory=list)

    def cut(self, got: int) -> BadText:
        return BadText(f"expected {self.rows} rows of '{self.name}', got {got}: is it cut short?")


@dataclass(frozen=True, slots=True)
class _Column:
    """A `_Column` is what an element has of a property, row after row."""

    values: NDArray[np.generic]
    counts: NDArray[np.generic] | None = None
    """Of a list, how many each row has."""


Table = dict[str, _Column]


def ply_shape(data: bytes) -> tuple[Array, Array | None, Indices | None]:
    """Returns vertices (k, 3), normals (k, 3) or None, and triangles (m, 3) or None for a cloud; raises BadText."""
    order, elements, at = _header(data)
    body = _Binary(data, at, order) if order else _Words(data[at:])
    tables: dict[str, Table] = {}
    for element in elements:
        if element.rows:
            tables[element.name] = body.table(element)
        if {"vertex", "face"} <= tables.keys():
            break  # what follows are edges, materials and the like
    if "vertex" not in tables:
        raise BadText("expected an element 'vertex', got none")
    points = _three(tables["vertex"], ("x", "y", "z"))
    if points is None:
        raise BadText("expected the vertex properties x, y, z")
    if "face" in tables:
        return points, None, _faces(tables["face"])
    return points, _three(tables["vertex"], ("nx", "ny", "nz")), None


def ply_sigmas(data: bytes) -> Array | None:
    """Returns (k,) what a cloud says its points may be off by, in a property `sigma`, or None; raises BadText."""
    order, elements, at = _header(data)
    if [each.name for each in elements[:1]] != ["vertex"] or any(each.name == "face" for each in elements):
        return None
    if not elements[0].rows or "sigma" not in {each.name for each in elements[0].properties}:
        return None
    column = (_Binary(data, at, order) if order else _Words(data[at:])).table(elements[0])["sigma"]
    return None if column.counts is not None else np.asarray(column.values, dtype=np.float64)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Returns the order of bytes (empty: words), elements, and where the header ends."""
    order, elements = None, list[_Element]()
    at = len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0
    for k in range(_MOST_LINES):
        end = data.find(b"\n", at, at + _MOST_LINES)
        if end < 0:
            break
        words, at = data[at:end].decode("latin-1").split(), end + 1
        if k == 0 and words != ["ply"]:
            raise BadText(f"expected 'ply' in the first line, got {' '.join(words)[:20]!r}")
        match words:
            case ["format", kind, *_]:
                order = _ORDERS.get(kind)
            case ["element", name, count] if count.isdecimal() and len(count) < 19:
                elements.append(_Element(name, int(count)))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["property", "list", count, kind, name] if elements and _is_list(count, kind):
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case ["element" | "property", *_]:
                raise BadText(f"expected an element or a property of one, got {' '.join(words)[:60]!r}")
            case ["end_header"]:
                if order is None:
                    raise BadText(f"expected the format {', '.join(_ORDERS)}")
                if empty := [each.name for each in elements if each.rows and not each.properties]:
                    raise BadText(f"{empty[0]}: expected properties, got none")
                return order, elements, at
    raise BadText("expected a PLY header that ends with end_header")


def _is_list(count: str, kind: str) -> bool:
    return {count, kind} <= _TYPES.keys() and _TYPES[count] not in _FLOATS


class _Words:
    """A `_Words` is a body of words, a line a row."""

    def __init__(self, body: bytes) -> None:
        self._rows = rows(text_lines(body))

    def table(self, element: _Element) -> Table:
        """Returns the next rows; raises BadText."""
        found, of = islice(self._rows, element.rows), element.properties
        if any(each.count for each in of):
            return _of_rows(element, (_numbers(words, element) for words in found))
        table = number_table(wide(found, len(of), element.name), len(of))
        if len(table) < element.rows:
            raise element.cut(len(table))
        return {each.name: _Column(table[:, k]) for k, each in enumerate(of)}


def _numbers(words: list[str], element: _Element) -> list[list[float]]:
    """Returns what a row has of each property."""
    left, found = iter(words), list[list[float]]()
    try:
        for each in element.properties:
            n = int(next(left)) if each.count else 1
            found.append(list(map(float if each.kind in _FLOATS else int, islice(left, n))))
            if len(found[-1]) < n:
                raise ValueError
    except (ValueError, StopIteration):
        message = f"expected numbers, as many as there are properties, got {' '.join(words)[:40]!r}"
        raise BadText(f"{element.name}: {message}") from None
    return found


class _Binary:
    """A `_Binary` is a body of bytes."""

    def __init__(self, data: bytes, at: int, order: str) -> None:
        self._data, self._at, self._order = data, at, order

    def table(self, element: _Element) -> Table:
        """Returns the next rows; raises BadText."""
        begin = self._at
        try:  # lists are mostly as long in each row as in the first
            sizes = [len(values) for values in self._row(element)]
        except struct.error:
            raise element.cut(0) from None
        length, self._at = self._at - begin, begin
        if element.rows <= (len(self._data) - begin) // length:
            table = np.frombuffer(self._data, self._row_type(element, sizes), element.rows, begin)
            counts = {k: table[f"n{k}"] for k, each in enumerate(element.properties) if each.count}
            if all((count == sizes[k]).all() for k, count in counts.items()):
                self._at = begin + element.rows * length
                return {
                    each.name: _Column(table[f"v{k}"].reshape(-1), counts.get(k))
                    for k, each in enumerate(element.properties)
                }
        return _of_rows(element, (self._row(element) for _ in range(element.rows)))

    def _row_type(self, element: _Element, sizes: list[int]) -> np.dtype[np.generic]:
        parts: list[Any] = []
        for k, (each, n) in enumerate(zip(element.properties, sizes, strict=True)):
            parts += [(f"n{k}", self._order + each.count)] if each.count else []
            parts.append((f"v{k}", self._order + each.kind, (n,)))
        return np.dtype(parts)

    def _row(self, element: _Element) -> list[tuple[int, ...]]:
        """Returns what the next row has of each property; struct.error where it ends beyond the file."""
        return [
            self._take(each.kind, self._take(each.count, 1)[0] if each.count else 1)
            for each in element.properties
        ]

    def _take(self, kind: str, n: int) -> tuple[int, ...]:
        numbers = struct.unpack_from(f"{self._order}{n}{kind}", self._data, self._at)
        self._at += struct.calcsize(f"{self._order}{n}{kind}")
        return numbers


def _of_rows(element: _Element, found: Iterator[Sequence[Sequence[Any]]]) -> Table:
    values = [array("d" if each.kind in _FLOATS else "q") for each in element.properties]
    counts = [array("q") for _ in element.properties]
    done = 0
    try:
        for row in found:
            for k, numbers in enumerate(row):
                values[k].extend(numbers)
                counts[k].append(len(numbers))
            done += 1
    except struct.error:
        raise element.cut(done) from None
    except OverflowError:
        raise BadText(f"{element.name}: expected numbers of 64 bits, got a larger one") from None
    if done < element.rows:
        raise element.cut(done)
    columns = zip(element.properties, values, counts, strict=True)
    return {each.name: _Column(np.array(v), np.array(n) if each.count else None) for each, v, n in columns}


def _three(table: Table, names: tuple[str, str, str]) -> Array | None:
    """Returns (k, 3) of the columns so named, or None where one is missing or a list."""
    columns = [table[name] for name in names if name in table and table[name].counts is None]
    if len(columns) < 3:
        return None
    return np.stack([np.asarray(column.values, dtype=np.float64) for column in columns], axis=1)


def _faces(table: Table) -> Indices:
    lists = {
        name: (column.values, column.counts)
        for name, column in table.items()
        if column.counts is not None and column.values.dtype.kind in "iu"
    }
    name = next((name for name in (*_CORNERS, *lists) if name in lists), "")
    if not name or (name not in _CORNERS and len(lists) > 1):
        raise BadText(f"expected a list {_CORNERS[0]} of each face, got {', '.join(table)[:80]}")
    return triangles(*lists[name])
