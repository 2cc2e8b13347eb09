"""How time grows: with contacts, points of the hand, hypotheses, and triangles of the mesh."""

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

import handsight as hs
from benchmarks import frontier, timing, workload
from benchmarks.kernels import alone
from benchmarks.peers.ours import with_starts
from benchmarks.shapes import bumpy, can
from benchmarks.workload import Peer, Problem
from handsight.errors import InvalidInput
from testbed import scenes

CONTACTS = (2, 3, 5, 8, 12)
OUTSIDE = (0, 10, 30, 100, 200, 500)
STARTS = (1, 10, 100, 1000, 10_000, 100_000, 1_000_000)
HAND = 100
"""Points of the hand in the second curve of hypotheses."""
SUBDIVISIONS = (3, 4, 5, 6, 7, 8)
"""1 280, 5 120, 20 480, 81 920, 327 680 and 1 310 720 triangles."""
MEDIUM = 13_700
"""Asked of the can, which then has 15 908 triangles: what a scanned object has."""
Row = dict[str, Any]


def contacts(peers: dict[str, Peer], chosen: Row, seconds: float) -> list[Row]:
    """Returns cold median time and success of each peer on the box, by number of contacts."""
    rows = []
    for n in CONTACTS:
        problems = [workload.draw("box", workload.NEAR, k, contacts=n) for k in range(100)]
        rows += compared(peers, chosen, problems, seconds / len(CONTACTS), {"contacts": n})
    return rows


def outside(peers: dict[str, Peer], chosen: Row, seconds: float) -> list[Row]:
    """Returns the same by number of points of the hand, for the peers that use them: ours."""
    rows, mine = [], {key: peer for key, peer in peers.items() if key == "ours"}
    for n in OUTSIDE:
        drawn = [workload.draw("box", workload.NEAR, k) for k in range(100)]
        problems = [replace(p, outside=scenes.behind_contacts(p.scene, n)) if n else p for p in drawn]
        rows += compared(mine, chosen, problems, seconds / len(OUTSIDE), {"outside": n})
    return rows


def compared(
    peers: dict[str, Peer], chosen: Row, problems: list[Problem], seconds: float, at: dict[str, int]
) -> list[Row]:
    """Returns a row for each peer: time and success over as many of these problems as time allows."""
    tuned = {key: frontier.tuned(key, peer, "box", workload.NEAR, chosen)[0] for key, peer in peers.items()}
    times: dict[str, list[float]] = {key: [] for key in tuned}
    verdicts: dict[str, list[workload.Verdict]] = {key: [] for key in tuned}
    for peer in tuned.values():
        peer.prepare(problems[0].model)
    with timing.undisturbed(), timing.silent_stderr():
        for peer in tuned.values():
            peer.ready(problems[-1])()
        end = time.perf_counter() + seconds
        for problem in problems:
            if time.perf_counter() > end and all(len(found) >= 5 for found in times.values()):
                break
            for key, peer in tuned.items():
                answer, took = timing.once(peer.ready(problem))
                times[key].append(took)
                T_hat = workload.pose_of(answer)
                if T_hat is not None:
                    verdicts[key].append(workload.judged(problem, T_hat))
    return [
        {"peer": key, "name": tuned[key].name, **at, **timing.summary(times[key])}
        | (workload.accuracy(verdicts[key]) if verdicts[key] else {"success": None})
        for key in tuned
    ]


def hypotheses(seconds: float) -> list[Row]:
    """Returns the time, and hypotheses per second, of a batch of both phases by its size, without and with a hand."""
    rows = []
    problem = workload.draw("box", workload.NEAR, 1)
    held = replace(problem, outside=scenes.behind_contacts(problem.scene, HAND))
    for outside_points, given in ((0, problem), (HAND, held)):
        for starts in STARTS[:4]:  # kernels of few starts and of many are loaded before
            with_starts(given, starts)()
        end, slowest = time.perf_counter() + seconds / 2, 0.0
        for starts in STARTS:
            if time.perf_counter() + 10 * slowest > end and starts > 10_000:
                rows.append({"starts": starts, "outside": outside_points, "skipped": "no time left"})
                continue
            try:
                solve = with_starts(given, starts)
                _, slowest = timing.once(solve)
                times = (
                    timing.hot(solve, min(0.03 * seconds, 1.0), least=2)
                    if 8 * slowest < seconds
                    else [slowest]
                )
            except InvalidInput as error:
                rows.append({"starts": starts, "outside": outside_points, "skipped": str(error)})
                continue
            summary = timing.summary(times)
            rate = starts / summary["median_s"]
            rows.append({"starts": starts, "outside": outside_points, "per_second": rate, **summary})
    return rows


