"""Where the taxels of a surface are: in a table, in a file, on a sensor of a URDF, or by the name of a product."""

import csv
import json
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact.gels import Gel
from handsight.contact.pads import Pad
from handsight.contact.taxels import MOST_TAXELS, Grid, TactileSurface, grid_places
from handsight.errors import InvalidInput
from handsight.files import read_bytes
from handsight.hand import Hand, LinkMesh, find_file
from handsight.hand.robot_xml import Element, read_xml

PRODUCTS: dict[str, tuple[int, int, float | None, float | None, int]] = {
    "xela:fingertip": (6, 5, 0.0047, 0.012, 3),
    "xela:phalanx": (4, 4, 0.0047, None, 3),
    "xela:palm": (6, 4, 0.0047, None, 3),
    "inspire:tip": (3, 3, None, None, 1),
    "inspire:nail": (12, 8, None, None, 1),
    "inspire:pad": (10, 8, None, None, 1),
    "inspire:palm": (8, 14, None, None, 1),
}
"""Rows, columns, pitch [m], radius about the finger [m] and components of products without published coordinates. A
pitch that is not published must be in the rig; the radius of a curved one is an assumption."""
KINDS = {each.kind: each for each in (TactileSurface, Gel, Pad)}
ON_LINK, FAR_OFF, INWARD = 0.005, 0.015, -0.3
"""Farthest distance of a taxel from its link's mesh, where that gives its normal; where it has one [m]; and the cosine
between taxels' normals and the mesh's below which they point into it."""


class Layout(NamedTuple):
    """A `Layout` has the places of taxels in the axes of their sensor."""

    points: Array
    """(n, 3) [m]"""
    normals: Array | None = None
    """(n, 3) outward; None: they are those of the link's mesh."""
    x_axes: Array | None = None
    """(n, 3) the taxels' own x; None: not stated."""
    components: int = 1
    grid: tuple[int, int] | None = None
    """Rows and columns of a flat grid, whose frame is the sensor's."""
    frame: str | None = None
    """The link that a URDF states, and the sensor's pose in it."""
    T_frame_sensor: Array = np.eye(4)
    nominal: bool = False

    @classmethod
    def of(cls, rows: Any, name: str, unit: float = 1.0, **fields: Any) -> "Layout":
        """Returns the layout of a table: x, y, z of each taxel, then its normal, then its x; raises InvalidInput."""
        numbers = [len(row) if isinstance(row, list) else 0 for row in rows] if isinstance(rows, list) else []
        wrong = [k for k, count in enumerate(numbers) if count not in (3, 6, 9) or count != numbers[0]]
        if not numbers or wrong:
            came = f"{numbers[wrong[0]]} in row {wrong[0] + 1}" if wrong else "none"
            raise InvalidInput(f"{name}: expected 3, 6 or 9 numbers for each taxel, got {came}")
        table = checks.finite(rows, name, (len(rows), numbers[0]))
        parts: Any = [table[:, k : k + 3] for k in range(3, numbers[0], 3)]
        return cls(unit * table[:, :3], *parts, **fields)

    @classmethod
    def bent(cls, rows: Any, columns: Any, pitch: Any, radius: float | None, components: int = 1) -> "Layout":
        """Returns a grid of taxels, bent about its y with a radius [m]; None: flat. Raises InvalidInput."""
        places = grid_places(rows, columns, pitch).reshape(-1, 3)
        if radius is None:
            flat = [np.tile(np.eye(3)[k], (len(places), 1)) for k in (2, 0)]
            return cls(places, flat[0], flat[1], components, (rows, columns))
        angle, zero = places[:, 0] / radius, np.zeros(len(places))
        sine, cosine = np.sin(angle), np.cos(angle)
        if columns * pitch > 6.3 * radius:
            raise InvalidInput(f"radius: expected one that {columns} columns fit around, got {radius:g}")
        points = np.column_stack([radius * sine, places[:, 1], radius * (cosine - 1)])
        normals, x_axes = np.column_stack([sine, zero, cosine]), np.column_stack([cosine, zero, -sine])
        return cls(points, normals, x_axes, components)

    def surface(
        self, T_frame_sensor: Array, hand: Hand | None, given: dict[str, Any], kind: str = "taxels"
    ) -> TactileSurface:
        """Returns the surface of a kind with the fields that are given; raises InvalidInput."""
        T = self.T_frame_sensor @ T_frame_sensor
        points = se3.apply(T, self.points)
        fields = {"components": self.components, "frame": self.frame, "nominal": self.nominal} | given
        if self.normals is None:
            frame: Any = fields["frame"]
            mesh = None if hand is None else hand.link_meshes().get(frame)
            if mesh is None:
                expected = f"expected three more numbers for each taxel, as {frame!r} has no mesh"
                raise InvalidInput(f"normals: {expected}, got none")
            fields["normals"], distance = _nearest(mesh, points)
            if not distance.max() <= ON_LINK:
                of = f"the mesh of {frame!r}, which gives their normals"
                expected = f"expected taxels within {1e3 * ON_LINK:g} mm of {of}"
                raise InvalidInput(
                    f"points[{distance.argmax()}]: {expected}, got {1e3 * distance.max():.3g} mm"
                )
        else:
            fields["normals"] = self.normals @ T[:3, :3].T
        if self.x_axes is not None:
            fields["x_axes"] = self.x_axes @ T[:3, :3].T
        if self.grid is not None:
            fields["layout"] = Grid(T, *self.grid)
        return KINDS[kind](points=points, **fields)


