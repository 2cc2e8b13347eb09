"""The Point Cloud Library's file format, version 0.7: text, binary and LZF-compressed.

https://pointclouds.org/documentation/tutorials/pcd_file_format.html
"""

import codecs
import math
from itertools import accumulate, chain, islice

import numpy as np
from numpy.typing import NDArray

from handsight.objects.files.shape import BadText, Shape, numbers, rows, text_lines, three_columns


def pcd_shape(data: bytes) -> Shape:
    """Returns the cloud in a PCD file, with its normals if the file has some; raises BadText."""
    names, row, points, kind, body = _header(data)
    parts = [(row[k].base, row[k].shape[0]) for k in range(len(names))]
    size = points * row.itemsize
    columns: list[NDArray[np.generic]] = []
    if kind == "ascii":
        ends = list(accumulate(count for _, count in parts))
        width = ends.pop()
        words = chain.from_iterable(rows(text_lines(body)))
        found = numbers(islice(words, min(points * width, len(body))))
        if len(found) < points * width:
            raise BadText(f"expected {points} points of {width} numbers, got {len(found)} numbers")
        columns = np.split(found.reshape(-1, width), ends, axis=1)
    elif kind == "binary":
        if len(body) < size:
            raise BadText(f"expected {size} bytes of points, got {len(body)}")
        table = np.frombuffer(body, dtype=row, count=points)
        columns = [table[name] for name in row.names or ()]
    elif kind == "binary_compressed":
        # Two sizes, then field after field rather than point after point.
        if len(body) < 8:
            raise BadText("expected two sizes before the compressed points")
        packed, unpacked = (int(v) for v in np.frombuffer(body, dtype="<u4", count=2))
        if packed > len(body) - 8:
            raise BadText(f"expected {packed} compressed bytes, got {len(body) - 8}")
        if unpacked != size or unpacked > 100 * packed:  # LZF cannot expand more than 264 / 3 times
            raise BadText(f"expected {size} bytes unpacked, the file says {unpacked}")
        flat, at = lzf_unpacked(body[8 : 8 + packed], unpacked), 0
        for dtype, count in parts:
            columns.append(np.frombuffer(flat, dtype, points * count, offset=at).reshape(-1, count))
            at += columns[-1].nbytes
    else:
        raise BadText(f"DATA: expected ascii, binary or binary_compressed, got {kind[:30]!r}")
    fields = dict(zip(names, columns, strict=True))
    single = {name: column[:, 0] for name, column in fields.items() if column.shape[1] == 1}
    places = three_columns(single, "x", "y", "z")
    if places is None:
        raise BadText(f"expected the fields x y z, got {' '.join(single)}")
    return Shape(places, None, three_columns(single, "normal_x", "normal_y", "normal_z"))


def _header(data: bytes) -> tuple[list[str], "np.dtype[np.void]", int, str, bytes]:
    """Returns the names, the number of points, the kind of the body and the body of a PCD file; raises BadText.

    Second is the layout of a point in a binary body: a field of one or several numbers for each name.
    """
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

    def integers(key: str, length: int) -> list[int]:
        """Returns the whole numbers of an entry; raises BadText where their number is not `length`."""
        words = entries.get(key, [])
        if len(words) != length or not all(word.isdecimal() and len(word) < 19 for word in words):
            raise BadText(f"{key}: expected {length} whole numbers, got {' '.join(words)[:40]!r}")
        return [int(word) for word in words]

    most_fields, most_count = 256, 4096
    names = entries.get("FIELDS", [])
    length = len(names)
    if not 0 < length <= most_fields:
        raise BadText(f"FIELDS: expected 1 to {most_fields} names, got {length}")
    sides = ("POINTS",) if "POINTS" in entries else ("WIDTH", "HEIGHT")
    points = math.prod(integers(side, 1)[0] for side in sides)
    counts = integers("COUNT", length) if "COUNT" in entries else [1] * length
    if max(counts) > most_count:
        raise BadText(f"COUNT: expected at most {most_count}, got {max(counts)}")
    sizes, kinds = integers("SIZE", length), entries.get("TYPE", [])
    if len(kinds) != length:
        raise BadText(f"TYPE: expected {length} letters, got {len(kinds)}")
    allowed = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
    parts = []
    for k, (kind, size, count) in enumerate(zip(kinds, sizes, counts, strict=True)):
        if size not in allowed.get(kind, ()):
            raise BadText(f"TYPE and SIZE: expected F, I or U of 1 to 8 bytes, got {kind[:10]} {size}")
        parts.append((f"f{k}", f"<{kind.lower()}{size}", (count,)))
    body_kind = entries["DATA"][0].lower() if entries["DATA"] else ""
    return names, np.dtype(parts), points, body_kind, data[at:]


def lzf_unpacked(packed: bytes, size: int) -> bytes:
    """Returns the `size` bytes that LZF packed; raises BadText where these are damaged or not as many."""
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
            # The pattern is shorter where it overlaps what is being written.
            pattern = bytes(out[start : start + length + 2])
            out += (pattern * -(-(length + 2) // len(pattern)))[: length + 2]
    except IndexError:
        raise BadText("compressed points are cut short") from None
    if len(out) != size:
        raise BadText(f"expected {size} bytes unpacked, got {len(out)}")
    return bytes(out)
