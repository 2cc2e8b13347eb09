"""The Point Cloud Library's file format, version 0.7: text, binary and LZF-compressed.

https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

import codecs
from dataclasses import dataclass
from itertools import accumulate, chain, islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight.objects.files.text import BadText, number_table, rows, text_lines

_INTEGER_SIZES = (1, 2, 4, 8)
_DTYPES = {
    (kind, size): np.dtype(f"<{kind.lower()}{size}")
    for kind, sizes in (("F", (4, 8)), ("I", _INTEGER_SIZES), ("U", _INTEGER_SIZES))
    for size in sizes
}


class PcdLimits(NamedTuple):
    """`PcdLimits` are what a PCD file may hold."""

    max_fields: int = 256  # of a point
    max_count: int = 4096  # of numbers in a field
    max_expansion: int = 100  # LZF cannot grow data by more than 264 / 3


_LIMITS = PcdLimits()


@dataclass(frozen=True, slots=True)
class _Header:
    names: list[str]
    row: np.dtype[np.void]
    """One point as it lies in a binary body: for each name a field of one or several numbers."""
    points: int
    kind: str
    body: bytes

    @property
    def parts(self) -> list[tuple[np.dtype[np.void], int]]:
        """The type and count of each field's numbers."""
        return [(self.row[k].base, self.row[k].shape[0]) for k in range(len(self.names))]


def pcd_columns(data: bytes) -> dict[str, NDArray[np.generic]]:
    """Returns the fields with one number a point, each (n,), by name; raises BadText."""
    header = _header(data)
    readers = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}
    if header.kind not in readers:
        raise BadText(f"DATA: expected ascii, binary or binary_compressed, got {header.kind[:30]!r}")
    columns = zip(header.names, readers[header.kind](header), strict=True)
    return {name: column[:, 0] for name, column in columns if column.shape[1] == 1}


def _header(data: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    at = len(codecs.BOM_UTF8) if data.startswith(codecs.BOM_UTF8) else 0
    while "DATA" not in entries:
        end = data.find(b"\n", at)
        if end < 0 or end - at > 10_000 or len(entries) > 20:
            raise BadText("expected a PCD header that ends with DATA")
        words = data[at:end].decode("latin-1").split("#")[0].split()
        at = end + 1
        if words:
            entries[words[0].upper()] = words[1:]
    names = entries.get("FIELDS", [])
    if not 0 < len(names) <= _LIMITS.max_fields:
        raise BadText(f"FIELDS: expected 1 to {_LIMITS.max_fields} names, got {len(names)}")
    if "POINTS" in entries:
        points = _integers(entries, "POINTS", 1)[0]
    else:
        points = _integers(entries, "WIDTH", 1)[0] * _integers(entries, "HEIGHT", 1)[0]
    kind = entries["DATA"][0].lower() if entries["DATA"] else ""
    return _Header(names, _row(entries, len(names)), points, kind, data[at:])


def _integers(entries: dict[str, list[str]], key: str, length: int) -> list[int]:
    words = entries.get(key, [])
    if len(words) != length or not all(word.isdecimal() and len(word) < 19 for word in words):
        raise BadText(f"{key}: expected {length} whole numbers, got {' '.join(words)[:40]!r}")
    return [int(word) for word in words]


def _row(entries: dict[str, list[str]], length: int) -> np.dtype[np.void]:
    counts = _integers(entries, "COUNT", length) if "COUNT" in entries else [1] * length
    if max(counts) > _LIMITS.max_count:
        raise BadText(f"COUNT: expected at most {_LIMITS.max_count}, got {max(counts)}")
    sizes, kinds = _integers(entries, "SIZE", length), entries.get("TYPE", [])
    if len(kinds) != length:
        raise BadText(f"TYPE: expected {length} letters, got {len(kinds)}")
    for part in zip(kinds, sizes, strict=True):
        if part not in _DTYPES:
            raise BadText(f"TYPE and SIZE: expected F, I or U of 1 to 8 bytes, got {part[0][:10]} {part[1]}")
    parts = zip(kinds, sizes, counts, strict=True)
    return np.dtype([(f"f{k}", _DTYPES[kind, size], (n,)) for k, (kind, size, n) in enumerate(parts)])


def _ascii(header: _Header) -> list[NDArray[np.generic]]:
    ends = list(accumulate(count for _, count in header.parts))
    width = ends.pop()
    words = chain.from_iterable(rows(text_lines(header.body)))
    expected = header.points * width
    numbers = number_table([islice(words, min(expected, len(header.body)))], 1)
    if len(numbers) < expected:
        raise BadText(f"expected {header.points} points of {width} numbers, got {len(numbers)} numbers")
    return np.split(numbers.reshape(-1, width), ends, axis=1)


def _binary(header: _Header) -> list[NDArray[np.generic]]:
    size = header.points * header.row.itemsize
    if len(header.body) < size:
        raise BadText(f"expected {size} bytes of points, got {len(header.body)}")
    table = np.frombuffer(header.body, dtype=header.row, count=header.points)
    return [table[name] for name in header.row.names or ()]


def _compressed(header: _Header) -> list[NDArray[np.generic]]:
    """Reads field after field rather than point after point, behind both sizes."""
    if len(header.body) < 8:
        raise BadText("expected two sizes before the compressed points")
    packed, size = (int(v) for v in np.frombuffer(header.body, dtype="<u4", count=2))
    if packed > len(header.body) - 8:
        raise BadText(f"expected {packed} compressed bytes, got {len(header.body) - 8}")
    if size != header.points * header.row.itemsize or size > _LIMITS.max_expansion * packed:
        raise BadText(f"expected {header.points * header.row.itemsize} bytes unpacked, the file says {size}")
    flat = lzf_unpacked(header.body[8 : 8 + packed], size)
    columns, at = list[NDArray[np.generic]](), 0
    for dtype, count in header.parts:
        column = np.frombuffer(flat, dtype, header.points * count, offset=at)
        columns.append(column.reshape(-1, count))
        at += column.nbytes
    return columns


def lzf_unpacked(packed: bytes, size: int) -> bytes:
    """Returns the `size` bytes that LZF packed; raises BadText where they are not that."""
    out, at = bytearray(), 0
    try:
        while at < len(packed) and len(out) <= size:
            control, at = packed[at], at + 1
            if control < 32:  # a run of literal bytes
                out += packed[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length, at = length + packed[at], at + 1
            start = len(out) - ((control & 31) << 8) - packed[at] - 1
            at += 1
            if start < 0:
                raise BadText("compressed points refer to bytes before their start")
            pattern = bytes(
                out[start : start + length + 2]
            )  # shorter where it overlaps what is being written
            out += (pattern * -(-(length + 2) // len(pattern)))[: length + 2]
    except IndexError:
        raise BadText("compressed points are cut short") from None
    if len(out) != size:
        raise BadText(f"expected {size} bytes unpacked, got {len(out)}")
    return bytes(out)
