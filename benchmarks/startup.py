"""New processes: CPU time to import, to --help, to the first correction (warm and with nothing compiled) and to a
command's answer; memory.

Warm: kernels and fields are in their cache. First compile: with an empty cache folder, as after installing.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks import ROOT, frontier, timing, workload
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
SOLVES = 20
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


def memory(keys: list[str]) -> list[Row]:
    """Returns the peak resident memory of a process that solves with one peer only [MB]; first, with none."""
    rows = []
    for key in ["none", *keys]:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.startup", key],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=300,
        )
        if done.returncode:
            rows.append({"peer": key, "failed": done.stderr.strip().splitlines()[-1:]})
            continue
        rows.append({"peer": key, **json.loads(done.stdout.strip().splitlines()[-1])})
    base = rows[0].get("peak_mb", 0.0)
    return [row | {"beyond_none_mb": row["peak_mb"] - base} if "peak_mb" in row else row for row in rows]


def solve_a_few(key: str) -> Row:
    """Prints the peak memory of this process after some solves on the box; `none`: after drawing the problems."""
    problems = [workload.draw("box", workload.NEAR, k) for k in range(SOLVES)]
    begin = time.perf_counter()
    if key != "none":
        from benchmarks import peers

        found, _ = peers.made([key])
        peer, _ = frontier.tuned(key, found[key], "box", workload.NEAR, frontier.stored())
        with timing.silent_stderr():
            peer.prepare(problems[0].model)
            for problem in problems:
                workload.pose_of(peer.ready(problem)())
    return {"peak_mb": round(peak_mb(), 1), "seconds": time.perf_counter() - begin}


def peak_mb() -> float:
    """Returns the largest resident memory of this process so far [MB]."""
    try:  # getrusage would count what the parent had when it forked
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024
    except OSError:
        import resource

        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return size / (1024**2 if sys.platform == "darwin" else 1024)


if __name__ == "__main__":
    print(json.dumps(solve_a_few(sys.argv[1])))