def batch(seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """One correction against one hypothesis of a batch of 4 096, and against one with a hand: rows and ratios.

    On one core, so that the ratio says nothing of who else is busy. Each correction follows a batch in turn: one that
    follows another finds what they share in the cache.
    """
    problem, count = workload.draw("box", workload.NEAR, 1), 4096
    model, scene = problem.model, problem.scene
    given, hand = (model, scene.contacts), scenes.behind_contacts(scene, HAND)
    many = with_starts(problem, count)
    calls = [
        ("one correction", lambda: hs.correct_pose(*given, vision=scene.vision)),
        ("between", many),
        ("with a hand", lambda: hs.correct_pose(*given, vision=scene.vision, outside=hand)),
        (f"a batch of {count}", many),
    ]
    with alone():
        times = timing.in_turn(calls, seconds)
    single, _, held, each = (times[name] for name, _ in calls)
    rows = [
        {"name": "one correction, the public call", **timing.summary(single)},
        {"name": f"the same with {HAND} points of the hand", **timing.summary(held)},
        {"name": f"a batch of {count}, per hypothesis", "per_second": count / float(np.median(each))}
        | timing.summary(each / count),
    ]
    return rows, {
        "batch per hypothesis / single": timing.ratio(each / count, single),
        f"{HAND} points of the hand / none": timing.ratio(held, single),
    }


def meshes(seconds: float) -> list[Row]:
    """Returns the time to build an object from a file, to load it again, and per query, by triangles of its mesh."""
    hs.ObjectModel.from_mesh(*bumpy(2))  # kernels compiled before
    rows = [built("can.ply", *can(MEDIUM, 0.033, 0.115))]
    end = time.perf_counter() + seconds
    for subdivisions in SUBDIVISIONS:
        last = rows[-1]["build_s"] + rows[-1]["load_s"]
        if time.perf_counter() + 5 * last > end:
            triangles = 20 * 4**subdivisions
            rows.append({"shape": "bumpy.ply", "triangles": triangles, "skipped": "no time left"})
            break
        rows.append(built("bumpy.ply", *bumpy(subdivisions)))
    return rows


def built(name: str, vertices: np.ndarray, faces: np.ndarray) -> Row:
    """Measures one mesh: its file to a model with an empty cache, again with a full one, and a batch of queries."""
    with tempfile.TemporaryDirectory() as folder, cache_in(folder):
        path = Path(folder) / name
        trimesh.Trimesh(vertices, faces, process=False).export(path)
        model, build = timing.once(lambda: hs.ObjectModel.from_file(path))
        loads = [timing.once(lambda: hs.ObjectModel.from_file(path))[1] for _ in range(3)]
    points = model.sample(100_000)[0] + 0.005 * np.random.default_rng(0).normal(size=(100_000, 3))
    query = timing.hot(lambda: model.evaluate(points), 0.2, least=3) / len(points)
    return {
        "shape": name,
        "triangles": len(faces),
        "build_s": build,
        "load_s": float(np.median(loads)),
        "query_s": float(np.median(query)),
    }


@contextlib.contextmanager
def cache_in(folder: str) -> Iterator[None]:
    """Keeps objects in a folder, and nowhere else."""
    kept = os.environ.get("HANDSIGHT_CACHE")
    os.environ["HANDSIGHT_CACHE"] = folder
    try:
        yield
    finally:
        del os.environ["HANDSIGHT_CACHE"]
        if kept is not None:
            os.environ["HANDSIGHT_CACHE"] = kept


def run(
    peers: dict[str, Peer], chosen: Row, seconds: float, say: Callable[[str], None]
) -> dict[str, list[Row]]:
    """Returns all four tables, each with its share of the time."""
    parts: dict[str, Callable[[], list[Row]]] = {
        "contacts": lambda: contacts(peers, chosen, 0.2 * seconds),
        "outside": lambda: outside(peers, chosen, 0.1 * seconds),
        "hypotheses": lambda: hypotheses(0.4 * seconds),
        "meshes": lambda: meshes(0.3 * seconds),
    }
    found = {}
    for name, part in parts.items():
        say(f"  growth with {name}")
        found[name] = part()
    return found


if __name__ == "__main__":
    from benchmarks import curves

    sys.exit(curves.main())
