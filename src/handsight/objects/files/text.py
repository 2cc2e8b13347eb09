"""Numbers in text files: XYZ rows and the Object File Format."""

from collections.abc import Sequence

import numpy as np

from handsight.checks import Array, Indices


class BadText(ValueError):
    """The content is not what the format asks for; the message says what was expected and what came."""


def number_rows(data: bytes) -> Array:
    """(n, c) numbers of lines separated by spaces or commas; `#` starts a comment. NaN is a number here."""
    lines = _lines(data)
    if not lines:
        raise BadText("expected rows of numbers, got none")
    width = len(lines[0])
    for k, words in enumerate(lines):
        if len(words) != width:
            raise BadText(f"row {k + 1}: expected {width} columns, got {len(words)}")
    return number_table([word for words in lines for word in words], width)


def number_table(words: Sequence[str | bytes], width: int) -> Array:
    """(n, width) numbers, row by row."""
    try:
        return np.array(words, dtype=np.float64).reshape(-1, width)
    except ValueError as error:
        raise BadText(f"expected numbers: {str(error)[:80]}") from None


def off_shape(data: bytes) -> tuple[Array, Array | None, Indices]:
    """Vertices (k, 3), normals (k, 3) or None, and triangles (m, 3) of an OFF, NOFF or COFF text.

    Polygons are cut into fans.
    """
    lines = _lines(data)
    header = lines[0][0].upper() if lines else ""
    if header not in ("OFF", "NOFF", "COFF", "CNOFF"):
        raise BadText(f"expected OFF, NOFF, COFF or CNOFF, got {header[:20]!r}")
    # The counts may be on the header's line.
    lines = [lines[0][1:], *lines[1:]] if len(lines[0]) > 1 else lines[1:]
    if not lines or len(lines[0]) < 2 or not all(word.isdigit() for word in lines[0][:2]):
        raise BadText("expected the counts of vertices and faces after the header")
    count, polygons = int(lines[0][0]), int(lines[0][1])
    if count + polygons > len(lines) - 1:
        raise BadText(f"expected {count} vertices and {polygons} faces, got {len(lines) - 1} rows")
    wide = 6 if "N" in header else 3
    rows = lines[1 : 1 + count]
    for k, words in enumerate(rows):
        if len(words) < wide:
            raise BadText(f"vertex {k}: expected {wide} numbers, got {len(words)}")
    table = number_table([word for words in rows for word in words[:wide]], wide)
    faces = _fans(lines[1 + count : 1 + count + polygons])
    return table[:, :3], table[:, 3:] if wide == 6 else None, faces


def _lines(data: bytes) -> list[list[str]]:
    """The words of each line that has some; commas part words too."""
    text = data.decode("latin-1").replace(",", " ")
    rows = (line.split("#", 1)[0].split() for line in text.splitlines())
    return [row for row in rows if row]


def _fans(rows: list[list[str]]) -> Indices:
    """Triangles (m, 3) of polygons, each row its number of corners and their indices."""
    triangles: list[tuple[int, int, int]] = []
    for k, words in enumerate(rows):
        try:
            n = int(words[0])
            corners = [int(word) for word in words[1 : 1 + n]]
        except ValueError:
            raise BadText(f"face {k}: expected whole numbers, got {' '.join(words)[:40]!r}") from None
        if n < 3 or len(corners) < n:
            raise BadText(f"face {k}: expected at least 3 corners, all there, got {' '.join(words)[:40]!r}")
        triangles += [(corners[0], corners[i], corners[i + 1]) for i in range(1, n - 1)]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
