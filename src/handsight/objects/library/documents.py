"""The two documents of a library, and the entries that they describe: the objects by number and name.

`models_info.json` is the BOP benchmark's: the diameter and the symmetries of each object, in millimetres.
https://github.com/thodan/bop_toolkit/blob/master/docs/bop_datasets_format.md
`handsight.json`, beside it, has the facts for which BOP has no keys: name, mass, centre of mass, licence, source, and
the checksum of the model's file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidFile, InvalidInput
from handsight.msgspec_errors import Form, decode, decode_object
from handsight.objects.files.read import LARGEST_FILE
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import MAX_ROTATIONS, Symmetries, about, closed_group, nearest

METRES = 1e-3  # metres in the unit of a BOP library's files
TOLERANCE = 0.01
"""Rotation matrices are meant to be equal if their entries differ by less, and shifts if they differ by less than this
part of the diameter, because files have few digits."""
SURFACE_TOLERANCE = 0.1
"""How far a symmetry may move a point off the surface [diameters]: BOP searches symmetries with this tolerance (Hodaň
et al. 2020), so that details do not break them. Ones of the YCB scans are up to 0.054 off, false ones mostly more."""

Vector = tuple[float, float, float]
Matrix = tuple[
    float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float,
]  # fmt: skip
"""4 x 4, row by row."""


class ContinuousAxis(msgspec.Struct):
    """Line about which every turn is a symmetry."""

    axis: Vector
    offset: Vector = (0.0, 0.0, 0.0)  # a point on the line [mm]


class Info(msgspec.Struct):
    """Entry of `models_info.json` for an object; other keys are ignored."""

    diameter: Annotated[float, msgspec.Meta(ge=1e-4, le=1e10)]  # [mm]
    size_x: float | None = None
    size_y: float | None = None
    size_z: float | None = None
    symmetries_discrete: list[Matrix] = []
    symmetries_continuous: list[ContinuousAxis] = []


def info_of(model: ObjectModel) -> dict[str, object]:
    """Returns the values of `models_info.json` for an object."""
    low, high = model.bounds_object / METRES
    symmetries = model.symmetries
    turns = symmetries.rotations[1:].copy()
    turns[:, :3, 3] /= METRES
    return {
        "diameter": model.diameter / METRES,
        **dict(zip(("min_x", "min_y", "min_z"), low.tolist(), strict=True)),
        **dict(zip(("size_x", "size_y", "size_z"), (high - low).tolist(), strict=True)),
        "symmetries_discrete": turns.reshape(-1, 16).tolist(),
        "symmetries_continuous": [
            {"axis": axis.tolist(), "offset": (point / METRES).tolist()} for point, axis in symmetries.axes
        ],
    }


def symmetries_of(info: Info) -> Symmetries:
    """Returns the symmetries that rounded numbers mean, as an exact group; raises InvalidInput where they form none."""
    near = TOLERANCE * info.diameter * METRES
    turns = []
    for k, matrix in enumerate(info.symmetries_discrete):
        name = f"symmetries_discrete[{k}]"
        given = np.array(matrix).reshape(4, 4)
        shift = checks.position(METRES * given[:3, 3], name, (3,))
        R = _nearest_rotations(given[:3, :3])
        exact = se3.compose(R, given[:3, 3])
        if not np.abs(exact - given).max() < TOLERANCE or (exact[3] != given[3]).any():
            raise InvalidInput(f"{name}: expected a rigid transform, got {checks.brief(given)}")
        turns.append(se3.compose(R, shift))
    lines = []
    for k, line in enumerate(info.symmetries_continuous):
        offset = METRES * np.array(line.offset)
        name = f"symmetries_continuous[{k}].offset"
        lines.append((checks.position(offset, name, (3,)), line.axis))
    if len(turns) > MAX_ROTATIONS:
        raise InvalidInput(f"symmetries_discrete: expected at most {MAX_ROTATIONS}, got {len(turns)}")
    if not lines:
        return Symmetries(rotations=_exact_group(turns, near))
    symmetries = Symmetries(lines)
    if not turns:
        return symmetries
    given = np.array(turns)
    point, axis = symmetries.axes[0]
    swapped = given[axis @ given[:, :3, :3] @ axis < 0]
    if len(swapped) and not symmetries.round:  # half turns swap the axis' ends about a middle
        along = (se3.apply(swapped, point[None])[:, 0] - point) @ axis
        middle = np.mean(point + along[:, None] * axis / 2, axis=0)
        half_turn = about(middle, np.pi * se3.perpendicular(axis))
        symmetries = Symmetries([(middle, axis)], half_turn[None])
    left = nearest(symmetries, given, np.eye(4), METRES * info.diameter)
    off = np.maximum(
        np.abs(left[:, :3, :3] - np.eye(3)).max(axis=(1, 2)) / TOLERANCE,
        np.linalg.norm(left[:, :3, 3], axis=1) / near,
    )
    if off.max() > 1:
        k = int(off.argmax())
        raise InvalidInput(
            f"symmetries_discrete[{k}]: expected a turn of the continuous axis, or one that swaps its ends"
        )
    return symmetries


def _nearest_rotations(M: Array) -> Array:
    """Returns the rotations (..., 3, 3) nearest to matrices (..., 3, 3)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., -1] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def _exact_group(turns: list[Array], near: float) -> Array:
    """Returns the finite group (k, 4, 4) that inexact turns generate, exact to rounding; raises InvalidInput.

    The turns are multiplied until no product is new; transforms that differ by less than `TOLERANCE` and `near` [m]
    are the same. The mean of R(gh) R(h)⁻¹ over all h is then closer to an exact group's R(g) than R(g) itself, and
    repeating this squares the error each time (Grove, Karcher, Ruh 1974). The point that all turns leave in place is
    the mean of the points to which they take the origin.
    """

    def distance(T: Array, others: Array) -> Array:
        differences = np.abs(others - T)
        rotation = differences[:, :3, :3].max(axis=(1, 2)) / TOLERANCE
        return np.asarray(np.maximum(rotation, differences[:, :3, 3].max(axis=1) / near))

    group = closed_group(turns, distance, "symmetries_discrete")
    products = group[:, None] @ group
    gaps = np.array([[distance(product, group) for product in row] for row in products])
    table = gaps.argmin(axis=-1)
    R = group[:, :3, :3]
    for _ in range(6):
        R = _nearest_rotations(np.einsum("ghij,hkj->gik", R[table], R))
    center = group[:, :3, 3].mean(axis=0)
    exact = se3.compose(R, center - R @ center)
    if max(distance(T, one[None])[0] for T, one in zip(group, exact, strict=True)) > 1:
        raise InvalidInput("symmetries_discrete: expected turns about one point, got others")
    return exact


