"""Depth images of a hand that holds something over a table, drawn; its joints are believed with an error."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from handsight import se3
from handsight.camera import Camera
from sight_scenes import noisy

CAMERA = Camera(np.array([[525.0, 0, 319.5], [0, 525, 239.5], [0, 0, 1]]), (640, 480))
TABLE = 1.5 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])
HAND, OBJECT, ARM, PLANE = 0, 1, 2, 3


ONE_DEGREE = float(np.deg2rad(1.0))


@dataclass(frozen=True, eq=False)
class HandScene:
    """One picture, and what is true of it."""

    depth: np.ndarray
    """(h, w) [m], 0 where there is none."""
    joints: dict[str, float]
    """As they are believed to be [rad]."""
    T_camera_palm: np.ndarray
    hand_pixels: int
    """Of the hand that are seen."""
    hidden: float
    """Share of the hand's pixels that the object covers."""


def curled(hand: Any, rng: np.random.Generator) -> dict[str, float]:
    """Joint positions of a hand that closes around something: each within its range, flexion somewhere in its middle."""
    low, high = np.where(np.isfinite(hand.limits), hand.limits, [-0.5, 1.0]).T
    wide = high - low
    middle = np.clip(0.0, low, high)
    share = np.where(wide > 1.2, rng.uniform(0.25, 0.65) + rng.uniform(-0.15, 0.15, len(low)), 0.0)
    spread = rng.uniform(-0.15, 0.15, len(low)) * wide
    return dict(
        zip(
            hand.joint_names,
            np.clip(middle + share * (high - middle) + spread * (share == 0), low, high),
            strict=True,
        )
    )


def hand_scene(
    hand: Any,
    shapes: tuple[Any, Any, Any],
    rng: np.random.Generator,
    *,
    sigma_joint: float = ONE_DEGREE,
    held: bool = True,
    noise: Any = noisy,
) -> HandScene:
    """A HandScene; `shapes`: of the hand, of what is held (vertices, faces), and of an arm or None.

    The arm is a HandShape in the palm's axes too; views in which little of the hand is seen are drawn again.
    """
    while True:
        believed = curled(hand, rng)
        joints = {name: value + sigma_joint * rng.normal() for name, value in believed.items()}
        scene = _drawn(hand, shapes, joints, rng, held)
        if scene is not None:
            depth, T, pixels, hidden = scene
            return HandScene(noise(depth, rng), believed, T, pixels, hidden)


def _drawn(hand: Any, shapes: Any, joints: Any, rng: Any, held: bool) -> Any:
    shape, (points, triangles), arm = shapes
    vertices = shape.vertices_palm(joints)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    grasp = hand.Ts_palm_tip(joints)[:, :3, 3].mean(axis=0)
    parts = [(vertices, shape.faces, HAND)]
    if held:
        thing = points - (points.min(axis=0) + points.max(axis=0)) / 2
        place = grasp + 0.35 * (grasp - middle) + 0.01 * rng.normal(size=3)
        parts.append((thing @ se3.random(rng)[:3, :3].T + place, triangles, OBJECT))
    if arm is not None:
        parts.append((*arm(joints), ARM))
    T = se3.random(rng)
    T[:3, 3] = 0
    aim = np.array([rng.normal(0, 0.08), rng.normal(0, 0.06), rng.uniform(0.55, 1.1)])
    T[:3, 3] = aim - T[:3, :3] @ middle
    normal = np.array([0.0, -np.cos(0.7), -np.sin(0.7)]) + 0.2 * rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    low = min((se3.apply(T, v) @ normal).min() for v, _, _ in parts)
    plane = _plane(normal, low - rng.uniform(0.0, 0.15))
    placed, faces, labels, count = [], [], [], 0
    for v, f, label in parts:
        placed.append(se3.apply(T, v))
        faces.append(f + count)
        labels.append(np.full(len(f), label))
        count += len(v)
    alone = np.isfinite(CAMERA.draw(placed[0], parts[0][1]).depth).sum()
    placed.append(plane)
    faces.append(SQUARE + count)
    labels.append(np.full(2, PLANE))
    drawn = CAMERA.draw(np.concatenate(placed), np.concatenate(faces), np.concatenate(labels))
    pixels = int((drawn.labels == HAND).sum())
    if pixels < 1500 * (CAMERA.matrix[0, 0] / 525) ** 2 or alone < 1.0:
        return None
    return drawn.depth, T, pixels, 1 - pixels / alone


def _plane(normal: Any, offset: float) -> Any:
    x = np.cross(normal, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(normal, x)
    middle = offset * normal
    return middle + np.array([0, 0, 0.9]) - normal * normal[2] * 0.9 + TABLE[:, :1] * x + TABLE[:, 1:2] * y


def error(rng: np.random.Generator, length: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """A shift (3,) and a turn (3, 3) of that size, each in a random direction."""
    shift, axis = rng.normal(size=(2, 3))
    return length * shift / np.linalg.norm(shift), se3.rotation_exp(angle * axis / np.linalg.norm(axis))


def moved(T_camera_palm: np.ndarray, shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The palm's pose off by those, turned about its origin."""
    T = T_camera_palm.copy()
    T[:3, :3] = turn @ T[:3, :3]
    T[:3, 3] += shift
    return T
