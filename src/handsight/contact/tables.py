"""Tables of wrenches, as CSV or JSON lines, and tables of the contacts that are computed from them.

They are read and written in chunks, so that a table may be larger than the memory.
"""

import contextlib
import csv
import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterator
from itertools import chain, count, islice
from pathlib import Path
from typing import Literal, TextIO

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.contact.contact import REASON_NAMES, ContactBatch
from handsight.contact.fingertips import Fingertip
from handsight.contact.sensing import SIGMA_FORCE, SIGMA_TORQUE, contacts_from_wrenches
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import check_not_overwritten, stream_name, text_file, write_errors
from handsight.msgspec_errors import explain, field_name

Place = str | os.PathLike[str] | TextIO
Format = Literal["csv", "jsonl"]
Labels = dict[str, object]

NUMBERS, LABELS = ("fx", "fy", "fz", "tx", "ty", "tz"), ("stamp", "finger")  # columns of a CSV of wrenches
COLUMNS = (
    *("reason", "x", "y", "z", "nx", "ny", "nz", "force_normal"),
    *("force_tangential_x", "force_tangential_y", "force_tangential_z", "torque"),
    *("sigma_x", "sigma_y", "sigma_z", "sigma_normal"),
)
"""Columns of a CSV of contacts, after `stamp` and `finger` where the wrenches have them."""
COLUMNS_HELP = """\
Wrenches: CSV with a header, columns in any order
  fx, fy, fz  force of the object on the tip [N]
  tx, ty, tz  torque of the object on the tip [N m], about the point the force is given at
  stamp       optional; copied as it is
  finger      optional; copied as it is
or JSON, one object a line: {"stamp": 1.5, "finger": "ff", "force": [fx, fy, fz], "torque": [tx, ty, tz]}.
Text is UTF-8; a byte order mark at its beginning, as spreadsheets write it, is dropped.
An empty number (CSV), null (JSON) or NaN is a reading that is missing: its row is answered "invalid".

Contacts: one row for each wrench, in order, all in the frame of the tip's surface
  stamp, finger               as in the wrenches
  reason                      contact, or why there is none: free (weaker than min_force), off_cap,
                              beyond_friction, invalid (a missing reading)
  x, y, z                     where the object touches the tip [m]
  nx, ny, nz                  the object's outward normal there, into the tip
  force_normal                along the normal [N]
  force_tangential_x, _y, _z  the rest of the force [N]
  torque                      local torque about the normal [N m]
  sigma_x, sigma_y, sigma_z   standard deviation of x, y, z from the sensor's noise [m]
  sigma_normal                of the normal's angle, per tangent axis [rad]
Without a contact the numbers are left empty. CSV has nine digits. As JSON lines, in full precision: stamp,
finger, reason, and for a contact point, normal, force_normal, force_tangential, torque and covariance (6 x 6
of point and normal).
"""


