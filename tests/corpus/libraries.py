"""Documents of a library, damaged or written to do harm; names and URLs of libraries."""

import json
import os
import random
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from handsight.objects import Facts, Library, Shape, Symmetries, ply_bytes
from tests.corpus.door import Case, Door, check_pose, spoilt_bytes, spoilt_text, spoilt_value
from tests.corpus.object_files import CORNERS, FACES

HALF = [-1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
QUARTER = [0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
PLY = ply_bytes(Shape(CORNERS, FACES), 1.0)
INFO: dict[str, object] = {
    "1": {"diameter": 119.0, "size_x": 60.0, "size_y": 90.0, "size_z": 50.0, "symmetries_discrete": [HALF]},
    "5": {"diameter": 119.0, "symmetries_continuous": [{"axis": [0.0, 0.0, 1.0], "offset": [0.0, 1.0, 0.0]}]},
}
FACTS: dict[str, object] = {
    "version": 1,
    "objects": {
        "1": {
            "name": "block",
            "mass": 0.5,
            "center_of_mass": [0.0, 0.01, 0.0],
            "sigma_center_of_mass": 0.005,
            "licence": "CC0",
            "source": "made by hand",
            "sha256": "0" * 64,
            "bytes": len(PLY),
        }
    },
}


def opened(info: bytes, facts: bytes | None) -> None:
    """Reads all entries of a library, and asserts that only numbers become names of files."""
    with tempfile.TemporaryDirectory() as folder:
        models = Path(folder, "models")
        models.mkdir()
        (models / "models_info.json").write_bytes(info)
        if facts is not None:
            (models / "handsight.json").write_bytes(facts)
        library = Library(folder)
        for entry in library.entries():
            assert library.entry(entry.name) is not None
            assert "/" not in entry.file
            assert 1e-7 <= entry.diameter <= 1e7
            for T in entry.symmetries.rotations:
                check_pose(T)
            for point, axis in entry.symmetries.axes:
                assert np.isfinite([point, axis]).all()


def text(value: object) -> bytes:
    """Returns a value as JSON; a value that JSON does not have becomes its text."""
    return json.dumps(value, default=str).encode("utf-8", "replace")


def documents_spoilt(rng: random.Random) -> None:
    """Reads documents of which one has a corrupted value, or damaged text or bytes."""
    info, facts = text(INFO), text(FACTS)
    if rng.random() < 0.5:
        changed = spoilt_value(INFO, rng) if rng.random() < 0.5 else None
        info = text(changed) if changed is not None else info
        facts = facts if changed is not None else text(spoilt_value(FACTS, rng))
    elif rng.random() < 0.5:
        info = spoilt_text(info.decode(), rng).encode("utf-8", "replace")
    else:
        facts = spoilt_bytes(facts, rng)
    opened(info, None if rng.random() < 0.1 else facts)


def facts_spoilt(rng: random.Random) -> None:
    """Builds facts with one or two corrupted values, and asserts that accepted ones can be written and read."""
    given: dict[str, object] = {
        "name": "block",
        "mass": 0.5,
        "center_of_mass": (0.0, 0.01, 0.0),
        "licence": "CC0",
    }
    for _ in range(rng.choice([1, 1, 2])):
        key = rng.choice(sorted(given))
        given[key] = spoilt_value(given[key], rng)
    facts = Facts(**given)  # type: ignore[arg-type]
    record = {key: getattr(facts, key) for key in Facts.__struct_fields__ if getattr(facts, key) is not None}
    objects = {"1": {**record, "sha256": "0" * 64, "bytes": 1}}
    opened(text(INFO), json.dumps({"version": 1, "objects": objects}).encode())


def read_from(data: bytes, turn: list[float] = HALF) -> Callable[[], None]:
    """Returns a call that reads a library whose model's file has this content and whose model has this symmetry."""

    def read() -> None:
        with tempfile.TemporaryDirectory() as folder:
            info = {"1": {**INFO["1"], "symmetries_discrete": [turn]}}  # type: ignore[dict-item]
            Path(folder, "models_info.json").write_bytes(text(info))
            Path(folder, "obj_000001.ply").write_bytes(data)
            model = Library(folder).model("1")
            assert model.closed
            assert len(model.symmetries.rotations) == 2

    return read


def changed(**parts: object) -> Callable[[], None]:
    """Returns a call that reads documents in which these keys of the first object have these values."""
    of_info = {key: value for key, value in parts.items() if key in ("diameter", "symmetries_discrete")}
    info = {**INFO, "1": {**INFO["1"], **of_info}}  # type: ignore[dict-item]
    record = {**FACTS["objects"]["1"], **{key: value for key, value in parts.items() if key not in of_info}}  # type: ignore[index]
    return lambda: opened(text(info), text({"version": 1, "objects": {"1": record}}))


def named(key: str) -> Callable[[], None]:
    """Returns a call that reads documents with an object whose number is this key."""
    return lambda: opened(text({key: {"diameter": 1.0}}), None)


def added(prepare: Callable[[Path], object], name: str = "new", **given: object) -> Callable[[], None]:
    """Returns a call that adds a model to a library that was prepared, and reads that library."""

    def add() -> None:
        with (
            tempfile.TemporaryDirectory() as folder,
            warnings.catch_warnings(action="ignore"),
        ):  # of another unit
            models = Path(folder, "lab", "models")
            models.mkdir(parents=True)
            prepare(models)
            Path(folder, "new.ply").write_bytes(PLY)
            library = Library(models.parent)
            try:
                library.add(Path(folder, "new.ply"), Facts(name=name), **{"scale": 1e-3, **given})  # type: ignore[arg-type]
            finally:
                assert not Path(folder, "elsewhere").exists()
                if (models / "models_info.json").exists():
                    known = library.entries()
            assert library.model(name).closed
            assert len({entry.number for entry in known}) == len(known)

    return add


def largest(models: Path) -> None:
    """Writes a library with the objects of the largest numbers, and a file of an object that is in no document."""
    info = {"1": INFO["1"], "999999999": INFO["5"]}
    (models / "models_info.json").write_bytes(text(info))
    (models / "obj_000002.ply").write_bytes(PLY)


LOCK = ".handsight.lock"
DOORS = [
    Door("a library's documents", documents_spoilt, 200),
    Door("an object's facts", facts_spoilt, 100),
]
NUMBERS = "models_info.json: expected numbers of objects as keys, got"
CASES = [
    Case("a library as it was", lambda: opened(text(INFO), text(FACTS)), None),
    Case("a stray model of the largest number", added(lambda models: (models / "obj_999999999.ply").touch()), None),
    Case("a stray model of a larger number", added(lambda models: (models / "obj_99999999999.ply").touch()), None),
    Case("an object of the largest number", added(largest), None),
    Case("a lock that is a pipe", added(lambda models: os.mkfifo(models / LOCK)), "lock: cannot be written: expected a file"),
    Case("a lock that is a folder", added(lambda models: (models / LOCK).mkdir()), "lock: cannot be written: expected a file"),
    Case("a lock that links out of the library", added(lambda models: (models / LOCK).symlink_to(models.parents[1] / "elsewhere")),
         "lock: cannot be written: expected a file"),
    Case("a model in millimetres as if in metres", added(lambda models: None, scale=1.0), "looks like millimetres; try scale=0.001 (force adds it)"),
    Case("such a model by force", added(lambda models: None, scale=1.0, force=True), None),
    Case("a symmetry that a model lacks", added(lambda models: None, symmetries=Symmetries([([0, 0, 0], [0, 0, 1])])),
         "symmetries: expected turns that leave the surface in place, got one, which is 23"),
    Case("a BOP folder as it was", read_from(PLY), None),
    Case("a BOP symmetry of a box that is 4 mm off, as of a scan", read_from(PLY, [*HALF[:3], 4.0, *HALF[4:]]), None),
    Case("a BOP symmetry that the model lacks", read_from(PLY, QUARTER),
         "obj_000001.ply: symmetries: expected turns that leave the surface in place, got one, which is 15.0 mm off"),
    Case("a model cut short", read_from(PLY[:-1]), "obj_000001.ply: expected 12 rows of 'face'"),
    *(
        Case(f"an object numbered {key!r:.20}", named(key), NUMBERS)
        for key in ("../../etc/passwd", "", "-1", "01", "1.0", "1e3", "²", "١", " 1", "9" * 4000, "1\0", "true")
    ),
    Case("a name with a path", changed(name="../block"), "handsight.json: objects.1.name: expected up to 100 letters"),
    Case("a name that a terminal obeys", changed(name="\x1b[2J"), "objects.1.name: expected up to 100 letters"),
    Case("a name that is another's number", changed(name="5"), "objects.1.name: expected no number"),
    Case("a checksum that is none", changed(sha256="../" * 20), "objects.1.sha256: expected 64 hexadecimal digits"),
    Case("a model of 2 TB", changed(bytes=2 * 10**12), "objects.1.bytes: expected a whole number from 0 to 500000000"),
    Case("a mass in grams", changed(mass=603), "objects.1.mass: expected kilograms, got 603 (grams?)"),
    Case("an unknown key", changed(weight=1), "objects.1.weight: unknown key"),
    Case("no diameter", changed(diameter=None), "models_info.json: 1.diameter: expected a"),
    Case("a symmetry of 15 numbers", changed(symmetries_discrete=[HALF[1:]]), "1.symmetries_discrete[0]: expected 16 finite"),
    Case("a symmetry that mirrors", changed(symmetries_discrete=[[1.0, *HALF[1:]]]), "1.symmetries_discrete[0]: expected a rigid"),
    Case("10 000 symmetries", changed(symmetries_discrete=[HALF] * 10_000), "1.symmetries_discrete: expected at most 120"),
    Case("a list in a list, 100 000 deep", lambda: opened(b"[" * 100_000, None), "models_info.json: expected JSON"),
    Case("facts of another version", lambda: opened(text(INFO), b'{"version": 2}'), "handsight.json: version: expected 1, got 2"),
    Case("two of a name", lambda: opened(text({"1": INFO["1"], "2": INFO["1"]}), text({
        "version": 1, "objects": {"1": FACTS["objects"]["1"], "2": FACTS["objects"]["1"]}})),  # type: ignore[index]
        "handsight.json: objects.2.name: expected a name of its own, got 'block', which is that of object 1"),
    Case("a library with a null byte in its name", lambda: print(Library("a\0b")), "library: expected a folder or a URL, got 'a\\x00b'"),
    Case("a library that is a number", lambda: print(Library(3)), "library: expected a folder or a URL, got '3'"),  # type: ignore[arg-type]
]  # fmt: skip
