"""Wrench table in, contact table out: a row for every row, in order."""

import csv
import os
import re
import secrets
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TextIO

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from handsight.checks import Array
from handsight.contact.contact import REASON_NAMES, ContactBatch
from handsight.contact.fingertips import Fingertip
from handsight.contact.sensing import SIGMA_FORCE, SIGMA_TORQUE, contacts_from_wrenches
from handsight.contact.wrench_table import WRENCHES_HELP, Place, WrenchRows, read_wrenches
from handsight.errors import InvalidInput
from handsight.files import check_not_overwritten, stream_name, write_errors

Format = Literal["csv", "jsonl"]

COLUMNS = (
    *("reason", "x", "y", "z", "nx", "ny", "nz", "force_normal"),
    *("force_tangential_x", "force_tangential_y", "force_tangential_z", "torque"),
    *("sigma_x", "sigma_y", "sigma_z", "sigma_normal"),
)
"""Of a CSV of contacts, after `stamp` and `finger` where the wrenches have them."""
KEYS = ("point", "normal", "force_normal", "force_tangential", "torque", "covariance")
"""Of a contact in JSON, after these and `reason`."""
COLUMNS_HELP = f"""\
{WRENCHES_HELP}
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

_JSON_NUMBER = re.compile(r"-?(?:0|[1-9]\d*)(?:\.\d+)?(?:[eE][-+]?\d+)?")


def convert(
    source: Place,
    destination: Place,
    fingertip: Fingertip,
    *,
    sigma_force: ArrayLike = SIGMA_FORCE,
    sigma_torque: ArrayLike = SIGMA_TORQUE,
    format: Format | None = None,
) -> dict[str, int]:
    """How many rows got each reason (all of them named), after writing the contacts of a table of wrenches.

    Paths or text streams, as `COLUMNS_HELP` says; sigmas as in `contact_from_wrench`. `format` None: JSON lines for a
    path that ends in .jsonl, .ndjson or .json, CSV for all else. A destination that is a file appears only when
    everything was read and written; it may not be the source. Raises InvalidFile naming file and line.
    """
    if format is None:
        suffix = Path(destination).suffix if isinstance(destination, str | os.PathLike) else ""
        format = "jsonl" if suffix.lower() in (".jsonl", ".ndjson", ".json") else "csv"
    writers = {"csv": _write_csv, "jsonl": _write_json}
    if format not in writers:
        raise InvalidInput(f"format: expected one of {', '.join(writers)}, got {format!r}")
    check_not_overwritten(destination, "the contacts", source, "the wrenches")
    counts: Counter[int] = Counter()
    sigmas = {"sigma_force": sigma_force, "sigma_torque": sigma_torque}
    with _destination(destination) as file:
        for i, rows in enumerate(read_wrenches(source)):
            batch = contacts_from_wrenches(rows.forces, rows.torques, fingertip, **sigmas)
            if format == "csv" and i == 0:
                file.write(",".join([*rows.labels[0], *COLUMNS]) + "\n")
            writers[format](file, rows, batch)
            counts.update(batch.reasons.tolist())
    return {name: counts[reason] for reason, name in enumerate(REASON_NAMES)}


def _write_csv(file: TextIO, rows: WrenchRows, batch: ContactBatch) -> None:
    variances = np.diagonal(batch.covariances, axis1=1, axis2=2)
    sigma_normal = np.sqrt(variances[:, 3:].sum(axis=1) / 2)
    pushes = (batch.forces_normal, _tangential(batch), batch.torques)
    numbers = np.column_stack([batch.points, batch.normals, *pushes, np.sqrt(variances[:, :3]), sigma_normal])
    contacts = iter((numbers + 0.0).tolist())  # no -0
    absent = [""] * numbers.shape[1]
    writer = csv.writer(file, lineterminator="\n")
    for labels, reason in zip(rows.labels, batch.reasons.tolist(), strict=True):
        cells = absent if reason else [f"{number:.9g}" for number in next(contacts)]
        writer.writerow([*labels.values(), REASON_NAMES[reason], *cells])


def _write_json(file: TextIO, rows: WrenchRows, batch: ContactBatch) -> None:
    pushes = (batch.forces_normal, _tangential(batch), batch.torques)
    columns = (batch.points, batch.normals, *pushes, batch.covariances)
    contacts = zip(*(column.tolist() for column in columns), strict=True)
    encode = msgspec.json.Encoder().encode
    for labels, reason in zip(rows.labels, batch.reasons.tolist(), strict=True):
        row = {key: _json_label(key, value) for key, value in labels.items()}
        row["reason"] = REASON_NAMES[reason]
        if not reason:
            row.update(zip(KEYS, next(contacts), strict=True))
        file.write(encode(row).decode() + "\n")


def _tangential(batch: ContactBatch) -> Array:
    """(k, 3) the forces' part in the tangent plane [N]."""
    return batch.forces - batch.forces_normal[:, None] * batch.normals


def _json_label(key: str, value: object) -> object:
    """A stamp that CSV gave as text, as a number with all its digits; anything else as it is."""
    if key == "stamp" and isinstance(value, str) and _JSON_NUMBER.fullmatch(value.strip()):
        return msgspec.Raw(value.strip().encode())
    return value


@contextmanager
def _destination(destination: Place) -> Iterator[TextIO]:
    """A stream to write to; a file gets its name only when all is well. Raises NotWritten."""
    if not isinstance(destination, str | os.PathLike):
        with write_errors(stream_name(destination)):
            yield destination
            destination.flush()
        return
    path = Path(os.path.realpath(destination))
    with write_errors(destination):
        if path.exists() and not path.is_file():
            with path.open("w", encoding="utf-8", newline="") as file:  # a pipe cannot be renamed onto
                yield file
        else:
            with _renamed(path) as file:
                yield file


@contextmanager
def _renamed(path: Path) -> Iterator[TextIO]:
    """A file beside the path, which it is renamed to at the end."""
    part = path.with_name(f".{path.name}-{secrets.token_hex(4)}")
    file = part.open("x", encoding="utf-8", newline="")
    try:
        with file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
