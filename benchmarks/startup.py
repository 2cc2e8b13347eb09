"""New processes: CPU time to import, to --help, to the first correction (warm and with nothing compiled) and to a
command's answer.

Warm: kernels and fields are in their cache. First compile: with an empty cache folder, as after installing.
"""

import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks import ROOT, timing
from handsight.objects import ObjectModel, Shape, ply_bytes

Row = dict[str, Any]
IMPORT = "import handsight"
FIRST = """
import numpy as np, handsight as hs
model = hs.ObjectModel.box((0.06, 0.09, 0.14))
points, normals = model.sample(5)
vision = hs.PosePrior.from_sigmas(np.eye(4), 0.012, 0.15)
hs.correct_pose(model, hs.Contacts(points, normals, sigma_point=1e-3, sigma_normal=0.1), vision=vision)
"""
HELP = "import sys; sys.argv = ['handsight', '--help']; import handsight.cli; handsight.cli.main()"
LOCATES = "handsight locate of one image, warm"
LOCATE = """
import sys
from handsight.cli import main
sys.argv = ["handsight", "locate", {depth!r}, "--camera", {camera!r}, "--object", {mesh!r}]
main()
"""
TRACK = """
import os, sys
import handsight.tracking.replay as module
from handsight.cli import main
def first(*arguments):
    next(replay(*arguments))
    os._exit(0)
replay, module.replay = module.replay, first
sys.argv = ["handsight", "track", {recording!r}, "--output-folder", {folder!r}]
main()
"""
BYTECODE = Path(tempfile.gettempdir(), f"handsight-bytecode-{os.getuid()}")


def process_seconds(code: str, **environment: str) -> float:
    """Returns the CPU time of a Python process, interpreter included [s]; the machine may be busy.

    Its modules are compiled to bytecode, as pip compiles them when it installs, whatever the environment asks for.
    """
    environment = os.environ | {"PYTHONPYCACHEPREFIX": str(BYTECODE)} | environment
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, env=environment, timeout=600
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def run(repeats: int, *, compile_too: bool) -> list[Row]:
    """Returns a row for each kind of start."""
    kinds = {
        "an empty interpreter": "pass",
        "import handsight": IMPORT,
        "handsight --help": HELP,
        "new process to first correction, warm": FIRST,
    }
    data = ROOT / "src/handsight/data"
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "can.ply"
        model = ObjectModel.cylinder(0.033, 0.122)
        mesh.write_bytes(ply_bytes(Shape(model.vertices, model.faces), 1.0))
        files = {"depth": data / "can.depth.png", "camera": data / "can.camera.json", "mesh": mesh}
        names = {name: str(path) for name, path in files.items()}
        kinds[LOCATES] = LOCATE.format(**names)
        picture = str(Path(folder) / "can.png")
        kinds[f"{LOCATES}, with a picture"] = kinds[LOCATES].replace("]\n", f", '--plot', {picture!r}]\n")
        kinds["handsight track to its first pose, warm"] = TRACK.format(
            recording=str(data / "can.mcap"), folder=folder
        )
        rows = [started(name, code, repeats) for name, code in kinds.items()]
    if compile_too:
        with tempfile.TemporaryDirectory() as folder:
            took = process_seconds(FIRST, HANDSIGHT_CACHE=folder, NUMBA_CACHE_DIR=folder)
        rows.append({"name": "new process to first correction, nothing compiled"} | timing.summary([took]))
    return rows


def started(name: str, code: str, repeats: int) -> Row:
    """Measures one kind of start; the first fills the disk's cache and handsight's, and does not count."""
    try:
        process_seconds(code)
        return {"name": name} | timing.summary([process_seconds(code) for _ in range(repeats)])
    except subprocess.CalledProcessError as error:
        return {"name": name, "failed": error.stderr.decode().strip().splitlines()[-1:]}
