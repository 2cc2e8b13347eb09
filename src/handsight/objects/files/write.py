"""Shapes written as binary PLY: doubles, so that nothing is rounded, and no colours, which no one asks for."""

from typing import Any

import numpy as np

from handsight.checks import Mask
from handsight.objects.files.read import Shape


def ply_bytes(shape: Shape, scale: float, measured: Mask | None = None) -> bytes:
    """Returns a mesh or a cloud as the content of a PLY file, its coordinates times `scale`; `ply_shape` reads it back.

    `measured` (k,): which vertices were, in a property of that name: 1, else 0.
    """
    columns = [scale * shape.vertices]
    names = ["x", "y", "z"]
    if shape.normals is not None:
        columns.append(shape.normals)
        names += ["nx", "ny", "nz"]
    if shape.sigmas is not None:
        columns.append(scale * shape.sigmas[:, None])
        names.append("sigma")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(shape.vertices)}"]
    header += [f"property double {name}" for name in names]
    kinds: list[Any] = [("numbers", "<f8", len(names))]
    if measured is not None:
        header.append("property uchar measured")
        kinds.append(("measured", "u1"))
    rows = np.empty(len(shape.vertices), kinds)
    rows["numbers"] = np.hstack(columns)
    if measured is not None:
        rows["measured"] = measured
    body = rows.tobytes()
    if shape.faces is not None:
        header += [f"element face {len(shape.faces)}", "property list uchar int vertex_indices"]
        table = np.empty(len(shape.faces), [("count", "u1"), ("corners", "<i4", 3)])
        table["count"], table["corners"] = 3, shape.faces
        body += table.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body
