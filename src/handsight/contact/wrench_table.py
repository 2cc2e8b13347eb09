"""Wrench tables: CSV with a header, or JSON lines, read in chunks: a file may exceed the memory."""

import csv
import json
import math
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import chain, count, islice, repeat
from pathlib import Path
from typing import Any, TextIO

import msgspec
import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidFile
from handsight.files import stream_name
from handsight.msgspec_errors import explain, field_name

Place = str | os.PathLike[str] | TextIO

NUMBERS = ("fx", "fy", "fz", "tx", "ty", "tz")
LABELS = ("stamp", "finger")
CHUNK = 8192
"""Rows at a time."""
LONGEST = 100_000
"""Characters of a line."""
BOUND = f"expected newtons and newton metres within {checks.MAX_LOAD:g}"
WRENCHES_HELP = """\
Wrenches: CSV with a header, columns in any order
  fx, fy, fz  force of the object on the tip [N]
  tx, ty, tz  torque of the object on the tip [N m], about the point the force is given at
  stamp       optional; copied as it is
  finger      optional; copied as it is
or JSON, one object a line: {"stamp": 1.5, "finger": "ff", "force": [fx, fy, fz], "torque": [tx, ty, tz]}.
Text is UTF-8; a byte order mark at its beginning, as spreadsheets write it, is dropped.
An empty number (CSV), null (JSON) or NaN is a reading that is missing: its row is answered "invalid".
"""

_Row = tuple[dict[str, Any], list[float]]
"""Labels and six numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchRows:
    """Some consecutive rows of a wrench table."""

    labels: list[dict[str, Any]]
    """For each row its `stamp` and `finger`, those that the table has; text from CSV."""
    forces: Array
    """(n, 3) [N]; NaN where the table has no number."""
    torques: Array
    """(n, 3) [N m]; NaN where the table has no number."""


def read_wrenches(source: Place, *, chunk: int = CHUNK) -> Iterator[WrenchRows]:
    """The table's rows in order, `chunk` at a time; CSV or JSON lines, told apart by the first character.

    Blank lines are no rows. Raises InvalidFile naming the file, the line, the column, what was expected and what came;
    also for a file without a row.
    """
    name = str(source) if isinstance(source, str | os.PathLike) else stream_name(source)
    empty = True
    try:
        with _source(source) as file:
            rows = _rows(_lines(file, name), name)
            while some := list(islice(rows, chunk)):
                empty = False
                numbers = np.array([numbers for _, numbers in some], dtype=np.float64)
                yield WrenchRows([labels for labels, _ in some], numbers[:, :3], numbers[:, 3:])
    except OSError as error:
        raise InvalidFile(f"{name}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise InvalidFile(f"{name}: expected UTF-8 text, got byte {error.object[error.start]:#04x}") from None
    if empty:
        raise InvalidFile(f"{name}: expected at least one wrench, got an empty table")


def _lines(file: TextIO, name: str) -> Iterator[str]:
    """The lines, without a byte order mark before the first."""
    mark = "\ufeff"
    for i in count(1):
        line = file.readline(LONGEST + 1)
        if len(line) > LONGEST:
            raise InvalidFile(f"{name}: line {i}: expected at most {LONGEST} characters, got more")
        if not line:
            return
        yield line.removeprefix(mark)
        mark = ""


def _rows(lines: Iterator[str], name: str) -> Iterator[_Row]:
    """The rows of either format."""
    blank, first = 0, ""
    for first in lines:
        if first.strip():
            break
        blank += 1
    parse = _json_rows if first.lstrip().startswith("{") else _csv_rows
    return parse(chain(repeat("\n", blank), [first], lines), name)


def _csv_rows(lines: Iterator[str], name: str) -> Iterator[_Row]:
    reader = csv.reader(lines, strict=True)
    try:
        header: list[str] = []
        for cells in reader:
            if len(cells) < 2 and not "".join(cells).strip():
                continue
            where = f"{name}: line {reader.line_num}"
            if not header:
                header = _header(cells, where)
                continue
            if len(cells) != len(header):
                raise InvalidFile(f"{where}: expected {len(header)} columns as the header, got {len(cells)}")
            row = dict(zip(header, cells, strict=True))
            labels = {column: row[column] for column in LABELS if column in row}
            yield labels, [_number(row[column], where, column) for column in NUMBERS]
    except csv.Error as error:
        raise InvalidFile(f"{name}: line {reader.line_num}: expected CSV, got {error}") from None


def _header(cells: list[str], where: str) -> list[str]:
    """The columns' names, each known, none twice, none missing."""
    header = [cell.strip().lower() for cell in cells]
    known = (*LABELS, *NUMBERS)
    for column in header:
        if column not in known:
            raise InvalidFile(f"{where}: expected a header of {', '.join(known)}, got column {column[:40]!r}")
        if header.count(column) > 1:
            raise InvalidFile(f"{where}: expected column {column} once, got it {header.count(column)} times")
    missing = [column for column in NUMBERS if column not in header]
    if missing:
        raise InvalidFile(f"{where}: expected columns {', '.join(NUMBERS)}, missing {', '.join(missing)}")
    return header


