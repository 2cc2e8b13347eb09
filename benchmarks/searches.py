"""Three things beside corrections: descents of many starts, problems without vision, distances to a surface.

Batch: one correction against one descent of many, and against one with points of the hand; on one core.

Blind: contacts and no vision; five contacts with normals, and sixty without. A slide that the contacts leave open is no
error (the judge's rule everywhere); which of several poses that fit is the true one nobody can tell, so "first" asks
for the first answer and "among 8" for any of the first eight.

Closest: handsight's field of a can's mesh, with signed distance, gradient and curvature, against a tree of samples,
queries within 20 mm of it. How exact the field is, is a law of its tests.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

import handsight as hs
from benchmarks import timing, workload
from benchmarks.kernels import alone, descents
from benchmarks.workload import REPORTED_ON, Problem, models
from testbed import scenes

HAND = 100
"""Points of the hand."""
COUNT = 4096
"""Descents of a batch."""
MANY = 60
"""Contacts, such as a scan of the object by touch has."""
SIZE = 0.05
"""Mean radius of the bumpy shape [m]."""
REACH = 0.02
SAMPLES = 200_000
TREE = "scipy cKDTree of samples, 2 cores"
Row = dict[str, Any]


def batch(seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """Returns rows and ratios.

    Each correction follows a batch in turn: one that follows another finds what they share in the cache.
    """
    problem = workload.draw("box", workload.NEAR, 1)
    scene = problem.scene
    hand = scenes.behind_contacts(scene, HAND)
    given = problem.model, scene.contacts
    many = descents(problem, COUNT)
    held = descents(replace(problem, outside=hand), COUNT)
    calls = [
        ("one correction", lambda: hs.correct_pose(*given, vision=scene.vision)),
        ("descents", many),
        ("with a hand", lambda: hs.correct_pose(*given, vision=scene.vision, outside=hand)),
        ("descents with a hand", held),
    ]
    with alone():
        times = timing.in_turn(calls, seconds)
    single = times["one correction"]
    with_hand = times["with a hand"]
    each = times["descents"] / COUNT
    each_held = times["descents with a hand"] / COUNT
    rows = [
        {"name": "one correction, the public call", **timing.summary(single)},
        {"name": f"the same with {HAND} points of the hand", **timing.summary(with_hand)},
        {"name": "a descent of many", "per_second": 1 / float(np.median(each)), **timing.summary(each)},
        {"name": f"a descent of many with {HAND} points of the hand"}
        | {"per_second": 1 / float(np.median(each_held)), **timing.summary(each_held)},
    ]
    return rows, {
        "descent of many / single": timing.ratio(each, single),
        f"{HAND} points of the hand / none": timing.ratio(with_hand, single),
    }


def bumpy(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices [m] and 20 · 4^subdivisions faces of a ball with smooth dents and no symmetry."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    u = np.asarray(ball.vertices)
    x, y, z = u.T
    length = (
        1 + 0.15 * np.sin(3 * x + 1) * np.cos(2 * y) + 0.10 * np.sin(4 * z + 2 * x) + 0.2 * z * z + 0.12 * x
    )
    return SIZE * length[:, None] * u, np.asarray(ball.faces)


def on_mesh(model: hs.ObjectModel, key: int, k: int, contacts: int) -> Problem:
    """Returns a problem of contacts anywhere on a mesh."""
    rng = np.random.default_rng([REPORTED_ON, key, k])
    return Problem("bumpy mesh", model, scenes.random_scene(scenes.anywhere_on(model)(rng, contacts), rng))


def without_normals(problem: Problem) -> Problem:
    """Returns a problem whose contacts are points alone."""
    bare = hs.Contacts(problem.contacts.points_palm, sigma_point=scenes.NOISE[0])
    return replace(problem, scene=replace(problem.scene, contacts=bare))


def blind(count: int, seconds: float) -> list[Row]:
    """Returns a row for each object, and that of sixty bare contacts."""
    model = hs.ObjectModel.from_mesh(*bumpy(4))
    kinds = {
        ("box", "handsight, blind"): lambda k: workload.draw("box", workload.NEAR, k),
        ("bumpy mesh", "handsight, blind"): lambda k: on_mesh(model, 7, k, 5),
        ("bumpy mesh", f"handsight, {MANY} bare contacts"): lambda k: without_normals(
            on_mesh(model, 9, k, MANY)
        ),
    }
    rows = []
    for (object_name, name), draw in kinds.items():
        results: list[tuple[float, bool, bool]] = []
        end = time.perf_counter() + seconds / len(kinds)
        for k in range(count):
            problem = draw(k)
            estimate, took = timing.once(lambda p=problem: hs.correct_pose(p.model, p.contacts))
            right = [workload.judged(problem, mode.T_palm_object).found for mode in estimate.hypotheses[:8]]
            results.append((took, right[0], any(right)))
            if time.perf_counter() > end and len(results) >= 4:
                break
        took, first, among = zip(*results[1:], strict=True)  # the first finds no cache
        success = {"success": float(np.mean(first)), "among_8": float(np.mean(among))}
        rows.append({"object": object_name, "name": name, **success, **timing.summary(took)})
    return rows


def can(radius: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns a closed cylinder about the origin and z, of triangles whose edges are below 4 mm."""
    mesh = trimesh.creation.cylinder(radius, height, sections=128).subdivide_to_size(0.004)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def closest(queries: int, seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """Returns rows, and ratios of time per query (field / peer)."""
    model, rng = hs.ObjectModel.from_mesh(*can(0.033, 0.115)), np.random.default_rng(0)
    surface, normals = models()["can"].sample(queries, seed=3)
    points = surface + rng.uniform(-0.25 * REACH, REACH, (queries, 1)) * normals
    points += 0.25 * REACH * rng.normal(size=points.shape)
    tree = cKDTree(model.sample(SAMPLES)[0])
    times = timing.in_turn(
        [("handsight field", lambda: model.evaluate(points)), (TREE, lambda: tree.query(points, workers=2))],
        seconds,
        most=60,
    )
    rows = [
        {"name": name, "queries": queries} | timing.summary(took / queries) for name, took in times.items()
    ]
    return rows, {f"field / {TREE}": timing.ratio(times["handsight field"], times[TREE])}
