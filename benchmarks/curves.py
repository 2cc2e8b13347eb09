"""Curves of cost by size, each with its exponent: `python -m benchmarks.growth --only library` (see `AXES`). Synthetic.

Times are of CPU, of all threads of the process, so that other work on the machine says little. The exponent is the
slope of a line through the logarithms of both, by least squares: 1 is proportional, below 1 sublinear. Each size runs
in a process of its own, whose peak memory is given; a library's and a recording's files are removed at the end.
`real` needs the data folder, for its real depth images.
"""

import argparse
import contextlib
import io
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import trimesh

import handsight as hs
from benchmarks.shapes import bumpy
from handsight import se3
from handsight.batch.run import Batch
from handsight.batch.workers import Answers, Cluster
from handsight.cache_folder import cache_folder
from handsight.camera import Camera
from handsight.objects import Library, Shape, diameter, ply_bytes
from handsight.recording import RecordingWriter, open_recording
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.tracking import Tracker
from handsight.tracking.replay import Tally, replay
from handsight.vision import ShapeIndex, locate
from handsight.vision.object.locate import LOCATE
from handsight.vision.object.region import scene_of
from testbed import many_scenes, real_frames, report, sight_scenes

Row = dict[str, float]
Mesh = tuple[np.ndarray, np.ndarray]
CONTACTS = (100, 300, 1000, 3000, 10_000, 20_000)
SUBDIVISIONS = (5, 6, 7, 8, 9)
"""20 480, 81 920, 327 680, 1 310 720 and 5 242 880 triangles."""
OBJECTS = (100, 1000, 2600, 10_000)
REAL_FRAMES = 5
"""Of each scene."""
OCCLUDERS, HIDDEN = ("edge", "bar", "disc"), 0.2
"""What hides a part of an object, and what share of it: beyond a straight edge, along a bar, in a disc."""
IMAGES = ((320, 240), (640, 480), (1280, 960), (1920, 1440), (3840, 2160))
RECORDED = (150, 500, 1500, 5000)
"""Depth images of a recording, 0.6 MB each before compression, and 17 joint states for each."""
READ = (250, 1000, 4000)
"""The same, of one that is read and not tracked."""
WORKERS = (4, 8)
TASKS = {0.01: 2400, 0.1: 400, 1.0: 48}
"""Number of lines by their duration [s]."""


def cpu(call: Callable[[], Any]) -> tuple[Any, float]:
    """Returns the result of a call, and its CPU time on all threads [s]."""
    begin = time.process_time()
    answer = call()
    return answer, time.process_time() - begin


