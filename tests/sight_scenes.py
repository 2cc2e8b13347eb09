"""Depth images of objects on a table, drawn, with noise that is correlated as a structured-light camera's is."""

import numpy as np
from scipy.ndimage import gaussian_filter, minimum_filter

import handsight as hs
from handsight import se3
from handsight.vision.camera import PinholeCamera

CAMERA = PinholeCamera(np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]]), (320, 240))
TABLE = np.array([[-0.4, -0.4, 0], [0.4, -0.4, 0], [0.4, 0.4, 0], [-0.4, 0.4, 0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])
DISPARITY = 2.85e-3


def letter():
    """Vertices and faces of an object without symmetry: three boxes on top of and beside each other."""
    parts = [
        ((0.09, 0.06, 0.03), (0, 0, 0.015)),
        ((0.03, 0.05, 0.06), (-0.025, 0.0, 0.05)),
        ((0.02, 0.03, 0.03), (0.03, -0.01, 0.04)),
    ]
    vertices, faces = [], []
    for size, middle in parts:
        box = hs.ObjectModel.box(size)
        faces.append(box.faces + sum(map(len, vertices)))
        vertices.append(box.vertices + middle)
    return np.concatenate(vertices), np.concatenate(faces)


def looking(rng, distance):
    """T_camera_table of a camera that looks down on the table's middle."""
    height, around = rng.uniform(np.deg2rad(30), np.deg2rad(70)), rng.uniform(0, 2 * np.pi)
    eye = distance * np.array(
        [np.cos(height) * np.cos(around), np.cos(height) * np.sin(around), np.sin(height)]
    )
    z = -eye / distance
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    return se3.inverse(se3.compose(np.column_stack([x, np.cross(z, x), z]), eye))


def on_table(rng, shapes, gap=0.09):
    """Poses on the table of shapes (vertices, faces): the first in its middle, the others around it, turned at will."""
    Ts = []
    for k, _ in enumerate(shapes):
        side, spin = rng.uniform(0, 2 * np.pi), rng.uniform(-np.pi, np.pi)
        place = gap * min(k, 1) * np.array([np.cos(side), np.sin(side), 0])
        Ts.append(se3.compose(se3.rotation_exp(np.array([0, 0, spin])), place))
    return np.stack(Ts)


def drawn(T_camera_table, shapes, Ts_table_object, camera=CAMERA):
    """Depth and labels of the shapes, numbered from 0 on, and the table's: -2."""
    vertices, faces, labels, count = [TABLE], [SQUARE], [np.full(2, -2)], len(TABLE)
    for k, ((points, triangles), T) in enumerate(zip(shapes, Ts_table_object, strict=True)):
        vertices.append(se3.apply(T, points))
        faces.append(triangles + count)
        labels.append(np.full(len(triangles), k))
        count += len(points)
    placed = se3.apply(T_camera_table, np.concatenate(vertices))
    return camera.draw(placed, np.concatenate(faces), np.concatenate(labels))


def noisy(depth, rng):
    """As a camera has it: correlated and rounded disparity, pixels lost behind edges; 0 where there is none."""
    there = np.isfinite(depth)
    z = np.where(there, depth, 1.0)
    grain = gaussian_filter(rng.normal(size=z.shape), 2.0)
    disparity = 1 / (DISPARITY * z) + 0.35 * grain / grain.std() + 0.25 * rng.normal(size=z.shape)
    z = 1 / (DISPARITY * np.maximum(np.round(disparity), 1))
    behind = np.where(there, depth, 9.0) - minimum_filter(np.where(there, depth, 9.0), size=5) > 0.02
    lost = (behind & (rng.random(z.shape) < 0.6)) | (rng.random(z.shape) < 0.005)
    return np.where(there & ~lost, z, 0).astype(np.float32)
