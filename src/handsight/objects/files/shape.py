"""The shape in a file."""

from dataclasses import dataclass

from handsight.checks import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A mesh or a point cloud in its file's own unit, in metres where the format states the unit (GLB, DAE, 3MF)."""

    vertices: Array  # (k, 3)
    faces: Indices | None = None  # (m, 3) vertex indices; None for a cloud
    normals: Array | None = None  # (k, 3) of a cloud, of any length; None where the file has none
    remarks: tuple[str, ...] = ()  # a sentence for each kind of content that was left out
    sigmas: Array | None = None
    """(k,) standard deviation of a cloud's points, by errors that neighbours share; None if the file declares none."""
