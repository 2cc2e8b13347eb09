"""Shapes and data that the tests of objects share."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from handsight.objects import Triangles

CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
BOX_FACES = [
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
]  # fmt: skip


def box_mesh(size=(0.06, 0.09, 0.14)):
    return CORNERS * size, np.array(BOX_FACES)


def divided(vertices, faces, times):
    """Each triangle cut into four, `times` times."""
    for _ in range(times):
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        corners = np.stack([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2], axis=1)
        base = 6 * np.arange(len(faces))[:, None, None]
        quarters = np.array([(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)])
        vertices, faces = corners.reshape(-1, 3), (base + quarters).reshape(-1, 3)
        vertices, which = np.unique(vertices.round(12), axis=0, return_inverse=True)
        faces = which.reshape(-1)[faces]
    return vertices, faces


def holed_box(size=(0.06, 0.09, 0.14)):
    """A box with an 11 mm hole, wound outwards, in the middle of its +x side."""
    vertices, faces = divided(*box_mesh(size), 3)
    middle = vertices[faces].mean(axis=1)
    hole = (middle[:, 0] > 0.49 * size[0]) & (np.abs(middle[:, 1:]).max(axis=1) < 0.006)
    assert hole.any()
    return vertices, faces[~hole]


def prism(n, radius=0.04, height=0.1):
    """A prism over a regular polygon, axis z."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    vertices = np.vstack([np.column_stack([ring, np.full(n, z)]) for z in (-height / 2, height / 2)])
    side = [(i, (i + 1) % n, n + (i + 1) % n) for i in range(n)]
    side += [(i, n + (i + 1) % n, n + i) for i in range(n)]
    caps = [(0, i + 1, i) for i in range(1, n - 1)] + [(n, n + i, n + i + 1) for i in range(1, n - 1)]
    return vertices, np.array(side + caps)


def moebius(n, radius=0.05, half=0.012):
    """A strip of n pieces that is turned over once on its way round: it has one side."""
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    arm = np.cos(turn / 2)[:, None] * ring + np.sin(turn / 2)[:, None] * [0, 0, 1]
    i, j = np.arange(n), (np.arange(n) + 1) % n
    up, down = np.where(i + 1 < n, j, j + n), np.where(i + 1 < n, j + n, j)
    faces = np.vstack([np.stack([i, i + n, up], axis=1), np.stack([i + n, down, up], axis=1)])
    return np.vstack([radius * ring + half * arm, radius * ring - half * arm]), faces


def triangles(vertices, faces):
    return Triangles(np.asarray(vertices, dtype=float), np.asarray(faces))


def data_file(name):
    """A file of the shared test data; skips the test where it is not there."""
    here = Path(__file__).resolve().parents[2]
    folder = Path(os.environ.get("HANDSIGHT_DATA", here.parent / "shared" / "data"))
    path = folder / name
    if not path.exists():
        pytest.skip(f"{path} is not there: set HANDSIGHT_DATA to the folder with the test data")
    return path