def read_wrenches(source: Place) -> Iterator[tuple[list[Labels], Array]]:
    """Yields the rows of a table of wrenches, 8192 at a time; its first character tells CSV from JSON lines.

    Of each row its labels, `stamp` and `finger` if the table has them (text, from CSV), and of all rows forces [N] and
    torques [N m] (n, 6), NaN where there is no number. Blank lines are skipped. Raises an InvalidFile that names the
    file, the line, the column, what was expected and what came; also for a table without rows.
    """
    name = str(source) if isinstance(source, str | os.PathLike) else stream_name(source)
    empty = True
    try:
        with contextlib.ExitStack() as stack:
            if isinstance(source, str | os.PathLike):
                source = stack.enter_context(Path(source).open(encoding="utf-8", newline=""))
            lines = _lines(source, name)
            head = [next(lines, "").removeprefix("\ufeff")]
            while head[-1].isspace():
                head.append(next(lines, ""))
            parse = _json_rows if head[-1].lstrip().startswith("{") else _csv_rows
            rows = parse(chain(head, lines), name)
            while some := list(islice(rows, 8192)):
                empty = False
                labels, numbers = zip(*some, strict=True)
                yield list(labels), np.array(numbers, dtype=np.float64)
    except OSError as error:
        raise InvalidFile(f"{name}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise InvalidFile(f"{name}: expected UTF-8 text, got byte {error.object[error.start]:#04x}") from None
    if empty:
        raise InvalidFile(f"{name}: expected at least one wrench, got an empty table")


def _lines(file: TextIO, name: str) -> Iterator[str]:
    """Yields the lines of a file that may have no line breaks, such as a device; raises InvalidFile for a long line."""
    longest = 100_000
    for number in count(1):
        line = file.readline(longest + 1)
        if len(line) > longest:
            raise InvalidFile(f"{name}: line {number}: expected at most {longest} characters, got more")
        if not line:
            return
        yield line


def _csv_rows(lines: Iterator[str], name: str) -> Iterator[tuple[Labels, list[float]]]:
    """Yields the labels and the six numbers of each row."""
    reader = csv.reader(lines, strict=True)
    known = (*LABELS, *NUMBERS)
    rows = (cells for cells in reader if len(cells) > 1 or "".join(cells).strip())
    try:
        header = [cell.strip().lower() for cell in next(rows, NUMBERS)]
        where = f"{name}: line {reader.line_num}"
        if len(set(header)) < len(header) or not set(NUMBERS) <= set(header) <= set(known):
            raise InvalidFile(
                f"{where}: expected columns {', '.join(NUMBERS)}, and {', '.join(LABELS)} or not, each once, got "
                f"{', '.join(header):.200}"
            )
        for cells in rows:
            where = f"{name}: line {reader.line_num}"
            if len(cells) != len(header):
                raise InvalidFile(f"{where}: expected {len(header)} columns as the header, got {len(cells)}")
            row = dict(zip(header, cells, strict=True))
            labels: Labels = {column: row[column] for column in LABELS if column in row}
            yield labels, [_number(row[column], f"{where}, column {column}") for column in NUMBERS]
    except csv.Error as error:
        raise InvalidFile(f"{name}: line {reader.line_num}: expected CSV, got {error}") from None


def _number(cell: str, where: str) -> float:
    try:
        number = float(cell.strip().replace("_", "no number") or math.nan)  # float takes 1_0 for 10
    except ValueError:
        raise InvalidFile(f"{where}: expected a number, got {checks.brief(cell)!r}") from None
    if error := _load_error(number):
        raise InvalidFile(f"{where}: {error}")
    return number


def _load_error(number: float) -> str | None:
    """Returns the message about a number that is too large; None otherwise, and for infinity or NaN: no reading."""
    if abs(number) <= checks.MAX_LOAD or not math.isfinite(number):
        return None
    return f"expected newtons and newton metres within {checks.MAX_LOAD:g}, got {number:g}"


class _Wrench(msgspec.Struct, forbid_unknown_fields=True):
    """Wrench as JSON; null stands for a missing reading."""

    force: tuple[float | None, float | None, float | None]
    torque: tuple[float | None, float | None, float | None]
    stamp: float | str | None = None
    finger: float | str | None = None

    def __post_init__(self) -> None:
        for key, label in (("stamp", self.stamp), ("finger", self.finger)):
            if isinstance(label, str) and re.search("[\ud800-\udfff]", label):
                raise ValueError(f"{key}: expected a text, got half a character in {label[:40]!r}")
            if isinstance(label, float) and not math.isfinite(label):
                raise ValueError(f"{key}: expected a finite number, got {label}")
        for key, vector in (("force", self.force), ("torque", self.torque)):
            for number in vector:
                if number is not None and (error := _load_error(number)):
                    raise ValueError(f"{key}: {error}")


def _json_rows(lines: Iterator[str], name: str) -> Iterator[tuple[Labels, list[float]]]:
    """Yields the labels and the six numbers of each row."""
    first: Labels | None = None
    for i, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{name}: line {i}"
        try:
            row = json.loads(line)
            wrench = msgspec.convert(row, _Wrench)
        except msgspec.ValidationError:
            field, message = explain(_Wrench, row)
            raise InvalidFile(f"{where}: {field_name(field) or 'wrench'}: {message}") from None
        except (ValueError, RecursionError) as error:
            raise InvalidFile(f"{where}: expected a JSON object, got {error}") from None
        labels: Labels = {key: row[key] for key in LABELS if key in row}
        first = labels if first is None else first
        if labels.keys() != first.keys():
            raise InvalidFile(f"{where}: expected the labels of the first line, {[*first]}, got {[*labels]}")
        yield labels, [math.nan if x is None else x for x in (*wrench.force, *wrench.torque)]


def convert(
    source: Place,
    destination: Place,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
    format: Format | None = None,
) -> dict[str, int]:
    """Writes the contacts of a table of wrenches, and returns the number of rows of each reason.

    Both are paths or text streams, as `COLUMNS_HELP` describes them; sigmas as in `contact_from_wrench`. `format` None:
    JSON lines for a path that ends in .jsonl, .ndjson or .json, else CSV. A destination that is a file appears only
    when it is complete; it may not be the source. Raises an InvalidFile that names file and line.
    """
    if format is None:
        suffix = Path(destination).suffix if isinstance(destination, str | os.PathLike) else ""
        format = "jsonl" if suffix.lower() in (".jsonl", ".ndjson", ".json") else "csv"
    writers = {"csv": _write_csv, "jsonl": _write_json}
    if format not in writers:
        raise InvalidInput(f"format: expected one of {', '.join(writers)}, got {format!r}")
    check_not_overwritten(destination, "the contacts", source, "the wrenches")
    counts: Counter[int] = Counter()
    with _output(destination) as file:
        for i, (labels, numbers) in enumerate(read_wrenches(source)):
            batch = contacts_from_wrenches(
                numbers[:, :3], numbers[:, 3:], fingertip, sigma_force=sigma_force, sigma_torque=sigma_torque
            )
            if format == "csv" and i == 0:
                file.write(",".join([*labels[0], *COLUMNS]) + "\n")
            writers[format](file, labels, batch)
            counts.update(batch.reasons.tolist())
    return {name: counts[reason] for reason, name in enumerate(REASON_NAMES)}


def _write_csv(file: TextIO, labels: list[Labels], batch: ContactBatch) -> None:
    variances = np.diagonal(batch.covariances, axis1=1, axis2=2)
    loads = batch.forces_normal, batch.forces_tangential, batch.torques
    sigmas = np.sqrt(variances[:, :3]), np.sqrt(variances[:, 3:].sum(axis=1) / 2)
    numbers = np.column_stack([batch.points, batch.normals, *loads, *sigmas])
    contacts = iter((numbers + 0.0).tolist())  # no -0
    writer = csv.writer(file, lineterminator="\n")
    for row, reason in zip(labels, batch.reasons.tolist(), strict=True):
        cells = [""] * numbers.shape[1] if reason else [f"{number:.9g}" for number in next(contacts)]
        writer.writerow([*row.values(), REASON_NAMES[reason], *cells])


def _write_json(file: TextIO, labels: list[Labels], batch: ContactBatch) -> None:
    columns = ("point", "normal", "force_normal", "force_tangential", "torque", "covariance")
    values = (batch.points, batch.normals, batch.forces_normal, batch.forces_tangential, batch.torques)
    contacts = zip(*(column.tolist() for column in (*values, batch.covariances)), strict=True)
    encode = msgspec.json.Encoder().encode
    for label, reason in zip(labels, batch.reasons.tolist(), strict=True):
        row = {**label, "reason": REASON_NAMES[reason]}
        stamp = row.get("stamp")
        # A number that CSV gave as text keeps all its digits.
        if isinstance(stamp, str) and re.fullmatch(r"-?(0|[1-9]\d*)(\.\d+)?([eE][-+]?\d+)?", stamp.strip()):
            row["stamp"] = msgspec.Raw(stamp.strip().encode())
        if not reason:
            row.update(zip(columns, next(contacts), strict=True))
        file.write(encode(row).decode() + "\n")


@contextlib.contextmanager
def _output(destination: Place) -> Iterator[TextIO]:
    """Yields a stream to write to; a file gets its name only when it is complete. Raises NotWritten."""
    if not isinstance(destination, str | os.PathLike):
        with write_errors(stream_name(destination)):
            yield destination
            destination.flush()
        return
    with text_file(destination) as file:
        yield file
