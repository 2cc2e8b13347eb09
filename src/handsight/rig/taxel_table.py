"""Makers' tables of taxels: CSV with or without names of columns, and JSON or YAML with a row or an entry for each."""

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from handsight.errors import InvalidInput, needing
from handsight.files import read_bytes

MAX_BYTES = 1 << 20
UNITS = {"m": 1.0, "mm": 1e-3}
"""By its name, a unit of lengths [m]."""
AXIS = re.compile(r"(?:p|pos|position|point|coord)?[_ .]?([xyz])(?:[_ ]?[\[(]?(mm|m)[\])]?)?")
"""Name of a coordinate's column, or key, in small letters, with the unit that some have."""
NORMAL = re.compile(r"(?:n|normal|norm)[_ .]?([xyz])")
X_AXIS = re.compile(r"(?:a|x_?axis|tangent)[_ .]?([xyz])")
POINT_KEYS = "position", "pos", "point", "xyz", "coordinates", "center", "centre"
NORMAL_KEYS = "normal", "n"
LARGEST = 0.5
"""A table that reaches farther is not in metres [m]."""
DEEPEST = 4
"""Mappings within mappings in which a table is searched."""


class TaxelTable(NamedTuple):
    """The rows of a table, and their unit where it says one."""

    rows: list[list[float]]
    """Of each taxel x, y, z, then its normal, then its own x, as far as the table has them."""
    unit: str | None
    """As `UNITS` has it; None: not stated."""


def read_table(path: Path) -> TaxelTable:
    """Returns the table in a file; raises InvalidInput for a file that has none, or several."""
    text = read_bytes(path, MAX_BYTES, path.name).decode("utf-8-sig", errors="replace")
    kind = path.suffix.lower()
    try:
        if kind in (".json", ".yaml", ".yml"):
            return _of_document(_parsed(text, kind), path.name)
        return _of_csv(text)
    except (ValueError, TypeError, RecursionError, csv.Error) as error:
        expected = "expected numbers in CSV, JSON or YAML"
        raise InvalidInput(f"{path.name}: {expected}, got other text ({str(error)[:80]})") from None


def _parsed(text: str, kind: str) -> object:
    """Returns a JSON or YAML document; raises ValueError, MissingExtra."""
    if kind == ".json":
        return json.loads(text)
    with needing("YAML files need ruamel.yaml", "robot"):
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise ValueError(str(error).splitlines()[0]) from None


def _of_csv(text: str) -> TaxelTable:
    """Returns the table of a CSV file; columns without a coordinate's name, such as a taxel's, are left out."""
    first = text.lstrip().splitlines()[0] if text.strip() else ""
    delimiter = next((each for each in ";\t" if each in first), ",")
    lines = [[cell.strip() for cell in line] for line in csv.reader(text.splitlines(), delimiter=delimiter)]
    lines = [line for line in lines if any(line) and not line[0].startswith("#")]
    if not lines:
        return TaxelTable([], None)
    columns, unit = _columns(lines[0])
    if columns:
        return TaxelTable([[float(line[k]) for k in columns] for line in lines[1:]], unit)
    if not any(map(_is_number, lines[0])):
        lines = lines[1:]
    named = bool(lines) and not any(_is_number(line[0]) for line in lines)
    rows = [[float(cell) for cell in line[named:]] for line in lines]
    numbers = [row[0] for row in rows]
    counted = any(numbers == list(range(first, first + len(rows))) for first in (0, 1))
    if counted and len(rows) > 1 and all(len(row) % 3 == 1 for row in rows):
        rows = [row[1:] for row in rows]
    return TaxelTable(rows, None)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _columns(names: Sequence[str]) -> tuple[list[int], str | None]:
    """Returns the places of x, y, z, of a normal and of an x axis among names, and the unit; none without x, y, z."""
    small = [str(name).strip().lower() for name in names]
    found = list[int]()
    unit = None
    for pattern in (AXIS, NORMAL, X_AXIS):
        matches = {
            match[1]: k for k, name in reversed([*enumerate(small)]) if (match := pattern.fullmatch(name))
        }
        if len(matches) < 3:
            break
        if pattern is AXIS:
            match = AXIS.fullmatch(small[matches["x"]])
            unit = match[2] if match else None
        found += [matches[axis] for axis in "xyz"]
    return found, unit


def _of_document(document: object, name: str) -> TaxelTable:
    """Returns the only table in a document; raises InvalidInput where it has none, or several."""
    found = list(_tables(document, ""))
    if len(found) != 1:
        came = ", ".join(place or "one" for place, _ in found[:12]) or "none"
        raise InvalidInput(f"{name}: expected one table of taxels with x, y, z, got {came}")
    table = found[0][1]
    stated = document.get("unit", document.get("units")) if isinstance(document, dict) else None
    if table.unit is None and stated in UNITS:
        return table._replace(unit=stated)
    return table


def _tables(value: object, place: str, depth: int = 0) -> Iterator[tuple[str, TaxelTable]]:
    """Yields the tables in a part of a document, with their places there."""
    entries = list(value.values()) if isinstance(value, dict) else value
    if isinstance(entries, list) and entries:
        rows = [_row(entry) for entry in entries]
        if all(rows):
            known = [row for row in rows if row is not None]
            yield place, TaxelTable([numbers for numbers, _ in known], known[0][1])
            return
    if isinstance(value, dict) and depth < DEEPEST:
        for key, part in value.items():
            yield from _tables(part, f"{place}.{key}".removeprefix("."), depth + 1)


def _row(entry: object) -> tuple[list[float], str | None] | None:
    """Returns the numbers of a taxel's entry, a list or a mapping, and their unit; None: it is no entry."""
    if isinstance(entry, list):
        numbers = entry[1:] if entry and isinstance(entry[0], str) else entry
        if len(numbers) not in (3, 6, 9) or not all(isinstance(x, int | float) for x in numbers):
            return None
        return [float(x) for x in numbers], None
    if not isinstance(entry, Mapping):
        return None
    columns, unit = _columns(list(entry))
    values: list[Any] = list(entry.values())
    if columns:
        return [float(values[k]) for k in columns], unit
    parts = {str(key).lower(): part for key, part in entry.items()}
    point = next((_row(parts[key]) for key in POINT_KEYS if key in parts), None)
    normal = next((_row(parts[key]) for key in NORMAL_KEYS if key in parts), None)
    if point is None:
        return None
    return point[0] + (normal[0] if normal else []), point[1]


def in_metres(table: TaxelTable, said: str | None, name: str) -> list[list[float]]:
    """Returns the rows with positions in metres; `said`: the unit that the rig states. Raises InvalidInput."""
    if said is not None and table.unit is not None and said != table.unit:
        raise InvalidInput(f"unit: expected {table.unit}, as {name} says, got {said}")
    unit = said or table.unit
    if unit is None and (most := extent(table)) > LARGEST:
        raise InvalidInput(
            f"unit: expected mm beside it, as {name} states none and reaches over {most:g}, got none"
        )
    factor = UNITS[unit or "m"]
    return [[factor * x for x in row[:3]] + row[3:] for row in table.rows]


def extent(table: TaxelTable) -> float:
    """Returns how far the taxels are apart at most along an axis, in the table's unit."""
    rows = [row for row in table.rows if len(row) >= 3]
    return max((max(axis) - min(axis) for axis in zip(*(row[:3] for row in rows), strict=True)), default=0.0)
