"""An object that a hand holds, from depth images in one grip after another: a surface of each grip, aligned afterwards.

In a grip the object is static in the palm, so its views need no alignment. A new grip is noticed where images no longer
show the surface where the palm would hold it. Its surface is then registered to the first one's (many starts, point to
plane), and merged with it where it fits, and where all poses that fit give the same object.
"""

from copy import deepcopy
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from handsight import se3
from handsight._kernels.image import depth_term
from handsight._kernels.image.vision_records import DEPTH_POINT
from handsight.camera import Camera
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.vision.candidates import NOTHING_KNOWN, candidates_at, poses_of
from handsight.vision.reconstruction.completion import MapJudge, parts_of
from handsight.vision.reconstruction.reconstruct import RECONSTRUCTION, STAGES, Reconstruction, View
from handsight.vision.reconstruction.segmentation import IN_HAND_BOUNDS
from handsight.vision.reconstruction.volume import SurfacePoints, Volume


class GripOptions(NamedTuple):
    """`GripOptions` say when a grip is a new one, what a hand can hold, and how grips are aligned."""

    min_views: int = 5  # of a grip whose surface is used
    most: int = 8  # grips that are kept; one takes 60 MB
    on_surface: float = 0.006  # depth so near to the surface shows it [m]
    behind: float = 0.012  # depth so far behind it contradicts it [m]
    min_agreement: float = 0.6  # share on it of the depths on it or behind it, or the grip is new
    min_points: int = 60  # of a surface, in an image, that can show a new grip
    max_gap: float = 0.035  # from a fingertip's centre to what it holds: tip, hole, errors of joints [m]
    slack: float = 0.015  # what is held is nearer to the grip's middle than the fingertips, but for this [m]
    max_cut: float = 0.01  # share of the surface's points that may be at the edge of what is fused
    starts: int = 2000  # poses of which a registration starts
    spread: float = 0.02  # of their positions [m]
    points: int = 500  # that are registered
    best: int = 30  # of the poses of the coarse stage that are refined
    distinct: tuple[float, float] = (0.01, float(np.deg2rad(10)))  # two poses beyond this differ [m, rad]
    clearly_worse: float = 0.1  # by so much cost a pose is not a rival of the best one
    odd: float = 0.008  # so far from its own surface a symmetry takes no point into free space [m]
    max_odd: float = 0.02  # share of the points that may be so, by noise


GRIP = GripOptions()


@dataclass(slots=True, eq=False)
class Grip:
    """A `Grip` is what was fused while the hand did not move on the object."""

    reconstruction: Reconstruction
    tips_object: Array  # (k, 3) fingertips that hold the object, in its frame [m]
    surface: SurfacePoints | None = None  # what the fingers hold, as of `views` views; None: nothing
    views: int = 0

    @property
    def volume(self) -> Volume:
        """What was fused."""
        return self.reconstruction.volume

    def shown_by(self, view: View) -> bool:
        """Returns whether an image shows the surface where the palm would hold it, as far as it contradicts it."""
        if self.volume.views >= 2 * max(self.views, 1):
            self.surface, self.views = in_fingers(self.volume, self.tips_object)[0], self.volume.views
        if self.surface is None:
            return True
        camera, T = self.reconstruction.camera, view.T_camera_object
        points, normals = se3.apply(T, self.surface.points), self.surface.normals @ T[:3, :3].T
        facing = (points * normals).sum(axis=1) < -0.3 * np.linalg.norm(points, axis=1)
        places = np.rint(camera.project(points))
        inside = facing & ((places >= 0) & (places < camera.size)).all(axis=1)
        columns, rows = places[inside].astype(int).T
        depth = view.depth[rows, columns]
        gap = (depth - points[inside, 2])[depth > 0]
        on, behind = (np.abs(gap) < GRIP.on_surface).sum(), (gap > GRIP.behind).sum()
        return bool(on >= GRIP.min_agreement * (on + behind) or on + behind < GRIP.min_points)