def from_file(name: str, folder: Path, unit: float) -> Layout:
    """Returns the layout of a file: CSV, with or without a line of names, or JSON, a list of rows or of `points`.

    `unit`: of the file [m]. Raises InvalidInput.
    """
    path = find_file(name, folder)
    try:
        text = read_bytes(path, 1 << 20, path.name).decode("utf-8-sig")
        if path.suffix.lower() == ".json":
            value = json.loads(text)
            rows = value.get("points", value.get("taxels")) if isinstance(value, dict) else value
        else:
            lines = [line for line in csv.reader(text.splitlines()) if line]
            named = bool(lines) and not lines[0][0].strip().lstrip("+-.")[:1].isdigit()
            rows = [[float(cell) for cell in line] for line in lines[named:]]
    except (ValueError, RecursionError, csv.Error) as error:
        expected = f"expected numbers in CSV or JSON, got other text ({error})"
        raise InvalidInput(f"file: {path.name}: {expected}") from None
    return Layout.of(rows, f"file: {path.name}", unit)


def by_name(name: str, pitch: float | None, radius: float | None) -> Layout:
    """Returns the layout of a product, `paxini:VARIANT` or one of `PRODUCTS`; raises InvalidInput.

    Coordinates of PaXini's are read from the installed package `paxini-sdk`, without importing it; their normals are
    those of planes through the nearest taxels. The others are nominal: their maker states counts and pitch alone.
    """
    maker, _, variant = name.partition(":")
    if maker == "paxini":
        spec = find_spec("paxini_sdk")
        if spec is None or spec.origin is None:
            raise InvalidInput("layout: expected the package paxini-sdk (pip install paxini-sdk), got none")
        known: dict[str, Any] = {}
        for path in sorted((Path(spec.origin).parent / "data").glob("*_points.json")):
            value = json.loads(read_bytes(path, 1 << 20, path.name))
            names = value["vendor_part_code"], value["sensor_model"].split("GEN3-")[-1]
            known |= dict.fromkeys(names, value)
        if variant not in known:
            raise InvalidInput(f"layout: unknown variant {variant!r}{checks.suggestion(variant, known)}")
        places = [[each[f"{axis}_mm"] for axis in "xyz"] for each in known[variant]["points"]]
        points = 1e-3 * np.array(places)
        near = np.argsort(np.linalg.norm(points[:, None] - points, axis=2), axis=1)[:, :7]
        arms = points[near] - points[near].mean(axis=1, keepdims=True)
        normals = np.linalg.svd(arms)[2][:, 2]
        # They point away from the centre of a sphere that is fitted to all points.
        sphere = np.column_stack([2 * points, np.ones(len(points))])
        center = np.linalg.lstsq(sphere, (points**2).sum(axis=1), rcond=None)[0][:3]
        outward = np.sign((normals * (points - center)).sum(axis=1))
        return Layout(points, normals * outward[:, None], components=3)
    if name not in PRODUCTS:
        hint = checks.suggestion(name, [*PRODUCTS, "paxini:VARIANT"])
        raise InvalidInput(f"layout: unknown layout {name!r}{hint}")
    rows, columns, usual_pitch, usual_radius, components = PRODUCTS[name]
    if (pitch := pitch or usual_pitch) is None:
        expected = f"expected the distance of {name}'s taxels [m], as it is not published"
        raise InvalidInput(f"pitch: {expected}, got none")
    return Layout.bent(rows, columns, pitch, radius or usual_radius, components)._replace(nominal=True)