INFO = "models_info.json"
FACTS = "handsight.json"
LARGEST_DOCUMENT = 20_000_000  # the largest number of bytes of a document: about ten thousand objects
MAX_NUMBER = 999_999_999  # the largest number of an object
VERSION = 1  # version of the format of `handsight.json`


class NoLibrary(InvalidFile):
    """There is no library in a folder or at a URL."""


class Facts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """What is known of an object besides its surface; impossible values raise InvalidInput."""

    name: str
    """Letters, digits, blanks and `_.+-`, the first a letter or a digit, not all of them digits."""
    mass: float | None = None
    """[kg]"""
    center_of_mass: tuple[float, float, float] | None = None
    """In the object's frame [m]."""
    sigma_center_of_mass: float | None = None
    """One standard deviation of the centre of mass per axis [m]."""
    origin_file: tuple[float, float, float] | None = None
    """Where the model's origin is in the file that was added, whose frame it left [m]; None: in the file's origin."""
    sigma_scale: float | None = None
    """One standard deviation of the model's size, as a share of it; None where the size is known."""
    licence: str = ""
    source: str = ""
    """Where the model comes from."""

    def __post_init__(self) -> None:
        # A name must be harmless in a path and on a terminal, and no number, because objects are found by number too.
        name = r"(?!(\d+|obj_\d{6,})$)\w([\w .+-]{0,98}[\w.+-])?"
        if not isinstance(self.name, str) or not re.fullmatch(name, self.name):
            raise InvalidInput(
                "name: expected up to 100 letters, digits, blanks and _.+-, the first a letter or a digit, the last no "
                f"blank, and no number, got {checks.brief(self.name)!r}"
            )
        if self.mass is not None and checks.positive(self.mass, "mass") > 100:
            raise InvalidInput(f"mass: expected kilograms, got {self.mass:g} (grams?)")
        if self.center_of_mass is not None:
            checks.in_reach(self.center_of_mass, "center_of_mass", (3,))
        if self.sigma_center_of_mass is not None:
            checks.sigma(self.sigma_center_of_mass, "sigma_center_of_mass")
            if self.center_of_mass is None:
                raise InvalidInput("sigma_center_of_mass: expected beside center_of_mass only, got it alone")
        if self.origin_file is not None:
            checks.finite(self.origin_file, "origin_file", (3,))
        if self.sigma_scale is not None and checks.positive(self.sigma_scale, "sigma_scale") > 1:
            raise InvalidInput(f"sigma_scale: expected a share of the size, got {self.sigma_scale:g}")
        for key, value in (("licence", self.licence), ("source", self.source)):
            if not isinstance(value, str) or len(value) > 500:
                raise InvalidInput(
                    f"{key}: expected a text of up to 500 characters, got {checks.brief(value)}"
                )


