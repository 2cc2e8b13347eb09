"""Shapes in text files: XYZ rows, the Object File Format, Wavefront's OBJ and STL in words.

Line by line: however large the file, only its numbers are kept.
"""

import codecs
import io
from array import array
from collections.abc import Iterable, Iterator
from itertools import chain, islice

import numpy as np
from numpy.typing import ArrayLike

from handsight.checks import Array, Indices

LONGEST_LINE = 1 << 20
"""Bytes that a line may have; a polygon of a hundred thousand corners fits in."""


class BadText(ValueError):
    """The content is not what the format asks for; the message says what was expected and what came."""


def text_lines(data: bytes) -> Iterator[str]:
    """Returns the lines of a text, behind the mark of UTF-8 that some editors write; comments may be in any
    encoding."""
    data = data.removeprefix(codecs.BOM_UTF8)
    for at in range(0, len(data) - LONGEST_LINE, LONGEST_LINE):
        if all(data.find(end, at, at + LONGEST_LINE) < 0 for end in (b"\n", b"\r")):
            raise BadText(f"expected lines of text, got one of more than {LONGEST_LINE} bytes")
    return io.TextIOWrapper(io.BytesIO(data), "latin-1")


def rows(lines: Iterable[str], separator: str = "") -> Iterator[list[str]]:
    """Yields the words of each line that has some; `#` starts a comment, a separator parts words as spaces do."""
    for line in lines:
        text = line.partition("#")[0] if "#" in line else line
        words = text.replace(separator, " ").split() if separator else text.split()
        if words:
            yield words


def number_table(words: Iterable[Iterable[str]], width: int) -> Array:
    """Returns (n, width) numbers of rows of so many words; NaN is a number here."""
    try:
        return np.fromiter(map(float, chain.from_iterable(words)), np.float64).reshape(-1, width)
    except BadText:
        raise
    except ValueError as error:
        raise BadText(f"expected numbers: {str(error)[:80]}") from None


def wide(found: Iterable[list[str]], width: int, name: str) -> Iterator[list[str]]:
    """Yields the first `width` words of each row; BadText where there are fewer."""
    for k, words in enumerate(found):
        if len(words) < width:
            raise BadText(f"{name} {k}: expected {width} numbers, got {len(words)}")
        yield words[:width]


def triangles(corners: ArrayLike, counts: ArrayLike) -> Indices:
    """Returns (m, 3): polygons cut into fans; `corners`: the indices of all of them, `counts`: how many each has."""
    index, sizes = np.asarray(corners, dtype=np.int64), np.asarray(counts, dtype=np.int64)
    if (sizes < 3).any():
        k = int(np.argmax(sizes < 3))
        raise BadText(f"face {k}: expected at least 3 corners, got {sizes[k]}")
    first, last = np.cumsum(sizes) - sizes, np.cumsum(sizes - 2)
    start = np.repeat(first, sizes - 2)
    second = start + 1 + np.arange(len(start)) - np.repeat(last - sizes + 2, sizes - 2)
    return np.stack([index[start], index[second], index[second + 1]], axis=1)


def number_rows(data: bytes) -> Array:
    """Returns (n, 3 or 6) numbers of lines separated by spaces or commas."""
    found = rows(text_lines(data), ",")
    first = next(found, None)
    if first is None:
        raise BadText("expected rows of numbers, got none")
    width = len(first)
    if width not in (3, 6):
        raise BadText(f"expected 3 or 6 columns, got {width}")
    return number_table(_equal(chain([first], found), width), width)


def _equal(found: Iterable[list[str]], width: int) -> Iterator[list[str]]:
    for k, words in enumerate(found):
        if len(words) != width:
            raise BadText(f"row {k + 1}: expected {width} columns, got {len(words)}")
        yield words


def off_shape(data: bytes) -> tuple[Array, Array | None, Indices]:
    """Returns vertices (k, 3), normals (k, 3) or None, and triangles (m, 3) of an OFF, NOFF or COFF text."""
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
    table = number_table(wide(islice(found, count), width, "vertex"), width)
    corners, counts = array("q"), array("q")
    for words in islice(found, polygons):
        _take_polygon(words, corners, counts)
    if len(table) < count or len(counts) < polygons:
        got = len(table) + len(counts)
        raise BadText(f"expected {count} vertices and {polygons} faces, got {got} rows")
    return table[:, :3], table[:, 3:] if width == 6 else None, triangles(corners, counts)


def _take_polygon(words: list[str], corners: "array[int]", counts: "array[int]") -> None:
    """Takes in a row of a number of corners and their indices; colours may follow."""
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


def obj_shape(data: bytes) -> tuple[Array, Indices]:
    """Returns vertices (k, 3) and triangles (m, 3) of an OBJ text; its materials, normals and groups are passed
    over."""
    vertices, corners, counts = array("d"), array("q"), array("q")
    for ending in (b"\\\n", b"\\\r\n"):  # the line goes on
        data = data.replace(ending, b"")
    for k, words in enumerate(rows(text_lines(data))):
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])
                vertices.extend((x, y, z))
            elif words[0] == "f":
                index = list(map(int, words[1:] if "/" not in words[-1] else _before_slash(words[1:])))
                if min(index) < 1:
                    index = [_from_one(i, len(vertices) // 3) for i in index]
                corners.extend(index)
                counts.append(len(index))
        except BadText:
            raise
        except (ValueError, OverflowError):
            kind = "3 numbers" if words[0] == "v" else "whole numbers"
            raise BadText(f"row {k + 1}: expected {kind}, got {' '.join(words[1:])[:40]!r}") from None
    if not counts:
        raise BadText("expected triangles, got none")
    if max(corners) > len(vertices) // 3:
        raise BadText(f"faces: expected vertices 1 to {len(vertices) // 3}, got {max(corners)}")
    return np.array(vertices).reshape(-1, 3), triangles(corners, counts) - 1


def _before_slash(words: list[str]) -> list[str]:
    """Returns, of corners as `vertex/texture/normal`, the first."""
    return [word.partition("/")[0] for word in words]


def _from_one(index: int, known: int) -> int:
    """Returns an index that counts from 1, where it may count backwards from the last vertex so far, at -1."""
    if index < -known or index == 0:
        raise BadText(f"faces: expected vertices from 1, or from -1 to -{known} backwards, got {index}")
    return index if index > 0 else known + 1 + index


def stl_shape(data: bytes) -> tuple[Array, Indices]:
    """Returns vertices (k, 3) and triangles (m, 3) of an STL in words."""
    lines = (line for line in text_lines(data) if "vertex" in line.lower())
    found = (words[1:] for words in rows(lines) if words[0].lower() == "vertex")
    vertices = number_table(wide(found, 3, "vertex"), 3)
    if not len(vertices) or len(vertices) % 3:
        raise BadText(f"expected 3 vertices a triangle, got {len(vertices)} vertices")
    return vertices, np.arange(len(vertices)).reshape(-1, 3)
