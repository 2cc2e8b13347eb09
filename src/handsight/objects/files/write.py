"""Shapes written as binary PLY: doubles, so that nothing is rounded, and no colours, which no one asks for."""

import numpy as np

from handsight.objects.files.read import Shape


def ply_bytes(shape: Shape, scale: float) -> bytes:
    """A mesh or a cloud as the content of a PLY file, its coordinates times `scale`; `ply_shape` reads it back."""
    columns = [scale * shape.vertices]
    names = ["x", "y", "z"]
    if shape.normals is not None:
        columns.append(shape.normals)
        names += ["nx", "ny", "nz"]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(shape.vertices)}"]
    header += [f"property double {name}" for name in names]
    body = np.hstack(columns).astype("<f8").tobytes()
    if shape.faces is not None:
        header += [f"element face {len(shape.faces)}", "property list uchar int vertex_indices"]
        table = np.empty(len(shape.faces), [("count", "u1"), ("corners", "<i4", 3)])
        table["count"], table["corners"] = 3, shape.faces
        body += table.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body