class InHandReconstruction:
    """An `InHandReconstruction` is a surface that grows view by view in each grip."""

    def __init__(self, camera: Camera) -> None:
        self._camera, self.grips = camera, list[Grip]()
        self._last: Grip | None = None
        self.forgotten = 0  # number of views in grips that were too short, such as while fingers closed

    @property
    def views(self) -> int:
        """Number of views in the surfaces."""
        return sum(grip.volume.views for grip in self.grips)

    def grow(self, view: View, *, estimate: bool = False) -> View:
        """Fuses a view into the grip that it shows, or into a new one, and returns it; its pose is not estimated."""
        if view.tips_object is None:
            raise InvalidInput("view.tips_object: expected the fingertips that hold the object, got None")
        recent = sorted(self.grips, key=lambda grip: grip is self._last)
        grip = next((grip for grip in reversed(recent) if grip.shown_by(view)), None)
        if grip is None:
            kept = [each for each in self.grips if each.volume.views >= GRIP.min_views]
            if len(kept) == GRIP.most:
                kept.remove(min(kept, key=lambda each: each.volume.views))
            self.forgotten += self.views - sum(each.volume.views for each in kept)
            self.grips = kept
            grip = Grip(Reconstruction(self._camera, IN_HAND_BOUNDS), view.tips_object)
            self.grips.append(grip)
        self._last = grip
        grip.reconstruction.grow(view, estimate=False)
        return view

    def merged(self) -> tuple[Volume, SurfacePoints, list[str]]:
        """Returns the volume of all grips, in the frame of the one with most views, what the fingers hold in it, and
        sentences that say which grips are in it. Raises InvalidInput where nothing is held."""
        grips = sorted(self.grips, key=lambda grip: -grip.volume.views)
        grips = [each for each in grips if each.volume.views >= GRIP.min_views] or grips[:1]
        found = [(grip, *in_fingers(grip.volume, grip.tips_object)) for grip in grips]
        others = [(grip, surface) for grip, surface, _ in found if surface is not None]
        left = [(grip, why) for grip, surface, why in found if surface is None]
        if not others:
            why = left[0][1] if left else "expected an object in the hand, got none"
            raise InvalidInput(f"recording: {why}")
        first, surface = others.pop(0)
        while others:
            results = [_joined(first, surface, grip, own) for grip, own in others]
            best = next((k for k, result in enumerate(results) if not isinstance(result, str)), 0)
            if isinstance(joined := results[best], str):
                left += [(grip, str(why)) for (grip, _), why in zip(others, results, strict=True)]
                break
            first, surface = joined
            others.pop(best)
        sentences = [f"{len(found) - len(left)} of {len(found)} grips aligned"] if len(found) > 1 else []
        sentences += [f"left out a grip of {grip.volume.views} views: {why}" for grip, why in left]
        if self.forgotten:
            sentences.append(f"left out {self.forgotten} views of grips that were too short")
        return first.volume, surface, sentences


def _joined(
    first: Grip, surface: SurfacePoints, other: Grip, own: SurfacePoints
) -> tuple[Grip, SurfacePoints] | str:
    """Returns a grip with another one's views added, and what the fingers hold in it; or why they cannot be joined."""
    Ts, cost, fits = registered(first, surface, other, own)
    if not fits.any():
        return "expected the surface of the other grips, got one that fits it nowhere (too little in common?)"
    T, least = Ts[fits][0], cost[fits][0]
    joined = Grip(deepcopy(first.reconstruction), first.tips_object)
    joined.reconstruction.merge(other.reconstruction, T)
    complete = in_fingers(joined.volume, joined.tips_object)[0]
    if complete is None:
        return "expected one object with that of the other grips, got a surface that the fingers do not hold"
    maps = se3.inverse(T) @ Ts[fits & (cost < least + GRIP.clearly_worse)]  # of the object onto itself
    if not all(_is_symmetry(each, joined.volume, complete) for each in maps[far(maps, np.eye(4))]):
        return "expected one way in which it fits the other grips, got several, of different shapes"
    return joined, complete


