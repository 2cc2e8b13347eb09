"""Where the taxels of a surface are: in a table, in a file, on a sensor of a URDF, or by the name of a product."""

import json
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact.taxels import MOST_TAXELS, Grid, TactileSurface, grid_places
from handsight.errors import InvalidInput
from handsight.files import read_bytes
from handsight.hand import Hand, LinkMesh, find_file
from handsight.hand.robot_xml import Element, read_xml
from handsight.rig.taxel_table import LARGEST, extent, in_metres, read_table
from handsight.rig.yaml_file import YamlFile

LAYOUTS = Path(__file__).parents[1] / "data/layouts"
"""A YAML file for each product without published coordinates: `MAKER-VARIANT.yaml`."""
ASSUMED_PITCH = 0.002
"""From taxel to taxel where nobody has measured it yet [m]."""


class Product(msgspec.Struct, forbid_unknown_fields=True):
    """Grid of taxels whose maker publishes counts alone."""

    rows: int
    columns: int
    components: int
    pitch: float | None = None
    """From taxel to taxel [m]; None: not published, so the rig must state it."""
    radius: float | None = None
    """About the finger [m], an assumption; None: flat."""


class Layout(NamedTuple):
    """Places of taxels in the axes of their sensor."""

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
        try:
            table = checks.finite(rows, name, (None, None))
        except InvalidInput:
            table = np.zeros((0, 0))
        if table.shape[1] not in (3, 6, 9) or not len(table):
            raise InvalidInput(
                f"{name}: expected 3, 6 or 9 finite numbers for each taxel, got {checks.brief(rows)}"
            )
        parts: Any = np.split(table, table.shape[1] // 3, axis=1)
        return cls(unit * parts[0], *parts[1:], **fields)

    @classmethod
    def bent(cls, rows: Any, columns: Any, pitch: Any, radius: float | None, components: int = 1) -> "Layout":
        """Returns a grid of taxels, bent about its y with a radius [m]; None: flat. Raises InvalidInput."""
        places = grid_places(rows, columns, pitch).reshape(-1, 3)
        if radius is None:
            flat = [np.tile(np.eye(3)[k], (len(places), 1)) for k in (2, 0)]
            return cls(places, flat[0], flat[1], components, (rows, columns))
        if columns * pitch > 2 * np.pi * radius:
            raise InvalidInput(f"radius: expected one that {columns} columns fit around, got {radius:g}")
        angle = places[:, 0] / radius
        zero = np.zeros(len(places))
        normals = np.column_stack([np.sin(angle), zero, np.cos(angle)])
        x_axes = np.column_stack([np.cos(angle), zero, -np.sin(angle)])
        points = radius * (normals - [0, 0, 1]) + [0, 1, 0] * places
        return cls(points, normals, x_axes, components)

    def surface(self, T_frame_sensor: Array, hand: Hand | None, given: dict[str, Any]) -> TactileSurface:
        """Returns the surface with the fields that are given; raises InvalidInput."""
        T = self.T_frame_sensor @ T_frame_sensor
        points = se3.apply(T, self.points)
        fields = {"components": self.components, "frame": self.frame, "nominal": self.nominal} | given
        if self.normals is None:
            frame: Any = fields["frame"]
            mesh = None if hand is None else hand.link_meshes().get(frame)
            if mesh is None:
                raise InvalidInput(
                    f"normals: expected three more numbers for each taxel, as {frame!r} has no mesh, got none"
                )
            fields["normals"], distance = _nearest(mesh, points)
            if not distance.max() <= 0.005:
                raise InvalidInput(
                    f"points[{distance.argmax()}]: expected taxels within 5 mm of the mesh of {frame!r}, which gives "
                    f"their normals, got {1000 * distance.max():.3g} mm"
                )
        else:
            fields["normals"] = self.normals @ T[:3, :3].T
        if self.x_axes is not None:
            fields["x_axes"] = self.x_axes @ T[:3, :3].T
        if self.grid is not None:
            fields["layout"] = Grid(T, *self.grid)
        return TactileSurface(points=points, **fields)


def from_file(name: str, folder: Path, unit: str | None) -> Layout:
    """Returns the layout of a file, as `taxel_table` reads it; raises InvalidInput.

    `unit`: of its positions, `m` or `mm`; None: what its columns say, else metres.
    """
    path = find_file(name, folder)
    try:
        table = read_table(path)
    except InvalidInput as error:
        raise InvalidInput(f"file: {error}") from None
    return Layout.of(in_metres(table, unit, path.name), f"file: {path.name}")


class Places(NamedTuple):
    """What a rig says of where taxels are, and how many these are."""

    keys: dict[str, Any]
    taxels: int
    components: int


def known_places() -> list[Places]:
    """Returns those of each product that is known here."""
    found = list[Places]()
    for path in sorted(LAYOUTS.glob("*.yaml")):
        product = YamlFile(path).read(Product)
        keys: dict[str, Any] = {"layout": path.stem.replace("-", ":", 1)}
        if product.pitch is None:
            keys["pitch"] = ASSUMED_PITCH
        found.append(Places(keys, product.rows * product.columns, product.components))
    for name, table in _paxini().items():
        found.append(Places({"layout": f"paxini:{name}"}, len(table["points"]), 3))
    return found


def said_places(said: str, folder: Path) -> tuple[list[Places], list[str]]:
    """Returns what a user says of a sensor's taxels, their number or the file of their places, and what was guessed.

    The components are not known: both are returned. Raises InvalidInput.
    """
    if said.isdigit():
        count = checks.integer(int(said), "--taxels", MOST_TAXELS, 1)
        columns = max(each for each in range(1, math.isqrt(count) + 1) if count % each == 0)
        rows = count // columns
        keys: dict[str, Any] = {"rows": rows, "columns": columns, "pitch": ASSUMED_PITCH}
        apart = f"{1000 * ASSUMED_PITCH:g} mm apart"
        guessed = [f"{said} taxels: {rows} rows of {columns}, {apart}: measure them"]
        return [Places(keys, count, components) for components in (1, 3)], guessed
    table = read_table(find_file(said, folder))
    keys = {"file": said}
    guessed = []
    if table.unit is None and extent(table) > LARGEST:
        keys["unit"] = "mm"
        guessed.append(f"{said}: millimetres, as it reaches over {extent(table):g} and states no unit")
    return [Places(keys, len(table.rows), components) for components in (1, 3)], guessed


def _paxini() -> dict[str, Any]:
    """Returns PaXini's tables by part number and by model, as the package `paxini-sdk` has them; none without it."""
    spec = find_spec("paxini_sdk")
    known: dict[str, Any] = {}
    if spec is None or spec.origin is None:
        return known
    for path in sorted((Path(spec.origin).parent / "data").glob("*_points.json")):
        value = json.loads(read_bytes(path, 1 << 20, path.name))
        names = value["vendor_part_code"], value["sensor_model"].split("GEN3-")[-1]
        known |= dict.fromkeys(names, value)
    return known


def by_name(name: str, pitch: float | None, radius: float | None) -> Layout:
    """Returns the layout of a product, `paxini:VARIANT` or one in `LAYOUTS`; raises InvalidInput.

    Coordinates of PaXini's are read from the installed package `paxini-sdk`, without importing it; their normals are
    those of planes through the nearest taxels. The others are nominal: their maker states counts and pitch alone.
    """
    maker, _, variant = name.partition(":")
    if maker == "paxini":
        from scipy.spatial import cKDTree  # its import is long

        from handsight.objects.scans.normals import outwards, planes

        known = _paxini()
        if not known:
            raise InvalidInput("layout: expected the package paxini-sdk (pip install paxini-sdk), got none")
        if variant not in known:
            raise InvalidInput(f"layout: unknown variant {variant!r}{checks.suggestion(variant, known)}")
        places = [[each[f"{axis}_mm"] for axis in "xyz"] for each in known[variant]["points"]]
        points = 1e-3 * np.array(places)
        normals = outwards(points, planes(points, points, 7), cKDTree(points))
        return Layout(points, normals, components=3)
    files = {path.stem.replace("-", ":", 1): path for path in sorted(LAYOUTS.glob("*.yaml"))}
    if name not in files:
        raise InvalidInput(
            f"layout: unknown layout {name!r}{checks.suggestion(name, [*files, 'paxini:VARIANT'])}"
        )
    product = YamlFile(files[name]).read(Product)
    pitch = pitch or product.pitch
    if pitch is None:
        raise InvalidInput(
            f"pitch: expected the distance of {name}'s taxels [m], as it is not published, got none"
        )
    radius = radius or product.radius
    bent = Layout.bent(product.rows, product.columns, pitch, radius, product.components)
    return bent._replace(nominal=True)


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
    sensor, tactile = found[name]
    parent = sensor.find("parent")
    array = tactile.find("array")
    taxels = sorted(tactile.all("taxel"), key=lambda each: _numbers(each, "idx", 1)[0])
    if not taxels and array is not None:
        rows, columns = (int(_numbers(array, key, 1)[0]) for key in ("rows", "cols"))
        step = _numbers(array, "spacing" if array.get("spacing") else "size", 2)
        if not 1 <= rows * columns <= MOST_TAXELS:
            raise InvalidInput(f"urdf: {name}: expected 1 to {MOST_TAXELS} taxels, got {rows} x {columns}")
        by_column = array.get("order").startswith("col")
        down, along = np.indices((rows, columns)).reshape(2, -1, order="F" if by_column else "C")
        offset = _numbers(array, "offset", 2) if array.get("offset") else 0.0
        Ts = np.tile(np.eye(4), (rows * columns, 1, 1))
        Ts[:, :2, 3] = np.stack([along, down], axis=1) * step + offset
    elif [_numbers(each, "idx", 1)[0] for each in taxels] == list(range(len(taxels))) and taxels:
        Ts = np.array([_origin(each) for each in taxels])
    else:
        numbers = ", ".join(each.get("idx") for each in taxels) or "none"
        raise InvalidInput(f"urdf: {name}: expected an array, or taxels with idx 0, 1, ..., got {numbers}")
    return Layout(
        Ts[:, :3, 3],
        normals=Ts[:, :3, 2],
        x_axes=Ts[:, :3, 0],
        frame="" if parent is None else parent.get("link"),
        T_frame_sensor=_origin(sensor.find("origin")),
    )


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
    meshes = hand.link_meshes()
    found = {}
    for name, surface in surfaces.items():
        if surface.frame not in meshes:
            continue
        normals, distance = _nearest(meshes[surface.frame], surface.points)
        if np.median((normals * surface.normals).sum(axis=1)) < -0.3:
            found[name] = (
                f"expected normals that point out of the mesh of {surface.frame!r}, got into it: turn its pose, or "
                "negate them"
            )
        elif distance.max() > 0.015:
            found[name] = (
                f"expected taxels within 15 mm of the mesh of {surface.frame!r}, got taxel {distance.argmax()} "
                f"{1000 * distance.max():.3g} mm off: is its pose right?"
            )
    return found


def _nearest(mesh: LinkMesh, points: Array) -> tuple[Array, Array]:
    """Returns (n, 3) the normals of a mesh at the places nearest to points (n, 3), and their distances (n,) [m]."""
    import trimesh  # takes long to load, and most layouts have normals

    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    _, distance, face = trimesh.proximity.closest_point_naive(shape, points)  # type: ignore[no-untyped-call]
    return np.asarray(shape.face_normals[face]), distance
