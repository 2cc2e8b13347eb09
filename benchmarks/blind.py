"""Blind problems: contacts and no vision. Scaling Series against handsight's own blind search.

Five contacts with normals for both; sixty contacts without normals for handsight alone.

A slide that the contacts leave open is no error (the judge's rule everywhere); which of several poses that fit is the
true one nobody can tell, so "first" asks for the first answer and "among 8" for any of the first eight.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np

import handsight as hs
from benchmarks import timing, workload
from benchmarks.peers.scaling_series import ScalingSeries
from benchmarks.shapes import bumpy
from benchmarks.workload import Problem
from testbed import scenes

Row = dict[str, Any]
MANY = 60
"""Contacts, such as a scan of the object by touch has."""


def problems(name: str, count: int, seed: int = workload.REPORTED_ON) -> list[Problem]:
    """Returns problems of five contacts on the box, or anywhere on a bumpy mesh."""
    if name == "box":
        return [workload.draw("box", workload.NEAR, k, seed) for k in range(count)]
    vertices, faces = bumpy(4)
    model, found = hs.ObjectModel.from_mesh(vertices, faces), []
    touch = scenes.anywhere_on(model)
    for k in range(count):
        rng = np.random.default_rng([seed, 7, k])
        found.append(Problem(name, model, scenes.random_scene(touch(rng), rng)))
    return found


def ours(problem: Problem) -> np.ndarray:
    """Returns up to eight modes (k, 4, 4), best first."""
    estimate = hs.correct_pose(problem.model, problem.contacts)
    return np.stack([h.T_palm_object for h in estimate.hypotheses])[:8]


def many(count: int, seconds: float) -> Row:
    """Returns the row of sixty contacts without normals, anywhere on the bumpy mesh."""
    model, results = problems("bumpy mesh", 1)[0].model, []
    touch, end = scenes.anywhere_on(model), time.perf_counter() + seconds
    for k in range(count):
        rng = np.random.default_rng([workload.REPORTED_ON, 9, k])
        scene = scenes.random_scene(touch(rng, MANY), rng)
        bare = hs.Contacts(scene.contacts.points_palm, sigma_point=scenes.NOISE[0])
        problem = Problem("bumpy mesh", model, replace(scene, contacts=bare))
        Ts, took = timing.once(lambda p=problem: ours(p))
        right = [workload.judged(problem, T).found for T in Ts]
        results.append((took, right[0], any(right)))
        if time.perf_counter() > end and k >= 2:
            break
    return summary("bumpy mesh", f"handsight, {MANY} bare contacts", results[1:])


def summary(object_name: str, name: str, results: list[tuple[float, bool, bool]]) -> Row:
    """Returns a row of results: seconds, whether the first mode is right, whether any is."""
    took, first, among = zip(*results, strict=True)
    success = {"success": float(np.mean(first)), "among_8": float(np.mean(among))}
    return {"object": object_name, "name": name, **success, **timing.summary(took)}


def run(count: int, seconds: float) -> list[Row]:
    """Returns a row for each method and object."""
    series, rows = ScalingSeries(), []
    methods = {"handsight, blind": ours, series.name: series.solve}
    for name in ("box", "bumpy mesh"):
        drawn = problems(name, count)
        found: dict[str, list[tuple[float, bool, bool]]] = {key: [] for key in methods}
        for solve in methods.values():
            solve(drawn[0])
        end = time.perf_counter() + 0.45 * seconds
        for problem in drawn:
            if time.perf_counter() > end and len(found[series.name]) >= 3:
                break
            for key, solve in methods.items():
                Ts, took = timing.once(lambda s=solve, p=problem: s(p))
                right = [workload.judged(problem, T).found for T in Ts]
                found[key].append((took, right[0], any(right)))
        rows += [summary(name, key, results) for key, results in found.items()]
    return [*rows, many(count, 0.1 * seconds)]
