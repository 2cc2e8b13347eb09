"""Shapes written as binary PLY: http://paulbourke.net/dataformats/ply/."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from handsight.checks import Array
from handsight.objects.files.read import read_shape
from handsight.objects.files.shape import Shape


def ply_bytes(shape: Shape, scale: float) -> bytes:
    """Returns the content of a PLY file with a mesh or a cloud, its coordinates times `scale` as doubles."""
    names = ["x", "y", "z"]
    columns = [scale * shape.vertices]
    if shape.normals is not None:
        names = [*names, "nx", "ny", "nz"]
        columns = [*columns, shape.normals]
    if shape.sigmas is not None:
        names = [*names, "sigma"]
        columns = [*columns, scale * shape.sigmas[:, None]]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(shape.vertices)}"]
    header += [f"property double {name}" for name in names]
    body = np.hstack(columns).astype("<f8").tobytes()
    if shape.faces is not None:
        header += [f"element face {len(shape.faces)}", "property list uchar int vertex_indices"]
        faces = np.empty(len(shape.faces), [("count", "u1"), ("corners", "<i4", 3)])
        faces["count"] = 3
        faces["corners"] = shape.faces
        body += faces.tobytes()
    return "\n".join([*header, "end_header\n"]).encode() + body


def write_recentred(path: Path, folder: Path) -> tuple[Path, Array]:
    """Writes the shape in a file, moved to the middle of its bounds, to a PLY of the same name in a folder.

    Returns the PLY's path, and that middle (3,), both in the file's unit. Raises as `read_shape`.
    """
    shape = read_shape(path)
    known = shape.vertices[np.isfinite(shape.vertices).all(axis=1)]
    middle = (known.min(axis=0) + known.max(axis=0)) / 2
    moved = folder / f"{path.stem}.ply"
    moved.write_bytes(ply_bytes(replace(shape, vertices=shape.vertices - middle), 1.0))
    return moved, middle