def _is_symmetry(T: Array, volume: Volume, surface: SurfacePoints) -> bool:
    """Returns whether a map (4, 4) takes an object's surface to itself, and no handle into free space."""
    points = surface.points[:: len(surface.points) // GRIP.points + 1]
    places = se3.apply(T, points)
    odd = (cKDTree(surface.points).query(places)[0] > GRIP.odd) & volume.among(volume.clear(), places)
    return MapJudge(volume, points).allows(T[None]) and bool(odd.mean() <= GRIP.max_odd)


def in_fingers(volume: Volume, tips_object: Array) -> tuple[SurfacePoints | None, str]:
    """Returns the part of a surface that fingertips (k, 3) [m] hold, and else why there is none."""
    middle, what = tips_object.mean(axis=0), "expected an object between the fingers, got "
    opening = np.linalg.norm(tips_object - middle, axis=1).max() + GRIP.slack
    message = f"{what}none in {volume.views} views"
    for part in parts_of(volume.surface(), volume):
        points = part.points
        gap = np.linalg.norm(points[:, None] - tips_object, axis=2).min()
        off = np.linalg.norm(points - middle, axis=1).min()
        low, high = volume.bounds_object + 2 * volume.grid.cell * np.array([[1], [-1]])
        cut = ((points < low) | (points > high)).any(axis=1).mean()
        if gap <= GRIP.max_gap and off <= opening and cut <= GRIP.max_cut:
            return part, ""
        if message.endswith("views"):
            size = " x ".join(f"{1e3 * side:.0f}" for side in np.ptp(points, axis=0))
            near = f"{1e3 * gap:.0f} mm from the nearest fingertip, {1e3 * off:.0f} mm from the grip's middle"
            edge = ", cut by the edge of what is fused" if cut > GRIP.max_cut else ""
            message = f"{what}a surface of {size} mm that they do not hold: {near}{edge} (background?)"
    return None, message


def registered(
    model: Grip, surface: SurfacePoints, other: Grip, own: SurfacePoints
) -> tuple[Array, Array, Array]:
    """Returns the transforms (k, 4, 4) of one grip's frame into another's that fit best, their cost, whether they fit.
    `surface` and `own` are what the fingers hold in each."""
    rng, volume = np.random.default_rng(0), model.volume
    some = rng.permutation(len(own.points))[: GRIP.points]
    points = np.zeros(len(some), dtype=DEPTH_POINT)
    points["point"], points["normal"] = own.points[some], own.normals[some]
    # In the kernel's words the other grip is the camera, in which this one's object is placed.
    Ts = se3.random(rng, GRIP.starts)
    shift = GRIP.spread * rng.normal(size=(GRIP.starts, 3))
    Ts[:, :3, 3] = own.points.mean(axis=0) - Ts[:, :3, :3] @ surface.points.mean(axis=0) + shift
    there = MapJudge(volume, own.points[some])
    back = MapJudge(other.volume, surface.points[:: len(surface.points) // GRIP.points + 1])
    candidates, bound = candidates_at(Ts), RECONSTRUCTION.coarse_factor * volume.bound
    coarse = model.reconstruction.surface().record
    depth_term.refine_poses(*coarse, points, STAGES[:1], bound, NOTHING_KNOWN, candidates)
    Ts = poses_of(candidates)
    Ts = distinct(Ts[np.argsort(there.cost(se3.inverse(Ts)) + back.cost(Ts))])
    Ts = np.stack([model.reconstruction.placed(points, T)[0] for T in Ts])
    cost = there.cost(se3.inverse(Ts)) + back.cost(Ts)
    Ts, cost = Ts[np.argsort(cost)], np.sort(cost)
    fits = np.array([there.allows(se3.inverse(T)[None]) and back.allows(T[None]) for T in Ts])
    return Ts, cost, fits


def distinct(Ts: Array) -> Array:
    """Returns the first of poses (k, 4, 4) that are not near an earlier one."""
    kept = Ts[:1]
    for T in Ts[1:]:
        if len(kept) == GRIP.best:
            break
        if far(kept, T).all():
            kept = np.append(kept, T[None], axis=0)
    return kept


def far(Ts: Array, T: Array) -> Mask:
    """Returns (k,) whether poses (k, 4, 4) are not near another one (4, 4)."""
    shift = np.linalg.norm(Ts[:, :3, 3] - T[:3, 3], axis=1)
    cosine = (np.einsum("kij,ij->k", Ts[:, :3, :3], T[:3, :3]) - 1) / 2
    return np.asarray((shift > GRIP.distinct[0]) | (cosine < np.cos(GRIP.distinct[1])))
