"""An object added to a folder: what is written of it, in which order, and when it is there."""

import hashlib
import os
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from handsight import checks
from handsight.errors import InvalidFile, InvalidInput
from handsight.msgspec_errors import decode_object
from handsight.objects.files import ply_bytes, read_shape
from handsight.objects.files.read import LARGEST_FILE, content
from handsight.objects.library.bop import BOP_SYMMETRIES, info_of
from handsight.objects.library.facts import FACTS_LIMITS, Facts
from handsight.objects.library.folder import Folder
from handsight.objects.library.index import FACTS, INFO, Documents, entries
from handsight.objects.library.store import locked, new_file
from handsight.objects.model import ObjectModel
from handsight.objects.symmetry import Symmetries

OUTSIDE = 0.05
"""Parts of the diameter that a centre of mass may be outside the bounds: models are not exact."""


class NewObject(NamedTuple):
    """A `NewObject` is what is to be written of an object."""

    facts: dict[str, Any]
    info: dict[str, Any]
    ply: bytes


def new_object(
    file: str | os.PathLike[str], facts: Facts, scale: float, symmetries: Symmetries | None
) -> NewObject:
    """Returns what is to be written of the object in a file; raises InvalidInput and as `ObjectModel.from_file`."""
    if not isinstance(facts, Facts):
        raise InvalidInput(f"facts: expected Facts, got {type(facts).__name__}")
    model = ObjectModel.from_file(file, scale, symmetries=symmetries)
    check_inside(facts, model)
    data = _ply(Path(file), scale)
    entry = msgspec.to_builtins(facts) | {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    return NewObject(entry, info_of(model), data)


def add(folder: Folder, new: NewObject) -> None:
    """Adds it; raises InvalidInput where its name is taken, NotWritten, and InvalidFile for what is no library.

    `models_info.json` is written last and in one: an object that it does not have is none, whatever else is there.
    """
    models = folder.models
    with locked(models):
        there = (models / INFO).exists()
        documents = folder.documents() if there else Documents(b"{}", None)
        for entry in entries(documents, str(folder.place)):
            if entry.name == new.facts["name"]:
                raise InvalidInput(
                    f"name: expected a new one, got {entry.name!r}, which is that of object {entry.number}"
                )
        infos = decode_object(documents.info, INFO)
        known = {} if documents.facts is None else decode_object(documents.facts, FACTS)["objects"]
        # What an add that was cut short has left is not taken for another object's.
        facts = {key: value for key, value in known.items() if key in infos}
        number = 1 + max([0, *map(int, infos), *_numbers(models)])
        facts[str(number)], infos[str(number)] = new.facts, new.info
        with new_file(models / f"obj_{number:06d}.ply") as file:
            file.write(new.ply)
        for name, document in ((FACTS, {"version": FACTS_LIMITS.version, "objects": facts}), (INFO, infos)):
            with new_file(models / name) as file:
                file.write(msgspec.json.format(msgspec.json.encode(document), indent=2) + b"\n")


def revise(folder: Folder, number: int, facts: Facts) -> None:
    """Replaces what is known of an object besides its surface; raises NotWritten, InvalidFile for what is no library.

    Facts that a folder of somebody else's has not are begun.
    """
    models = folder.models
    with locked(models):
        documents = folder.documents()
        known = {} if documents.facts is None else decode_object(documents.facts, FACTS)["objects"]
        data = content(models / f"obj_{number:06d}.ply")
        entry = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
        before = known.get(str(number), entry)
        new = msgspec.to_builtins(facts) | {key: before[key] for key in entry}
        with new_file(models / FACTS) as file:
            document = {"version": FACTS_LIMITS.version, "objects": {**known, str(number): new}}
            file.write(msgspec.json.format(msgspec.json.encode(document), indent=2) + b"\n")


def _numbers(models: Path) -> list[int]:
    """Returns the numbers of the models' files there, listed or not."""
    stems = [path.stem.removeprefix("obj_") for path in models.glob("obj_*.ply")]
    return [int(stem) for stem in stems if stem.isascii() and stem.isdecimal() and len(stem) < 10]


def _ply(file: Path, scale: float) -> bytes:
    """Returns the file as PLY in millimetres; as it stands, with its colours, where it is that already."""
    if file.suffix.lower() == ".ply" and scale == BOP_SYMMETRIES.metres:
        return content(file)
    data = ply_bytes(read_shape(file), scale / BOP_SYMMETRIES.metres)
    if len(data) > LARGEST_FILE:
        raise InvalidFile(f"{file.name}: expected at most {LARGEST_FILE} bytes as PLY, got {len(data)}")
    return data


def check_inside(facts: Facts, model: ObjectModel) -> None:
    """Raises InvalidInput for a centre of mass that is not in the object."""
    if facts.center_of_mass is None:
        return
    center, slack = np.array(facts.center_of_mass), OUTSIDE * model.diameter
    low, high = model.bounds_object[0] - slack, model.bounds_object[1] + slack
    if not ((low <= center) & (center <= high)).all():
        expected = f"expected metres from {checks.brief(low.round(4))} to {checks.brief(high.round(4))}"
        raise InvalidInput(f"center_of_mass: {expected}, where the object is, got {checks.brief(center)}")
