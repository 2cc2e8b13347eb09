"""The Point Cloud Library's file format, version 0.7: text, binary and LZF-compressed.

https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight.objects.files.text import BadText

_KINDS = {"F": "f", "I": "i", "U": "u"}
_SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
_MOST_FIELDS = 256
_MOST_COUNT = 4096
_LZF_RATIO = 100
"""LZF cannot grow data by more than 264 / 3."""


@dataclass(frozen=True, slots=True)
class _Header:
    names: list[str]
    dtypes: list[np.dtype[Any]]
    counts: list[int]
    points: int
    data: str
    body: bytes

    @property
    def row(self) -> np.dtype[Any]:
        """One point as it lies in a binary body."""
        fields = [(f"f{k}", d, (c,)) for k, (d, c) in enumerate(zip(self.dtypes, self.counts, strict=True))]
        return np.dtype(fields)


def pcd_columns(data: bytes) -> dict[str, NDArray[Any]]:
    """The fields with one number a point, each (n,), by name; raises BadText."""
    header = _header(data)
    read = {"ascii": _ascii, "binary": _binary, "binary_compressed": _compressed}.get(header.data)
    if read is None:
        raise BadText(f"DATA: expected ascii, binary or binary_compressed, got {header.data[:30]!r}")
    columns = read(header)
    return {n: column for n, c, column in zip(header.names, header.counts, columns, strict=True) if c == 1}


def _header(data: bytes) -> _Header:
    entries: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in entries:
        end = data.find(b"\n", at)
        if end < 0 or end - at > 10_000 or len(entries) > 20:
            raise BadText("expected a PCD header that ends with DATA")
        words = data[at:end].decode("latin-1").split("#")[0].split()
        at = end + 1
        if words:
            entries[words[0].upper()] = words[1:]
    names = entries.get("FIELDS", [])
    if not 0 < len(names) <= _MOST_FIELDS:
        raise BadText(f"FIELDS: expected 1 to {_MOST_FIELDS} names, got {len(names)}")
    counts = _whole(entries, "COUNT", len(names)) if "COUNT" in entries else [1] * len(names)
    if max(counts) > _MOST_COUNT:
        raise BadText(f"COUNT: expected at most {_MOST_COUNT}, got {max(counts)}")
    dtypes = _dtypes(entries, len(names))
    if "POINTS" in entries:
        points = _whole(entries, "POINTS", 1)[0]
    else:
        points = _whole(entries, "WIDTH", 1)[0] * _whole(entries, "HEIGHT", 1)[0]
    kind = entries["DATA"][0].lower() if entries["DATA"] else ""
    return _Header(names, dtypes, counts, points, kind, data[at:])


def _whole(entries: dict[str, list[str]], key: str, length: int) -> list[int]:
    words = entries.get(key, [])
    if len(words) != length or not all(word.isdigit() and len(word) < 19 for word in words):
        raise BadText(f"{key}: expected {length} whole numbers, got {' '.join(words)[:40]!r}")
    return [int(word) for word in words]


def _dtypes(entries: dict[str, list[str]], length: int) -> list[np.dtype[Any]]:
    sizes, kinds = _whole(entries, "SIZE", length), entries.get("TYPE", [])
    if len(kinds) != length:
        raise BadText(f"TYPE: expected {length} letters, got {len(kinds)}")
    for kind, size in zip(kinds, sizes, strict=True):
        if kind not in _KINDS or size not in _SIZES[kind]:
            raise BadText(f"TYPE and SIZE: expected F, I or U of 1 to 8 bytes, got {kind[:10]} {size}")
    return [np.dtype(f"<{_KINDS[kind]}{size}") for kind, size in zip(kinds, sizes, strict=True)]


def _ascii(header: _Header) -> list[NDArray[Any]]:
    width = sum(header.counts)
    words = header.body.split()
    if len(words) < header.points * width:
        raise BadText(f"expected {header.points} points of {width} numbers, got {len(words)} numbers")
    try:
        table = np.array(words[: header.points * width], dtype="S").astype(np.float64).reshape(-1, width)
    except ValueError as error:
        raise BadText(f"expected numbers: {str(error)[:80]}") from None
    starts = np.cumsum(header.counts) - header.counts
    return [table[:, s] for s in starts]


def _binary(header: _Header) -> list[NDArray[Any]]:
    row = header.row
    if len(header.body) < header.points * row.itemsize:
        raise BadText(f"expected {header.points * row.itemsize} bytes of points, got {len(header.body)}")
    table = np.frombuffer(header.body, dtype=row, count=header.points)
    return [table[name][:, 0] for name in row.names or ()]


def _compressed(header: _Header) -> list[NDArray[Any]]:
    """Field after field rather than point after point, behind both sizes."""
    if len(header.body) < 8:
        raise BadText("expected two sizes before the compressed points")
    packed, size = (int(v) for v in np.frombuffer(header.body, dtype="<u4", count=2))
    if packed > len(header.body) - 8:
        raise BadText(f"expected {packed} compressed bytes, got {len(header.body) - 8}")
    if size != header.points * header.row.itemsize or size > _LZF_RATIO * packed:
        raise BadText(f"expected {header.points * header.row.itemsize} bytes unpacked, the file says {size}")
    flat = lzf_unpacked(header.body[8 : 8 + packed], size)
    columns, at = [], 0
    for dtype, count in zip(header.dtypes, header.counts, strict=True):
        length = header.points * count
        columns.append(np.frombuffer(flat, dtype=dtype, count=length, offset=at).reshape(-1, count)[:, 0])
        at += length * dtype.itemsize
    return columns


def lzf_unpacked(packed: bytes, size: int) -> bytes:
    """The `size` bytes that LZF packed; raises BadText where they are not that."""
    out = bytearray()
    at, end = 0, len(packed)
    while at < end:
        control = packed[at]
        at += 1
        if control < 32:  # a run of literal bytes
            if at + control + 1 > end:
                raise BadText("compressed points are cut short")
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if at + (length == 7) >= end:
            raise BadText("compressed points are cut short")
        if length == 7:
            length += packed[at]
            at += 1
        back = ((control & 31) << 8) + packed[at] + 1
        at += 1
        _copy(out, back, length + 2)
        if len(out) > size:
            break
    if len(out) != size:
        raise BadText(f"expected {size} bytes unpacked, got {len(out)}")
    return bytes(out)


def _copy(out: bytearray, back: int, length: int) -> None:
    """Appends `length` bytes from `back` bytes ago; they may overlap what is being written."""
    start = len(out) - back
    if start < 0:
        raise BadText("compressed points refer to bytes before their start")
    if back >= length:
        out += out[start : start + length]
    else:
        pattern = bytes(out[start:])
        out += (pattern * (length // back + 1))[:length]