def memory(field: str = "VmHWM") -> float:
    """Returns the megabytes of this process, by default at most."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith(field))) / 1e3


def contacts(count: int, folder: Path) -> Row:
    """Returns the time of a correction by so many contacts on a bumpy ball of 5 120 triangles, 2 % of them wrong."""
    options = many_scenes.ManyOptions(contacts=count, wrong=0.02)
    return {"contacts": count, **corrected(hs.ObjectModel.from_mesh(*bumpy(4)), options, 6)}


def corrected(model: hs.ObjectModel, options: many_scenes.ManyOptions, times: int) -> Row:
    """Returns the median time of corrections of drawn poses, but for the first, and their median error."""
    took, off = [], []
    for k in range(times):
        scene = many_scenes.many_scene(model, np.random.default_rng([options.contacts, k]), options)
        estimate, seconds = cpu(
            lambda scene=scene: hs.correct_pose(model, scene.contacts, vision=scene.vision)
        )
        took.append(seconds)
        off.append(np.linalg.norm(estimate.T_palm_object[:3, 3] - scene.T_palm_object[:3, 3]))
    return {"ms": 1e3 * float(np.median(took[1:])), "mm": 1e3 * float(np.median(off))}


def triangles(subdivisions: int, folder: Path) -> Row:
    """Returns the time to build an object from a mesh in a file, to load it again, and of a correction by five
    contacts on it."""
    path, count = folder / f"{subdivisions}.ply", 20 * 4**subdivisions
    building = multiprocessing.get_context("spawn").Process(target=_write_mesh, args=(subdivisions, path))
    building.start()  # what draws the mesh takes more memory than what reads it
    building.join()
    hs.ObjectModel.from_mesh(*bumpy(2))  # kernels loaded
    (model, build), (_, load) = (cpu(lambda: hs.ObjectModel.from_file(path)) for _ in range(2))
    row = {"triangles": count, "s": build, "load_s": load}
    return row | corrected(model, many_scenes.ManyOptions(contacts=5), 21)


def _write_mesh(subdivisions: int, path: Path) -> None:
    trimesh.Trimesh(*bumpy(subdivisions), process=False).export(path)


def shape(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [m] and triangles of one of any number of objects: boxes, cylinders, profiles that are turned,
    dented balls and superellipsoids, 3 to 15 cm along each axis."""
    rng, kind = np.random.default_rng([number, 77]), number % 5
    size = np.exp(rng.uniform(np.log(0.03), np.log(0.15), 3))
    ball = trimesh.creation.icosphere(subdivisions=2)
    unit, faces = np.asarray(ball.vertices), np.asarray(ball.faces)
    if kind == 0:
        box = hs.ObjectModel.box(size)
        return box.vertices, box.faces
    if kind in (1, 2):
        radii = [0.5, 0.5] if kind == 1 else rng.uniform(0.15, 0.5, 5)
        heights = np.linspace(-0.5, 0.5, len(radii))
        profile = np.array([(0, -0.5), *zip(radii, heights, strict=True), (0, 0.5)])
        vertices, faces = sight_scenes.revolved(profile, 32)
        return vertices * size[[0, 0, 1]], faces
    if kind == 3:
        ways, depths, phases = 3 * rng.normal(size=(4, 3)), rng.uniform(0.05, 0.2, 4), rng.uniform(0, 6, 4)
        dents = 1 + (depths * np.sin(unit @ ways.T + phases)).sum(axis=1)
        return dents[:, None] * unit * size / 2, faces
    power = rng.uniform(0.3, 1.5, 2)[[1, 1, 0]]
    return np.sign(unit) * np.abs(unit) ** power * size / 2, faces