def _number(cell: str, where: str, column: str) -> float:
    if not cell or cell.isspace():
        return math.nan
    try:
        number = float(cell.replace("_", "no number"))  # Python's own numbers may have underscores
    except ValueError:
        came = checks.brief(cell)
        raise InvalidFile(f"{where}, column {column}: expected a number, got {came!r}") from None
    if _too_strong(number):
        raise InvalidFile(f"{where}, column {column}: {BOUND}, got {number:g}")
    return number


def _too_strong(number: float) -> bool:
    """Infinity is a reading that is missing, as NaN is."""
    return not -checks.MAX_LOAD <= number <= checks.MAX_LOAD and math.isfinite(number)


class _Line(msgspec.Struct, forbid_unknown_fields=True):
    """A wrench as JSON; null is a reading that is missing."""

    force: tuple[float | None, float | None, float | None]
    torque: tuple[float | None, float | None, float | None]
    stamp: float | str | None = None
    finger: float | str | None = None

    def __post_init__(self) -> None:
        for key, label in (("stamp", self.stamp), ("finger", self.finger)):
            if isinstance(label, str) and not _encodable(label):
                raise ValueError(f"{key}: expected a text, got half a character in {label[:40]!r}")
            if isinstance(label, float) and not math.isfinite(label):
                raise ValueError(f"{key}: expected a finite number, got {label}")
        for key, vector in (("force", self.force), ("torque", self.torque)):
            for number in vector:
                if number is not None and _too_strong(number):
                    raise ValueError(f"{key}: {BOUND}, got {number:g}")


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _json_rows(lines: Iterator[str], name: str) -> Iterator[_Row]:
    first: dict[str, Any] | None = None
    for i, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{name}: line {i}"
        try:
            row = json.loads(line)
            wrench = msgspec.convert(row, _Line)
        except msgspec.ValidationError as error:
            field, said = explain(error, _Line, row)
            raise InvalidFile(f"{where}: {field_name(field) or 'wrench'}: {said}") from None
        except (ValueError, RecursionError) as error:
            raise InvalidFile(f"{where}: expected a JSON object, got {error}") from None
        labels = {key: row[key] for key in LABELS if key in row}
        first = labels if first is None else first
        if labels.keys() != first.keys():
            came, expected = (", ".join(keys) or "neither" for keys in (labels, first))
            raise InvalidFile(f"{where}: expected the labels of the first line ({expected}), got {came}")
        yield labels, [math.nan if x is None else x for x in (*wrench.force, *wrench.torque)]


def _source(source: Place) -> AbstractContextManager[TextIO]:
    if isinstance(source, str | os.PathLike):
        return Path(source).open(encoding="utf-8", newline="")
    return nullcontext(source)
