"""Blind problems: contacts and no vision; five contacts with normals, and sixty without.

A slide that the contacts leave open is no error (the judge's rule everywhere); which of several poses that fit is the
true one nobody can tell, so "first" asks for the first answer and "among 8" for any of the first eight.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np

import handsight as hs
from benchmarks import timing, workload
from benchmarks.shapes import bumpy
from benchmarks.workload import REPORTED_ON, Problem
from testbed import scenes

Row = dict[str, Any]
MANY = 60
"""Contacts, such as a scan of the object by touch has."""


def on_mesh(model: hs.ObjectModel, key: int, k: int, contacts: int) -> Problem:
    """Returns a problem of contacts anywhere on a mesh."""
    rng = np.random.default_rng([REPORTED_ON, key, k])
    return Problem("bumpy mesh", model, scenes.random_scene(scenes.anywhere_on(model)(rng, contacts), rng))


def without_normals(problem: Problem) -> Problem:
    """Returns a problem whose contacts are points alone."""
    bare = hs.Contacts(problem.contacts.points_palm, sigma_point=scenes.NOISE[0])
    return replace(problem, scene=replace(problem.scene, contacts=bare))


def run(count: int, seconds: float) -> list[Row]:
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