def _write_library(count: int, folder: Path, known: Sequence[Mesh] = ()) -> None:
    """Writes a library of so many objects: known ones, then drawn ones."""
    place, infos = folder / "models", {}
    place.mkdir()
    for k in range(count):
        vertices, faces = known[k] if k < len(known) else shape(k)
        (place / f"obj_{k + 1:06d}.ply").write_bytes(ply_bytes(Shape(1000 * vertices, faces), 1.0))
        infos[str(k + 1)] = {"diameter": 1000 * diameter(vertices[:: max(len(vertices) // 500, 1)])}
    (place / "models_info.json").write_text(json.dumps(infos), encoding="utf-8")


def library(count: int, folder: Path) -> Row:
    """Returns the time of an index of so many objects, of a question to it, and how often the object that is there is
    among those that it names: where all of it is visible, and where something hides a fifth."""
    _write_library(count, folder)
    _, build = cpu(lambda: ShapeIndex(Library(folder)))
    index, load = cpu(lambda: ShapeIndex(Library(folder)))
    row = {"objects": count, "build_s": build, "load_s": load, "named": index.shortlist}
    names, camera, asked, named = list(index), sight_scenes.WIDE, [], list[str]()
    index.__class__ = _Names  # models are not loaded: only the names are judged
    for occluder in ("none", *OCCLUDERS):
        right = []
        for j in range(100):
            rng = np.random.default_rng([j, 5])
            k = int(rng.integers(count))
            scene = scene_of(camera, pictured(*shape(k), camera, occluder, rng))
            named, seconds = cpu(lambda scene=scene: list(index.nearest(scene)))
            asked.append(seconds)
            right.append(names[k] in named)
        row[occluder] = float(np.mean(right))
    return {**row, "ms": 1e3 * float(np.median(asked))}


def real(count: int, folder: Path) -> Row:
    """Returns how often an index of fifteen scanned objects (YCB) and others that are drawn names the right one: in the
    boxes and in the masks of real frames (YCB-Video), and in views that are drawn of the same scans."""
    frames = real_frames.open_folder(real_frames.default_folder())
    scans = {name: (model.vertices, model.faces) for name, model in frames.models.items()}
    _write_library(count, folder, list(scans.values()))
    index = ShapeIndex(Library(folder))
    index.__class__ = _Names
    number, extent = dict(zip(scans, index, strict=False)), LOCATE.max_plane * index.max_diameter
    right, asked = dict[str, list[bool]](), []

    def ask(name: str, way: str, camera: Camera, depth: np.ndarray, wanted: np.ndarray | None = None) -> None:
        scene = scene_of(camera, depth, wanted=wanted, extent=extent)
        named, seconds = cpu(lambda: index.nearest(scene))
        right.setdefault(way, []).append(number[name] in named)
        asked.append(seconds)

    for told in real_frames.TOLD[1:]:
        for frame in (read() for read in frames.some(REAL_FRAMES)):
            for one in frame.instances:
                ask(one.name, f"{told} {frame.scene}", frame.camera, frame.depth, frame.wanted(one, told))
    for occluder in ("none", *OCCLUDERS):
        for k, (name, scan) in product(range(8), scans.items()):
            view = pictured(*scan, sight_scenes.WIDE, occluder, np.random.default_rng([k, 9]))
            ask(name, occluder, sight_scenes.WIDE, view)
    shares = {way: float(np.mean(each)) for way, each in right.items()}
    return {"objects": count, "named": index.shortlist, **shares, "ms": 1e3 * float(np.median(asked))}


class _Names(ShapeIndex):
    """A `_Names` is an index that loads no models."""

    def __getitem__(self, name: str) -> Any:
        return name


def pictured(
    vertices: np.ndarray, faces: np.ndarray, camera: Camera, occluder: str, rng: np.random.Generator
) -> np.ndarray:
    """Returns the noisy depth image of an object alone at 0.5 to 1 m, turned at random; an occluder hides `HIDDEN`."""
    T = se3.random(rng, 1)[0]
    T[:3, 3] = [0.05, 0.02, rng.uniform(0.5, 1.0)]
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    depth = camera.draw(se3.apply(T, vertices - middle), faces).depth
    depth = np.where(np.isfinite(depth), depth, np.float32(0))
    points, angle = camera.points(depth)[..., :2], rng.uniform(0, 2 * np.pi)
    if occluder != "none":
        away = points - points[depth > 0][rng.integers((depth > 0).sum())]
        along = away @ [np.cos(angle), np.sin(angle)]
        hides = {"edge": along, "bar": np.abs(along), "disc": np.linalg.norm(away, axis=-1)}[occluder]
        depth[~(hides > np.nanquantile(hides, HIDDEN))] = 0
    return sight_scenes.noisy(depth, rng)


def images(size: tuple[int, int], folder: Path) -> Row:
    """Returns the time to locate an object on a table in a depth image of that size."""
    (width, height), model, rng = size, hs.ObjectModel.from_mesh(*bumpy(4)), np.random.default_rng(0)
    focal = 1.25 * height
    camera = Camera(np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]), size)
    T = se3.compose(se3.rotation_exp(np.array([0.4, 0.5, 0.2])), np.array([0.02, 0.01, 0.6]))
    depth = camera.draw(se3.apply(T, model.vertices), model.faces).depth
    depth = np.where(np.isfinite(depth), depth, np.float32(0.72))
    depth += (1e-3 * rng.normal(size=depth.shape)).astype(np.float32)
    found, took = [], []
    for _ in range(6):
        answer, seconds = cpu(lambda: locate(model, depth, camera))
        found.append(np.linalg.norm(answer.Ts_camera_object[0, :3, 3] - T[:3, 3]))
        took.append(seconds)
    return {
        "pixels": width * height,
        "ms": 1e3 * float(np.median(took[1:])),
        "mm": 1e3 * float(np.median(found)),
    }


def reading(count: int, folder: Path) -> Row:
    """Returns the time to read a recording with so many depth images as observations, and the memory that it takes."""
    path, rig = _recorded(count, folder), rig_of(Scenario(images=True))
    with open_recording(path, rig) as opened:
        number, seconds = cpu(lambda: sum(1 for _ in opened.observations()))
    size = path.stat().st_size / 1e6
    row = {"images": count, "MB": size, "observations": number, "s": seconds, "MB/s": size / seconds}
    return row | {"private MB": memory("RssAnon")}


def recording(count: int, folder: Path) -> Row:
    """Returns the time to read and track a recording with so many depth images, and the memory that it takes."""
    path, rig = _recorded(count, folder), rig_of(Scenario(images=True))
    tracker, tally = Tracker(rig, model_of(Scenario())), Tally()
    with open_recording(path, rig) as opened:
        _, seconds = cpu(lambda: sum(1 for _ in replay(opened.observations(), tracker, tally)))
    size = path.stat().st_size / 1e6
    return {
        "images": count,
        "MB": size,
        "poses": tally.answered,
        "s": seconds,
        "private MB": memory("RssAnon"),
    }


def _recorded(count: int, folder: Path) -> Path:
    """Returns a recording with so many depth images, which another process has written."""
    path = folder / "long.mcap"
    writing = multiprocessing.get_context("spawn").Process(target=_write_recording, args=(count, path))
    writing.start()
    writing.join()
    return path


def _write_recording(count: int, path: Path) -> None:
    """Writes a held can again and again, with a noisy depth image at 30 Hz that cannot be compressed much."""
    rig, rng = rig_of(Scenario(images=True)), np.random.default_rng(0)
    samples = [sample.observation for sample in simulate(Scenario(object="can", seed=1))]
    held, per = samples[-200:], 17
    with RecordingWriter(path, rig) as writer:
        for k in range(len(samples) + per * count):
            each = samples[k] if k < len(samples) else held[(k - len(samples)) % len(held)]
            depth = 1.0 + 0.02 * rng.standard_normal((480, 640), np.float32) if k % per == 0 else None
            writer.write(replace(each, stamp=10.0 + k / (30 * per), depth=depth))


def waited(lines: list[bytes]) -> Answers:
    """Returns answers to lines that each say how long it takes [s]."""
    begin = time.perf_counter()
    for line in lines:
        time.sleep(float(line))
    return Answers(["{}"] * len(lines), time.perf_counter() - begin, [])


@contextlib.contextmanager
def dask(workers: int, folder: Path) -> Iterator[tuple[str, psutil.Process]]:
    """Yields the address of a Dask scheduler with so many worker processes, and its process."""
    found, root = folder / "scheduler.json", Path(__file__).parents[1]
    paths = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    common = ("--no-dashboard", "--host", "127.0.0.1")
    commands = [["scheduler", "--port", "0", "--scheduler-file", str(found), *common]]
    each = ["worker", "--scheduler-file", str(found), "--nthreads", "1", "--no-nanny", *common]
    with contextlib.ExitStack() as ends:
        for command in (*commands, *[each] * workers):
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{command[0]}", *command[1:]],
                env={**os.environ, "PYTHONPATH": paths},
                stderr=subprocess.DEVNULL,
            )
            ends.callback(process.wait)
            ends.callback(process.kill)
            if command[0] == "scheduler":
                scheduler = psutil.Process(process.pid)
            while not (found.exists() and found.read_text().endswith("}")):
                time.sleep(0.1)
        yield json.loads(found.read_text())["address"], scheduler


def cluster(workers: int, folder: Path) -> Row:
    """Returns the overhead of tasks that wait, so that many workers fit on few cores, and what scheduler and client
    compute for a chunk of them."""
    row: Row = {"workers": workers}
    with dask(workers, folder) as (address, scheduler), Cluster(address, waited) as those:
        while len(those._client.scheduler_info(n_workers=-1)["workers"]) < workers:
            time.sleep(0.1)
        for seconds, count in {0.05: 20 * workers, **TASKS}.items():
            lines = io.BytesIO(b"%g\n" % seconds * count)
            begin, used = time.perf_counter(), sum(scheduler.cpu_times()[:2]) + time.process_time()
            chunks = sum(1 for _ in Batch(lines, those))
            took = time.perf_counter() - begin
            used = sum(scheduler.cpu_times()[:2]) + time.process_time() - used
            if seconds in TASKS:
                row[f"{seconds:g} s (%)"] = 100 * (took * workers / (seconds * count) - 1)
                row[f"CPU a chunk (ms), {seconds:g} s"] = 1e3 * used / chunks
    return row


AXES: dict[str, tuple[Callable[..., Row], Sequence[Any], str]] = {
    "contacts": (contacts, CONTACTS, "ms"),
    "triangles": (triangles, SUBDIVISIONS, "s"),
    "library": (library, OBJECTS, "ms"),
    "real": (real, OBJECTS[:3], "ms"),
    "reading": (reading, READ, "s"),
    "recording": (recording, RECORDED, "s"),
    "images": (images, IMAGES, "ms"),
    "cluster": (cluster, WORKERS, ""),
}
"""By name: what is measured, at which sizes, and which column grows."""


def exponent(rows: list[Row], column: str) -> float:
    """Returns the exponent of a column by the first one: the slope of a line through the logarithms of both."""
    sizes = [next(iter(row.values())) for row in rows]
    return float(np.polyfit(np.log(sizes), np.log([row[column] for row in rows]), 1)[0])


def _measured(name: str, size: Any, folder: Path, results: Any) -> None:
    """Puts a row of an axis into a queue."""
    results.put({**AXES[name][0](size, folder), "peak MB": memory()})


def curve(name: str, sizes: Sequence[Any]) -> list[Row]:
    """Returns the rows of an axis, each measured in a process of its own, in a folder that is removed."""
    context, rows = multiprocessing.get_context("spawn"), list[Row]()
    os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder()))
    for size in sizes:
        with tempfile.TemporaryDirectory(prefix="handsight-growth-") as folder:
            os.environ["HANDSIGHT_CACHE"] = folder + "/cache"
            results = context.Queue()
            process = context.Process(target=_measured, args=(name, size, Path(folder), results))
            process.start()
            process.join()
            if process.exitcode or results.empty():  # it failed, or its data are not here
                break
            rows.append(results.get())
            report.say(f"  {name}: {rows[-1]}")
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Prints the table of each axis; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=list(AXES), help="repeatable; default: all")
    parser.add_argument("--most", type=int, metavar="N", help="only the N smallest sizes of each")
    given = parser.parse_args(arguments)
    for name in given.only or AXES:
        _, sizes, column = AXES[name]
        if rows := curve(name, sizes[: given.most]):
            cells = [[f"{value:,.0f}".replace(",", " ") if value >= 1000 else f"{value:.3g}" for value in row.values()]
                     for row in rows]  # fmt: skip
            slope = f"exponent of {column}: {exponent(rows, column):.2f}" if column and len(rows) > 1 else ""
            report.print_table(f"Growth: {name}", list(rows[0]), cells, f"{slope}\n{report.machine()}")
    return 0
