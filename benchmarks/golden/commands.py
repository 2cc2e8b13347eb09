"""Six recordings tracked, forty depth images located and four objects weighed, by the commands that a user calls."""

import contextlib
import csv
import io
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.golden.answers import Answer, Answers, rows_of
from benchmarks.golden.shapes import data

TRACKED = {
    "can": ("can", "--seed", "1"),
    "box": ("box", "--seed", "2"),
    "mustard": ("ycb_meshes/006_mustard_bottle.ply", "--seed", "3"),
    "images": ("can", "--seed", "4", "--images", "--motion", "grasp"),
    "skin": ("can", "--seed", "5", "--skin", "--motion", "grasp"),
    "pulled": ("box", "--seed", "6", "--motion", "ramp"),
}
"""Arguments of `handsight simulate` for each recording."""
WEIGHED = {
    "box weighed": ("box", "--seed", "7", "--motion", "weigh"),
    "box weighed again": ("box", "--seed", "8", "--motion", "weigh"),
    "can weighed": ("can", "--seed", "9", "--motion", "weigh"),
    "mustard weighed": ("ycb_meshes/006_mustard_bottle.ply", "--seed", "10", "--motion", "weigh"),
}
FRAMES = {"0000": range(1, 15), "0001": range(1, 14, 4), "0002": range(1, 14, 4)}
"""Of the real frames: every object of these is located by itself, until there are forty images of an object."""
IMAGES = 40


def called(*arguments: str) -> None:
    """Runs `handsight ARGUMENTS` in this process; raises RuntimeError with its output if it fails."""
    from handsight.cli import main

    before, said = sys.argv, io.StringIO()
    sys.argv = ["handsight", *arguments]
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            main()
    except SystemExit as stop:
        if stop.code not in (None, 0):
            raise RuntimeError(
                f"handsight {' '.join(arguments)}: exit code {stop.code}: {said.getvalue()}"
            ) from None
    finally:
        sys.argv = before


def recording(folder: Path, name: str, told: tuple[str, ...]) -> Path:
    """Returns a recording in the folder of golden answers, simulated where it is not there yet."""
    path = folder / f"{name}.mcap"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        object = str(data(told[0])) if "/" in told[0] else told[0]
        called("simulate", object, *told[1:], "--output", str(path))
    return path


def columns(path: Path) -> Answer:
    """Returns the columns of a CSV file: numbers as they are, words joined."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    answer: Answer = {}
    for name in rows[0]:
        cells = [row[name] for row in rows]
        try:
            answer |= rows_of(**{name: [float(cell) if cell else np.nan for cell in cells]})
        except ValueError:
            answer[name] = "\n".join(cells)
    return answer


def tracked(folder: Path, *, quick: bool) -> Answers:
    """Returns what `handsight track` writes for each recording."""
    for name, told in TRACKED.items():
        if quick and name != "box":
            continue
        path = recording(folder / "recordings", name, told)
        with tempfile.TemporaryDirectory() as results:
            called("track", str(path), "--output-folder", results)
            yield f"{name}/track", columns(Path(results, "track.csv"))


def weighed(folder: Path, *, quick: bool) -> Answers:
    """Returns mass and centre of mass by `handsight track`."""
    for name, told in list(WEIGHED.items())[: 1 if quick else None]:
        path = recording(folder / "recordings", name, told)
        with tempfile.TemporaryDirectory() as results:
            called("track", str(path), "--output-folder", results)
            weight = json.loads(Path(results, "summary.json").read_text(encoding="utf-8"))["weight"]
        yield f"{name}/weight", _flat(weight)


def located(folder: Path, *, quick: bool) -> Answers:
    """Returns the answers of `handsight locate` for objects in real depth images, each in the complete image."""
    asked = list(_objects())[:IMAGES]
    for scene, frame, name in asked[:: 10 if quick else 1]:
        source = data("ycbv_frames", scene, frame)
        camera = json.loads((source / "frame.json").read_text(encoding="utf-8"))
        mesh = next(
            path
            for path in (data(*at, f"{name}.ply") for at in (("ycbv_frames", "meshes"), ("ycb_meshes",)))
            if path.exists()
        )
        with tempfile.TemporaryDirectory() as results:
            picture, found = Path(results, "depth.png"), Path(results, "found.jsonl")
            shutil.copy(source / "depth.png", picture)
            intrinsics = {key: camera[key] for key in ("fx", "fy", "cx", "cy")}
            intrinsics |= {"width": 640, "height": 480}
            Path(results, "camera.json").write_text(json.dumps(intrinsics), encoding="utf-8")
            options = ["--object", str(mesh), "--depth-scale", str(camera["depth_scale"])]
            called("locate", str(picture), *options, "-o", str(found))
            line = json.loads(found.read_text(encoding="utf-8"))
        line.pop("seconds", None)
        line.pop("picture", None)
        yield f"{scene}/{frame}/{name}", _flat(line)


def _objects() -> Any:
    for scene, frames in FRAMES.items():
        for number in frames:
            file = data("ycbv_frames", scene, f"{number:06d}", "frame.json")
            if file.exists():
                for name in json.loads(file.read_text(encoding="utf-8"))["labels"]:
                    yield scene, file.parent.name, name


def _flat(line: dict[str, Any]) -> Answer:
    """Returns a line of JSON as numbers and words; what is nested (hypotheses) as the numbers in it."""
    answer: Answer = {}
    for key, value in line.items():
        if isinstance(value, str) or value is None:
            answer[key] = str(value)
        else:
            answer[f"{key}, flat"] = rows_of(value=list(_leaves(value)))["value"]
    return answer


def _leaves(value: Any) -> Any:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for entry in value:
            yield from _leaves(entry)
    elif isinstance(value, int | float):
        yield float(value)
