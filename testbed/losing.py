"""Sequences of depth images in which an object is hidden, or lost: drawn ones, and real ones with a drawn occluder.

A drawn object stands on a table with two others close to it, and after `EVENT` images something happens to it
(`KINDS`). An occluder is a Shadow hand, whose joints are believed a degree off, or a board; it comes from aside.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

import handsight as hs
from handsight import se3
from handsight.camera import Camera
from handsight.vision import hand_mask
from testbed import sight_scenes as scenes
from testbed.real_frames import RealFrame
from testbed.report import Array

KINDS = {
    "leaves": "it is moved away along the table at .6 to 2 m/s, at once and out of the picture",
    "hidden": "a board comes in front of all of it",
    "swapped": "under a hand it is taken away, or another object put in its place",
    "jumps": "it is 30 cm away, turned or not",
    "exchanged": "another object is in its place",
    "neighbour": "it is taken away, or lifted away towards a neighbour",
    "stays": "it stays, and a hand or a board hides 30 to 80 % of it",
}
IMAGES, EVENT = 24, 8
RATE = 30.0
LEAST_PIXELS, LEAST_VISIBLE = 1000, 0.5
"""Of the object's silhouette at first, and the share of it that its neighbours leave visible."""
COMES = 8
"""Images in which an occluder comes."""


class Instant(NamedTuple):
    """One image of a sequence, and what is true."""

    stamp: float
    depth: Array
    """(h, w) [m]; 0 where there is none."""
    hand: Array | None
    """(h, w) the hand's pixels as the believed joints say; None: there is none, or it is not told."""
    T_camera_object: Array | None
    """(4, 4); None: the object is not there."""
    hidden: float
    """Share of the silhouette of the object, or, where it is gone, of where it last was, that is covered."""


@dataclass(frozen=True, eq=False)
class Occluder:
    """A body before an object."""

    vertices: Array
    """(k, 3)"""
    believed: Array | None
    """(k, 3) the vertices of a hand as its joints say; None: it is no hand."""
    faces: Array
    aside: float
    """Direction that it comes from, around the line of sight [rad]."""
    distance: float
    """From the object [m]."""

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, hand: bool) -> "Occluder":
        """Returns a hand in any posture, or a board."""
        distance, aside = rng.uniform(0.01, 0.05), rng.uniform(0, 2 * np.pi)
        if not hand:
            board = hs.ObjectModel.box((0.4, 0.4, 0.04))
            return cls(board.vertices, None, board.faces, aside, distance)
        shape, R = scenes.shadow_hand(), se3.random(rng)[:3, :3]
        joints = {j: rng.uniform(*scenes.BENT) * (not j.endswith(scenes.SIDEWAYS)) for j in shape.joints}
        believed = {j: angle + scenes.JOINTS * rng.normal() for j, angle in joints.items()}
        vertices, middle = shape.vertices_palm(joints) @ R.T, shape.vertices_palm(joints).mean(axis=0) @ R.T
        return cls(
            vertices - middle, shape.vertices_palm(believed) @ R.T - middle, shape.faces, aside, distance
        )

    def pose(self, model: hs.ObjectModel, T_camera_object: Array, lateral: float) -> Array:
        """Returns the occluder's pose (4, 4) before the object, so far aside of the line of sight [m]."""
        center = se3.apply(T_camera_object, model.center_object[None])[0]
        sight = center / np.linalg.norm(center)
        x, y = np.linalg.svd(sight[None])[2][1:]
        way = np.cos(self.aside) * x + np.sin(self.aside) * y
        R = np.eye(3) if self.believed is not None else np.column_stack([way, np.cross(sight, way), sight])
        deep = (self.vertices @ R.T @ sight).max()
        return se3.compose(R, center - sight * (model.radius + self.distance + deep) + lateral * way)

    def laterals(self, model: hs.ObjectModel, T_camera_object: Array, camera: Camera, share: float) -> Array:
        """Returns how far aside (IMAGES,) [m] the occluder is in each image, which in the end hides about a share."""
        alone = camera.draw(se3.apply(T_camera_object, model.vertices), model.faces).depth
        silhouette, away = np.isfinite(alone), model.radius + 0.25

        def hides(lateral: float) -> float:
            placed = se3.apply(self.pose(model, T_camera_object, lateral), self.vertices)
            return float((camera.draw(placed, self.faces).depth < alone)[silhouette].mean())

        places = np.linspace(0, away, 26)
        end = places[np.argmin([abs(hides(place) - share) for place in places])]
        return np.asarray(end + np.maximum(0, 1 - np.arange(IMAGES) / COMES) * (away - end))


def occluded(
    model: hs.ObjectModel,
    frames: Sequence[RealFrame],
    name: str,
    occluder: Occluder,
    share: float,
    *,
    told: bool,
) -> Iterator[Instant]:
    """Yields real images of an object with a drawn occluder before it; told: the hand's pixels are known."""
    rng, truths = np.random.default_rng(0), [_instance(frame, name) for frame in frames]
    laterals = occluder.laterals(model, truths[0].T_camera_object, frames[0].camera, share)
    for k, (frame, truth) in enumerate(zip(frames, truths, strict=True)):
        placed = occluder.pose(model, truth.T_camera_object, laterals[min(k, IMAGES - 1)])
        drawn = frame.camera.draw(se3.apply(placed, occluder.vertices), occluder.faces).depth
        depth = np.nan_to_num(frame.depth)
        before = drawn < np.where(depth > 0, depth, np.inf)
        depth = np.where(before, scenes.noisy(drawn, rng), depth)
        # As a camera does, it loses some of the pixels beside an edge.
        depth[binary_dilation(before, iterations=2) & ~before & (rng.random(depth.shape) < 0.6)] = 0
        mask = None
        if told and occluder.believed is not None:
            mask = hand_mask(frame.camera, depth, occluder.believed, occluder.faces, placed)
        alone = np.isfinite(
            frame.camera.draw(se3.apply(truth.T_camera_object, model.vertices), model.faces).depth
        )
        hidden = float(1 - (truth.visible & ~before).sum() / alone.sum())
        yield Instant(k / RATE, depth.astype(np.float32), mask, truth.T_camera_object, max(hidden, 0.0))


