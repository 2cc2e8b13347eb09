"""A library in a folder: its documents and models are read by any process, and changed by one at a time.

`models_info.json` is written last, and each file appears under its name complete or not at all: an object that is not
in that document is not in the library, whatever else an interrupted add has written.
"""

import contextlib
import fcntl
import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from handsight import checks
from handsight.errors import InvalidFile, InvalidInput, NotWritten
from handsight.files import atomic_file, open_regular, read_bytes, write_errors
from handsight.msgspec_errors import JsonObject, decode_object
from handsight.objects.files import ply_bytes, read_shape
from handsight.objects.files.read import LARGEST_FILE, content
from handsight.objects.geometry import unit_remarks
from handsight.objects.library.documents import (
    FACTS,
    INFO,
    LARGEST_DOCUMENT,
    MAX_NUMBER,
    METRES,
    VERSION,
    Documents,
    Entry,
    Facts,
    NoLibrary,
    Record,
    entries,
    info_of,
)
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import Symmetries


def new_object(
    file: str | os.PathLike[str], facts: Facts, scale: float, symmetries: Symmetries | None, force: bool
) -> tuple[JsonObject, JsonObject, bytes]:
    """Returns what `Folder.add` takes of an object in a file; raises InvalidInput, and as `ObjectModel.from_file`.

    A PLY in millimetres is kept byte for byte, with its colours; any other file is converted to one.
    """
    if not isinstance(facts, Facts):
        raise InvalidInput(f"facts: expected Facts, got {type(facts).__name__}")
    model = ObjectModel.from_file(file, scale)
    if symmetries is not None:
        model = model.with_symmetries(symmetries)
    check_inside(facts, model)
    path = Path(file)
    doubts = unit_remarks(float(np.ptp(model.bounds_object, axis=0).max()))
    if doubts and not force:
        raise InvalidInput(
            f"{path.name}: expected an object for a hand, got one of {doubts[0]} (in Python, force=True adds it)"
        )
    if path.suffix.lower() == ".ply" and scale == METRES:
        data = content(path)
    else:
        data = ply_bytes(read_shape(path), scale / METRES)
        if len(data) > LARGEST_FILE:
            raise InvalidFile(f"{path.name}: expected at most {LARGEST_FILE} bytes as PLY, got {len(data)}")
    identity = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    return msgspec.to_builtins(facts) | identity, info_of(model), data


def check_inside(facts: Facts, model: ObjectModel) -> None:
    """Raises InvalidInput for a centre of mass outside the object's bounds."""
    if facts.center_of_mass is None:
        return
    center = np.array(facts.center_of_mass)
    slack = 0.05 * model.diameter  # models are not exact
    low, high = model.bounds_object + np.array([[-slack], [slack]])
    if not ((low <= center) & (center <= high)).all():
        bounds = f"{checks.brief(low.round(4))} to {checks.brief(high.round(4))}"
        raise InvalidInput(f"center_of_mass: expected metres from {bounds}, got {checks.brief(center)}")


@dataclass(frozen=True)
class Folder:
    """Library whose documents and models are side by side in a folder."""

    place: Path

    @property
    def models(self) -> Path:
        """The folder with the documents: the library's own, or else its `models`, as in a BOP data set."""
        return self.place if (self.place / INFO).exists() else self.place / "models"

    def documents(self) -> Documents:
        """Returns the contents of both documents; raises NoLibrary where there are none, InvalidFile."""
        models = self.models
        if not (models / INFO).exists():
            raise NoLibrary(
                f"{self.place}: expected a library, with models/{INFO}, got none; `handsight objects add` makes one"
            )
        # Info is read first: an add writes it last, so that the facts of every object in it are already there.
        info = read_bytes(models / INFO, LARGEST_DOCUMENT)
        if not (models / FACTS).exists():
            return info, None
        return info, read_bytes(models / FACTS, LARGEST_DOCUMENT)

    def file(self, entry: Entry) -> Path:
        """Returns the path of the model's file; raises InvalidFile where it is missing or has changed since the add."""
        path = self.models / entry.file
        facts = entry.facts
        check_content(path, facts.sha256 if facts else None, facts.bytes if facts else None)
        return path

    def add(self, new: JsonObject, new_info: JsonObject, ply: bytes) -> None:
        """Adds an object: its parts of the documents, and its model; raises InvalidInput where its name is taken,
        NotWritten, InvalidFile without a library."""
        models = self.models
        with locked(models):
            documents = self.documents() if (models / INFO).exists() else (b"{}", None)
            for entry in entries(documents, str(self.place)):
                if entry.name == new["name"]:
                    raise InvalidInput(f"name: expected a new one, got that of object {entry.number}")
            infos = decode_object(documents[0], INFO)
            # Facts that an interrupted add has left behind must not become those of another object.
            facts = {key: value for key, value in _facts(documents).items() if key in infos}
            # A file that no document lists keeps its number.
            files = [path.stem.removeprefix("obj_") for path in models.glob("obj_*.ply")]
            taken = {int(text) for text in (*infos, *files) if re.fullmatch("[0-9]{1,9}", text)}
            number = 1 + max(taken, default=0)
            if number > MAX_NUMBER:
                number = next(free for free in range(1, MAX_NUMBER) if free not in taken)
            facts[str(number)] = new
            infos[str(number)] = new_info
            write_file(models / f"obj_{number:06d}.ply", ply)
            write_file(models / FACTS, _json({"version": VERSION, "objects": facts}))
            write_file(models / INFO, _json(infos))

    def revise(self, number: int, record: Record) -> None:
        """Replaces the facts of an object; raises NotWritten, InvalidFile without a library."""
        models = self.models
        with locked(models):
            objects = _facts(self.documents()) | {str(number): msgspec.to_builtins(record)}
            write_file(models / FACTS, _json({"version": VERSION, "objects": objects}))


def _facts(documents: Documents) -> JsonObject:
    return {} if documents[1] is None else decode_object(documents[1], FACTS)["objects"]


def _json(document: JsonObject) -> bytes:
    return msgspec.json.format(msgspec.json.encode(document), indent=2) + b"\n"


def write_file(path: Path, data: bytes) -> None:
    """Writes a file, which appears under its name complete or not at all; raises NotWritten."""
    with write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            file.write(data)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other threads and processes from writing to a folder; raises NotWritten where another writes already.

    It is the operating system's lock on an open file, which ends with its process, however that ends. A folder on a
    file system without locks is refused, because of two writers one could lose what the other added.
    """
    with write_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / ".handsight.lock"
        # If it is a link or a pipe, opening it neither follows the one nor waits for the other.
        strict = os.O_NOFOLLOW | os.O_NONBLOCK
        with open(path, "ab", opener=lambda name, flags: os.open(name, flags | strict, 0o666)) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise NotWritten(
                    f"{folder}: cannot be written: another process is adding to it; try again"
                ) from None
            yield


def check_content(path: Path, sha256: str | None, size: int | None) -> None:
    """Raises InvalidFile where a file is missing, or its size [bytes] or SHA-256 is another; None allows any."""
    with open_regular(path) as file:
        came = os.fstat(file.fileno()).st_size
        if size is not None and came != size:
            raise InvalidFile(f"{path}: expected {size} bytes, got {came}: changed since it was added")
    if sha256 is not None:
        found = hashlib.sha256(read_bytes(path, came)).hexdigest()
        if found != sha256:
            raise InvalidFile(
                f"{path}: expected the SHA-256 {sha256[:12]}…, got {found[:12]}…: changed since it was added"
            )
