"""Some 2 800 corrections: of eight surfaces and three scans, with all that a correction can be given."""

from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from benchmarks.golden import shapes
from benchmarks.golden.answers import QUICK, Answers, Array, estimate_rows
from benchmarks.golden.shapes import Shape, on, transform
from handsight.correction import Outside, Plane, WeightEvidence

COUNTS = {"vision": 900, "far": 300, "wrong": 300, "blind": 200, "points": 300, "planes": 150, "weight": 200}
COUNTS |= {"scans": 240, "paper": 40, "batch": 150}
"""Problems of each kind; "wrong" have a contact that is none of the object's, "far" a vision that is far off."""
FINGERS = {"blind": (4, 8), "wrong": (4, 8), "paper": (4, 8)}
PAPER = ("paper-lm", "paper-gd", "paper-lm-distance", "paper-gd-distance")
NOISE = 5e-4, 0.035
"""Of a contact's point [m] and normal [rad], per axis."""
Rng = np.random.Generator


def touched(kind: str, shape: Shape, T: Array, rng: Rng, k: int) -> Any:
    """Returns the contacts of the k-th problem of a kind, with the object at T."""
    n = int(rng.integers(*FINGERS.get(kind, (1, 7))))
    points, normals = on(shape, rng, n)
    points = points @ T[:3, :3].T + T[:3, 3] + NOISE[0] * rng.normal(size=(n, 3))
    normals = normals @ T[:3, :3].T + NOISE[1] * rng.normal(size=(n, 3))
    if kind == "wrong":
        points[k % n] += 0.03 * rng.normal(size=3)
        normals[k % n] = rng.normal(size=3)
    lacking = rng.random(n) < (0.2 if kind in ("vision", "wrong") else 0.0)
    felt = [None if none else normal for normal, none in zip(normals, lacking, strict=True)]
    return hs.Contacts(points, felt, sigma_point=NOISE[0], sigma_normal=NOISE[1])


def looked(kind: str, T: Array, rng: Rng) -> Any:
    """Returns vision's pose of an object that is at T."""
    length, angle = (0.085, 0.52) if kind == "far" else (0.02, 0.26)
    error = transform(rng, length, angle)
    seen = np.eye(4)
    seen[:3, :3], seen[:3, 3] = error[:3, :3] @ T[:3, :3], error[:3, 3] + T[:3, 3]
    return hs.PosePrior.from_sigmas(seen, length / 3**0.5, angle / 3**0.5)


def hand_points(shape: Shape, T: Array, rng: Rng, k: int) -> Any:
    """Returns sixty points that cannot be inside an object at T, some 2 mm inside; every second time with links."""
    points, normals = on(shape, rng, 60)
    points = (points + rng.uniform(-0.002, 0.04, (60, 1)) * normals) @ T[:3, :3].T + T[:3, 3]
    links, slacks = rng.integers(0, 6, 60), rng.uniform(0, 2e-3, 60)
    if k % 2:
        return points
    return Outside(points, sigmas=1.5e-3, links=links, slacks=slacks)


def planes(shape: Shape, T: Array, rng: Rng, k: int) -> Any:
    """Returns one or two planes on which an object at T rests, within 4 mm."""
    places, found = shape[0] @ T[:3, :3].T + T[:3, 3], []
    for _ in range(1 + k % 2):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        found.append(Plane(places[np.argmin(places @ way)] + 0.004 * rng.normal() * way, way, 1e-3))
    return Outside(planes=found)


def weight(shape: Shape, T: Array, rng: Rng, k: int) -> Any:
    """Returns the measured centre of mass of an object at T, every fifth time 4 cm beside the true one."""
    middle = (shape[0].min(axis=0) + shape[0].max(axis=0)) / 2
    off = (0.04 if k % 5 == 0 else 3e-3) * rng.normal(size=3)
    return WeightEvidence(middle, T[:3, :3] @ middle + T[:3, 3] + off, 9e-6 * np.eye(3))


def problem(kind: str, shape: Shape, rng: Rng, k: int) -> dict[str, Any]:
    """Returns the arguments of `correct_pose` in the k-th problem of a kind, beside the model."""
    T = transform(rng, 0.15, 3.0)
    given: dict[str, Any] = {"contacts": touched(kind, shape, T, rng, k), "vision": looked(kind, T, rng)}
    if kind == "blind":
        given["vision"] = None
    if kind == "points":
        given["outside"] = hand_points(shape, T, rng, k)
    if kind == "planes":
        given["outside"] = planes(shape, T, rng, k)
    if kind == "weight":
        given["weight"] = weight(shape, T, rng, k)
    if kind == "paper":
        given["method"] = PAPER[k % 4]
    return given


def answered(_: Path, *, quick: bool) -> Answers:
    """Returns the answers of `correct_pose` to each problem, and of `correct_poses` to those of the last kind."""
    surfaces = shapes.made()
    models = shapes.models(surfaces)
    together: dict[str, list[tuple[str, Any]]] = {}
    for number, (kind, count) in enumerate(COUNTS.items()):
        names = [name for name in models if name.startswith("scan") == (kind == "scans")]
        names = names[:2] if kind == "paper" else names
        for k in range(0, count, QUICK if quick else 1):
            rng = np.random.default_rng([number, k])
            name = names[rng.integers(len(names))]
            given = problem(kind, surfaces[name.removeprefix("scan of ")], rng, k)
            if kind == "batch":
                together.setdefault(name, []).append((f"{kind}/{k}", given))
            else:
                yield (
                    f"{kind}/{k}",
                    estimate_rows(hs.correct_pose(models[name], given.pop("contacts"), **given)),
                )
    for name, problems in together.items():
        found = hs.correct_poses(models[name], [given for _, given in problems])
        yield from zip((key for key, _ in problems), map(estimate_rows, found), strict=True)