def tactile_sensors(file: str | Path) -> dict[str, tuple[Element, Element]]:
    """Returns each `<sensor>` of a hand's URDF and its `<tactile>`, by its name; raises InvalidFile."""
    sensors = ((each, each.find("tactile")) for each in read_xml(find_file(file)).all("sensor"))
    return {each.get("name"): (each, tactile) for each, tactile in sensors if tactile is not None}


def from_urdf(name: str, hand: Hand) -> Layout:
    """Returns the layout of `<sensor name><tactile>` in a hand's URDF; raises InvalidInput.

    An `<array>` is read row by row; of a list each `<taxel>` has the number `idx`. Source: urdf_tactile.
    """
    found = tactile_sensors(hand.file)
    if name not in found:
        raise InvalidInput(f"urdf: unknown tactile sensor {name!r}{checks.suggestion(name, found)}")
    (sensor, tactile), parent = found[name], found[name][0].find("parent")
    array = tactile.find("array")
    taxels = sorted(tactile.all("taxel"), key=lambda each: _numbers(each, "idx", 1)[0])
    T = _origin(sensor.find("origin"))
    fields: Any = {"frame": "" if parent is None else parent.get("link"), "T_frame_sensor": T}
    if not taxels and array is not None:
        rows, columns = (int(_numbers(array, key, 1)[0]) for key in ("rows", "cols"))
        step = _numbers(array, "spacing" if array.get("spacing") else "size", 2)
        if not 1 <= rows * columns <= MOST_TAXELS:
            raise InvalidInput(f"urdf: {name}: expected 1 to {MOST_TAXELS} taxels, got {rows} x {columns}")
        by_column = array.get("order").startswith("col")
        down, along = np.indices((rows, columns)).reshape(2, -1, order="F" if by_column else "C")
        Ts = np.tile(np.eye(4), (rows * columns, 1, 1))
        Ts[:, :2, 3] = np.stack([along, down], axis=1) * step
        Ts[:, :2, 3] += _numbers(array, "offset", 2) if array.get("offset") else 0.0
    elif [_numbers(each, "idx", 1)[0] for each in taxels] == list(range(len(taxels))) and taxels:
        Ts = np.array([_origin(each) for each in taxels])
    else:
        numbers = ", ".join(each.get("idx") for each in taxels) or "none"
        raise InvalidInput(f"urdf: {name}: expected an array, or taxels with idx 0, 1, ..., got {numbers}")
    return Layout(Ts[:, :3, 3], Ts[:, :3, 2], Ts[:, :3, 0], **fields)


def _origin(element: Element | None) -> Array:
    """Returns the pose (4, 4) of `xyz` and `rpy`."""
    from scipy.spatial.transform import Rotation  # its import is long

    if element is None:
        return np.eye(4)
    xyz, rpy = (_numbers(element, key, 3) if element.get(key) else np.zeros(3) for key in ("xyz", "rpy"))
    return se3.compose(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def _numbers(element: Element, key: str, count: int) -> Array:
    """Returns the numbers of an attribute; raises InvalidFile with the line."""
    try:
        return checks.finite([float(each) for each in element.get(key).split()], key, (count,))
    except (ValueError, InvalidInput):
        raise element.error(f"expected {count} numbers for {key}, got {element.get(key)[:40]!r}") from None


def misplaced(surfaces: Mapping[str, TactileSurface], hand: Hand) -> dict[str, str]:
    """Returns by surface what is wrong with its place on the mesh of its link, as far as that has one."""
    meshes, found = hand.link_meshes(), {}
    for name, surface in surfaces.items():
        if surface.frame in meshes:
            normals, distance = _nearest(meshes[surface.frame], surface.points)
            most, of = 1e3 * distance.max(), f"the mesh of {surface.frame!r}"
            if np.median((normals * surface.normals).sum(axis=1)) < INWARD:
                expected = f"expected normals that point out of {of}"
                found[name] = f"{expected}, got into it: turn its pose, or negate them"
            elif most > 1e3 * FAR_OFF:
                expected = f"expected taxels within {1e3 * FAR_OFF:g} mm of {of}"
                came = f"taxel {distance.argmax()} {most:.3g} mm off"
                found[name] = f"{expected}, got {came}: is its pose right?"
    return found


def _nearest(mesh: LinkMesh, points: Array) -> tuple[Array, Array]:
    """Returns (n, 3) the normals of a mesh at the places nearest to points (n, 3), and their distances (n,) [m]."""
    import trimesh  # takes long to load, and most layouts have normals

    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    _, distance, face = trimesh.proximity.closest_point_naive(shape, points)  # type: ignore[no-untyped-call]
    return np.asarray(shape.face_normals[face]), distance
