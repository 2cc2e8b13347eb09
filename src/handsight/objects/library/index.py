"""What a library has, as its two documents say it: the objects in them by number and name."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from handsight import checks
from handsight.errors import InvalidFile, InvalidInput
from handsight.msgspec_errors import Form, decode, decode_object
from handsight.objects.library.bop import BOP_SYMMETRIES, Info, symmetries_of
from handsight.objects.library.facts import FACTS_LIMITS, Document, Record
from handsight.objects.symmetry import Symmetries

INFO, FACTS = "models_info.json", "handsight.json"
LARGEST_DOCUMENT = 20_000_000
"""Bytes; what is known of ten thousand objects."""
LARGEST_NUMBER = 10**9


class NoLibrary(InvalidFile):
    """A `NoLibrary` is a folder or a URL without one."""


class Documents(NamedTuple):
    """`Documents` are both, as they lie there."""

    info: bytes
    facts: bytes | None
    """None: a BOP folder of somebody else's."""


@dataclass(frozen=True, eq=False)
class Entry:
    """An `Entry` is an object of a library."""

    number: int
    """BOP's `obj_id`."""
    name: str
    """As it was added; `obj_000005` where nobody has named it."""
    facts: Record | None
    """Mass, licence, ... and what its model's file must be; None: a BOP folder of somebody else's."""
    info: Info
    place: str

    @property
    def file(self) -> str:
        """The name of its model's file."""
        return f"obj_{self.number:06d}.ply"

    @property
    def diameter(self) -> float:
        """Largest distance between two surface points [m]."""
        return BOP_SYMMETRIES.metres * self.info.diameter

    @property
    def size(self) -> tuple[float, float, float] | None:
        """Along x, y, z [m]; None where the documents do not say."""
        x, y, z = self.info.size_x, self.info.size_y, self.info.size_z
        return (
            None
            if x is None or y is None or z is None
            else (BOP_SYMMETRIES.metres * x, BOP_SYMMETRIES.metres * y, BOP_SYMMETRIES.metres * z)
        )

    @cached_property
    def symmetries(self) -> Symmetries:
        """Those declared; raises InvalidFile where they are none."""
        try:
            return symmetries_of(self.info)
        except InvalidInput as error:
            raise InvalidFile(f"{self.place}: {INFO}: {self.number}.{error}") from None


def entries(documents: Documents, place: str) -> tuple[Entry, ...]:
    """Returns the objects by their numbers; raises InvalidFile, which begins with the place."""
    where, there = f"{place}: {INFO}", f"{place}: {FACTS}"
    infos = _by_number(decode(documents.info, dict[str, Info], where), where)
    records: dict[int, Record] = {}
    if documents.facts is not None:
        records = _by_number(_records(documents.facts, there), there)
    entries, owners = list[Entry](), dict[str, int]()
    for number in sorted(infos):
        record = records.get(number)
        name = record.name if record else f"obj_{number:06d}"  # which no name can be
        entry = Entry(number=number, name=name, facts=record, info=infos[number], place=place)
        if entry.name in owners:
            owner = owners[entry.name]
            message = f"expected a name of its own, got {entry.name!r}, which is that of object {owner}"
            raise InvalidFile(f"{there}: objects.{number}.name: {message}")
        owners[entry.name] = number
        entries.append(entry)
    return tuple(entries)


def _records(data: bytes, where: str) -> dict[str, Record]:
    version = decode_object(data, where).get("version")
    if version != FACTS_LIMITS.version:
        raise InvalidFile(f"{where}: version: expected {FACTS_LIMITS.version}, got {checks.brief(version)}")
    return decode(data, Document, where).objects


def _by_number(of: Mapping[str, Form], where: str) -> dict[int, Form]:
    found: dict[int, Form] = {}
    for key, value in of.items():
        # Nothing but a number becomes the name of a file.
        if not (
            key.isascii() and key.isdecimal() and str(int(key[:10])) == key and int(key) < LARGEST_NUMBER
        ):
            raise InvalidFile(f"{where}: expected numbers of objects as keys, got {checks.brief(key)!r}")
        found[int(key)] = value
    return found