def _instance(frame: RealFrame, name: str) -> Any:
    return next(each for each in frame.instances if each.name == name)


def lost(kind: str, models: Sequence[hs.ObjectModel], rng: np.random.Generator) -> Iterator[Instant]:
    """Yields a drawn sequence of the first of four models with the next two around it; the last may replace it."""
    model, camera = models[0], scenes.WIDE
    while True:
        T_camera_table = scenes.looking(rng, rng.uniform(0.5, 0.95))
        Ts = scenes.close_together(models[:3], rng)
        drawn = _drawn(camera, T_camera_table, models[:3], Ts, None)
        alone = np.isfinite(camera.draw(se3.apply(T_camera_table @ Ts[0], model.vertices), model.faces).depth)
        if alone.sum() > LEAST_PIXELS and (drawn.labels == 0).sum() > LEAST_VISIBLE * alone.sum():
            break
    way = np.append(_on_circle(rng), 0)
    to_neighbour = Ts[1][:3, 3] * [1, 1, 0] - Ts[0][:3, 3] * [1, 1, 0]
    to_neighbour /= np.linalg.norm(to_neighbour)
    fast, jump, drift = rng.uniform(0.6, 2), 0.3 * np.append(_on_circle(rng), 0), 0.003 * rng.normal(size=2)
    turn = se3.compose(se3.rotation_exp(np.array([0, 0, rng.uniform(-np.pi, np.pi)])), np.zeros(3))
    first, told = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
    occluder = Occluder.drawn(rng, hand=kind == "swapped" or (kind == "stays" and first))
    share = rng.uniform(0.3, 0.8) if kind == "stays" else 1.0
    if kind in ("swapped", "hidden", "stays"):
        laterals = occluder.laterals(model, T_camera_table @ Ts[0], camera, share)
    for k in range(IMAGES):
        since, bodies, placed, there = max(k - EVENT, 0), list(models[:3]), None, True
        T = Ts[0].copy()
        T[:2, 3] += drift * k
        where = T
        if kind == "leaves":
            T = T @ np.eye(4)
            T[:3, 3] += way * fast * since / RATE
        elif kind == "jumps" and since:
            T = T @ turn if first else T.copy()
            T[:3, 3] += jump
        elif kind == "neighbour" and since:
            T = T.copy()
            T[:3, 3] += to_neighbour * fast * since / RATE
            T[2, 3] += (0.3 + models[1].diameter) * min(1, since / 4)
            there = first
        elif (kind == "exchanged" and since) or (kind == "swapped" and k > COMES + 1):
            there, bodies[0] = False, models[3]
            T = _in_place(T, model, models[3])
        if kind in ("swapped", "hidden", "stays"):
            lateral = laterals[k]
            if kind == "swapped" and k > COMES + 3:
                lateral = (k - COMES - 3) / 6 * laterals[0]
            placed = occluder.pose(model, T_camera_table @ where, lateral)
        gone = (kind == "neighbour" and not there) or (kind == "swapped" and not there and first)
        shown, at = (bodies[1:], Ts[1:]) if gone else (bodies, [T, *Ts[1:]])
        image = _drawn(camera, T_camera_table, shown, at, None if placed is None else (occluder, placed))
        depth = scenes.noisy(image.depth, rng).astype(np.float32)
        mask = None
        if placed is not None and occluder.believed is not None and told:
            mask = hand_mask(camera, depth, occluder.believed, occluder.faces, placed)
        T_true = T_camera_table @ (T if there else where)
        alone = np.isfinite(camera.draw(se3.apply(T_true, model.vertices), model.faces).depth)
        seen = image.labels == 0 if there else image.labels != OCCLUDER
        hidden = float(1 - (seen & alone).sum() / max(alone.sum(), 1))
        yield Instant(k / RATE, depth, mask, T_true if there else None, hidden)


OCCLUDER = -3
"""Label of an occluder's pixels; -2 is the table's."""


def _on_circle(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _in_place(T: Array, model: hs.ObjectModel, other: hs.ObjectModel) -> Array:
    """Returns the pose (4, 4) of another object on the table where an object was."""
    T = T @ se3.compose(np.eye(3), model.center_object - other.center_object)
    T[2, 3] -= se3.apply(T, other.vertices)[:, 2].min()
    return T


def _drawn(
    camera: Camera,
    T_camera_table: Array,
    bodies: Sequence[hs.ObjectModel],
    Ts_table_object: Sequence[Array],
    occluder: tuple[Occluder, Array] | None,
) -> Any:
    """Returns the picture of bodies, labelled from 0 on, on the table, -2, behind an occluder."""
    parts = [
        (m.vertices, m.faces, k, T_camera_table @ T)
        for k, (m, T) in enumerate(zip(bodies, Ts_table_object, strict=True))
    ]
    parts.append((4 * scenes.TABLE, scenes.SQUARE, -2, T_camera_table))
    if occluder is not None:
        parts.append((occluder[0].vertices, occluder[0].faces, OCCLUDER, occluder[1]))
    starts = np.cumsum([0, *(len(vertices) for vertices, *_ in parts)])
    vertices = np.concatenate([se3.apply(T, vertices) for vertices, _, _, T in parts])
    faces = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=False)])
    return camera.draw(vertices, faces, np.concatenate([np.full(len(f), label) for _, f, label, _ in parts]))
