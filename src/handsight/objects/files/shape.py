"""The shape in a file, and the parts that the readers of formats share: lines of text, tables of numbers, polygons."""

import codecs
import io
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight.checks import Array, Indices

LONGEST_LINE = 1 << 20  # most bytes in a line; a polygon of a hundred thousand corners fits in


class BadText(Exception):
    """The error that a file's content is not of its format; the message names what was expected and what came."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A `Shape` is a mesh or a point cloud in its file's own unit."""

    vertices: Array  # (k, 3)
    faces: Indices | None = None  # (m, 3) vertex indices; None for a cloud
    normals: Array | None = None  # (k, 3) of a cloud, of any length; None where the file has none
    remarks: tuple[str, ...] = ()  # a sentence for each kind of content that was left out
    sigmas: Array | None = None
    """(k,) standard deviation of a cloud's points, by errors that neighbours share; None if the file declares none."""


def text_lines(data: bytes) -> Iterator[str]:
    """Returns the lines of a text; raises BadText for a line of more than `LONGEST_LINE` bytes.

    A byte order mark of UTF-8 is skipped. Every byte is decoded, because comments may be in any encoding.
    """
    data = data.removeprefix(codecs.BOM_UTF8)
    for at in range(0, len(data) - LONGEST_LINE, LONGEST_LINE):
        if all(data.find(end, at, at + LONGEST_LINE) < 0 for end in (b"\n", b"\r")):
            raise BadText(f"expected lines of text, got one of more than {LONGEST_LINE} bytes")
    return io.TextIOWrapper(io.BytesIO(data), "latin-1")


def rows(lines: Iterable[str], separator: str = "") -> Iterator[list[str]]:
    """Yields the words of each line that is not empty, split at spaces and at `separator`; `#` starts a comment."""
    for line in lines:
        text = line.partition("#")[0] if "#" in line else line
        words = text.replace(separator, " ").split() if separator else text.split()
        if words:
            yield words


def numbers(words: Iterable[str]) -> Array:
    """Returns the words as numbers (n,), which may be NaN; raises BadText for a word that is no number."""
    try:
        return np.fromiter(map(float, words), np.float64)
    except ValueError as error:
        raise BadText(f"expected numbers: {str(error)[:80]}") from None


def number_table(found: Iterable[list[str]], width: int, name: str) -> Array:
    """Returns the first `width` numbers of each row (n, width); raises BadText, naming the row, where there are fewer.
    `name`: what a row is, for the message."""

    def checked() -> Iterator[list[str]]:
        """Yields `width` words of each row; raises BadText for a row with fewer."""
        for k, words in enumerate(found):
            if len(words) < width:
                raise BadText(f"{name} {k}: expected {width} numbers, got {len(words)}")
            yield words[:width]

    return numbers(chain.from_iterable(checked())).reshape(-1, width)


def three_columns(columns: Mapping[str, NDArray[np.generic]], *names: str) -> Array | None:
    """Returns the three columns (k,) with these names as one table (k, 3), or None where one is missing."""
    if not columns.keys() >= set(names):
        return None
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def triangles(corners: ArrayLike, counts: ArrayLike) -> Indices:
    """Returns polygons as triangles (m, 3), each polygon a fan about its first corner; raises BadText below 3 corners.

    `corners`: the vertex indices of all polygons, one after another; `counts`: how many corners each polygon has.
    """
    index, sizes = np.asarray(corners, dtype=np.int64), np.asarray(counts, dtype=np.int64)
    if (sizes < 3).any():
        k = int(np.argmax(sizes < 3))
        raise BadText(f"face {k}: expected at least 3 corners, got {sizes[k]}")
    first, last = np.cumsum(sizes) - sizes, np.cumsum(sizes - 2)
    start = np.repeat(first, sizes - 2)
    second = start + 1 + np.arange(len(start)) - np.repeat(last - sizes + 2, sizes - 2)
    return np.stack([index[start], index[second], index[second + 1]], axis=1)