class Record(Facts, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Facts of an object, and the size [bytes] and SHA-256 of its model's file."""

    sha256: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
    bytes: Annotated[int, msgspec.Meta(ge=0, le=LARGEST_FILE)]


class FactsDocument(msgspec.Struct, forbid_unknown_fields=True):
    """Content of `handsight.json`."""

    version: int
    objects: dict[str, Record]


Documents = tuple[bytes, bytes | None]
"""The contents of `models_info.json` and of `handsight.json`, which a folder of BOP does not have."""


@dataclass(frozen=True, eq=False)
class Entry:
    """Object of a library."""

    number: int
    """BOP's `obj_id`."""
    name: str
    """The name under which the object was added; `obj_000005` for one without a name."""
    facts: Record | None
    """Mass, licence and so on, size and checksum of the model's file; None for an object that BOP alone describes."""
    info: Info
    place: str
    """Folder or URL of the library."""

    @property
    def file(self) -> str:
        """The name of the model's file."""
        return f"obj_{self.number:06d}.ply"

    def is_called(self, name: str) -> bool:
        """Returns whether a name is the object's name, its number, or its file's name without the ending."""
        return name in (self.name, str(self.number), self.file.removesuffix(".ply"))

    @property
    def diameter(self) -> float:
        """Largest distance between two surface points [m]."""
        return METRES * self.info.diameter

    @property
    def size(self) -> tuple[float, float, float] | None:
        """Extent along x, y, z [m]; None where the documents do not state it."""
        info = self.info
        if info.size_x is None or info.size_y is None or info.size_z is None:
            return None
        return METRES * info.size_x, METRES * info.size_y, METRES * info.size_z

    @cached_property
    def symmetries(self) -> Symmetries:
        """The declared symmetries; raises InvalidFile where they form no group."""
        try:
            return symmetries_of(self.info)
        except InvalidInput as error:
            raise InvalidFile(f"{self.place}: {INFO}: {self.number}.{error}") from None


def entries(documents: Documents, place: str) -> tuple[Entry, ...]:
    """Returns the objects in the order of their numbers; raises InvalidFile, whose message begins with the place."""
    where = f"{place}: {INFO}"
    there = f"{place}: {FACTS}"
    info, facts = documents
    infos = _by_number(decode(info, dict[str, Info], where), where)
    records: dict[int, Record] = {}
    if facts is not None:
        version = decode_object(facts, there).get("version")
        if version != VERSION:  # another version may have other keys
            raise InvalidFile(f"{there}: version: expected {VERSION}, got {checks.brief(version)}")
        records = _by_number(decode(facts, FactsDocument, there).objects, there)
    entries = list[Entry]()
    owners = dict[str, int]()
    for number in sorted(infos):
        record = records.get(number)
        name = record.name if record else f"obj_{number:06d}"  # `Facts` refuses such a name
        if owners.setdefault(name, number) != number:
            raise InvalidFile(
                f"{there}: objects.{number}.name: expected a name of its own, got {name!r}, which is that of object "
                f"{owners[name]}"
            )
        entries.append(Entry(number=number, name=name, facts=record, info=infos[number], place=place))
    return tuple(entries)


def _by_number(values: Mapping[str, Form], where: str) -> dict[int, Form]:
    """Returns the values by their keys as numbers; raises InvalidFile for a key that is no number. Numbers become the
    names of files, so that another key could name any file."""
    found: dict[int, Form] = {}
    for key, value in values.items():
        if not re.fullmatch("0|[1-9][0-9]{0,8}", key):
            raise InvalidFile(f"{where}: expected numbers of objects as keys, got {checks.brief(key)!r}")
        found[int(key)] = value
    return found
