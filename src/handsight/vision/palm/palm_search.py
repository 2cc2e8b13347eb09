"""Candidates of the hand's pose in a depth image: turns and shifts around a predicted pose, tried in steps."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import palm_scan
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Indices, Mask
from handsight.vision.candidates import Candidates, poses_of
from handsight.vision.palm.hand_appearance import PlacedHand


class PalmSearchOptions(NamedTuple):
    """`PalmSearchOptions` say how poses of the palm are searched."""

    cell: float = 0.005  # side of the cells in which the image is sampled, at the hand [m]
    max_cells: int = 160  # to a side
    shift: float = 0.025  # between poses that are tried, across the direction to the camera [m]
    layer: float = 0.10  # and along it [m]
    rotation: float = float(np.deg2rad(12))  # and between their rotations [rad]
    max_sigmas: float = 2.6  # of the belief, within which poses are tried
    prior_weight: float = 0.01
    """What a squared sigma off the belief takes from a pose's score, the share of points that agree."""
    bin: float = 0.010  # of distances that are told apart [m]
    scanned: int = 80  # points of the hand that are compared with the image
    best: int = 300  # of all poses that are tried, those of which the distinct ones are taken
    refined: int = 48  # distinct poses whose neighbours are tried
    best_around: int = 30  # of the neighbours of each
    kept: int = 40  # distinct poses that go on
    compared: int = 8  # points of the hand by which poses are told apart


PALM_SEARCH = PalmSearchOptions()


@dataclass(frozen=True, slots=True)
class Picture:
    """A `Picture` is a depth image in which a hand may be, as the kernels take it, sampled in cells around there."""

    hand: PlacedHand
    camera: Camera
    depth: Depth
    cells: NDArray[np.float32]  # (m, m, 4) as `palm_scan.cells_of` fills them in
    corner: Array  # (3,) ray of the first cell, and step from cell to cell

    @property
    def arrays(self) -> tuple[Depth, NDArray[np.float32], NDArray[np.float32], Array]:
        return self.depth, self.camera.rays, self.cells, self.corner


def picture_of(camera: Camera, depth: Depth, hand: PlacedHand, T: Array, sigma: float) -> Picture | None:
    """Returns the image; None where a hand at T (4, 4), off by `sigma` [m] per axis, cannot be in it."""
    middle, reach = se3.apply(T, hand.middle[None])[0], PALM_SEARCH.max_sigmas * sigma + hand.radius
    if not middle[2] > -reach:
        return None
    known = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    far, nearest = max(middle[2], 0.1), max(middle[2] - reach, 0.1)
    half = reach / max(nearest, 0.5 * far)
    count = min(int(2 * half / (PALM_SEARCH.cell / far)) + 1, PALM_SEARCH.max_cells)
    corner = np.array([middle[0] / far - half, middle[1] / far - half, 2 * half / count])
    cells = np.empty((count + 1, count + 1, 4), dtype=np.float32)
    palm_scan.cells_of(camera.record, camera.rays, known, corner, cells)
    return Picture(hand, camera, known, cells, corner) if (cells[..., 0] > 0).any() else None


@dataclass(frozen=True, slots=True)
class Belief:
    """A `Belief` is the predicted pose of a hand, with its standard deviations."""

    hand: PlacedHand
    T: Array
    """(4, 4) camera from palm."""
    sigmas: tuple[float, float]
    """Sigmas of the hand's middle and of a turn, per axis [m, rad]."""

    def differences(self, middles: Array, rotations: Array) -> tuple[Array, Array]:
        """Returns how far middles (..., 3) and rotations (..., 3, 3) of the hand are off it (..., 3) [m], [rad]."""
        off = middles - se3.apply(self.T, self.hand.middle[None])[0]
        return off, se3.rotation_log(rotations @ self.T[:3, :3].T)


def searched(picture: Picture, belief: Belief, visible: Mask) -> Candidates:
    """Returns CANDIDATE (k,) from which the hand is aligned: the best poses of all within the belief, and around them.
    visible (m,): which points of the hand the camera sees at the belief."""
    hand, rows, options = picture.hand, np.flatnonzero(visible), PALM_SEARCH
    air = hand.beside(picture.camera, belief.T, options.scanned)
    points = _about_middle(hand, rows[: options.scanned], air[: options.scanned // 2])
    turns = _turns(options.max_sigmas * belief.sigmas[1], options.rotation)
    shifts = _shifts(options.max_sigmas * belief.sigmas[0])
    candidates = _best(picture, belief, belief.T, points, options.bin, turns, shifts, options.best)
    candidates = distinct(hand, candidates, options.shift, options.refined)
    points = _about_middle(hand, rows[: 2 * options.scanned], air)
    turns = _turns(options.rotation / 2, options.rotation / 2)
    finer = points, options.bin / 2, turns, np.zeros((1, 3)), options.best_around
    around = [_best(picture, belief, T, *finer) for T in poses_of(candidates)]
    return distinct(hand, np.concatenate([candidates[:0], *around]), options.shift / 2, options.kept)


def _about_middle(hand: PlacedHand, rows: Indices, air: Array) -> Array:
    """Returns (2, k, 3): points of the skin and in the air, about the hand's middle [m]; their normals, or zeros."""
    points = np.concatenate([hand.skin[0, rows], air]) - hand.middle
    return np.stack([points, np.concatenate([hand.skin[1, rows], np.zeros_like(air)])])


def _best(
    picture: Picture,
    belief: Belief,
    T: Array,
    points: Array,
    bin_width: float,
    turns: Array,
    shifts: Array,
    most: int,
) -> Candidates:
    """Returns the best CANDIDATE (k,), `most` at most, of all `turns` (r, 3, 3) and `shifts` (s, 3) [m] of the hand at
    a pose T (4, 4), by `points` as of `_about_middle`.

    For each of them one distance from the camera is taken, the one at which most points agree with the image, of those
    that are `bin_width` [m] apart.
    """
    rotations, middles = turns @ T[:3, :3], se3.apply(T, belief.hand.middle[None])[0] + shifts
    found = np.empty((len(rotations), len(middles), 2))
    palm_scan.scan(picture.cells, picture.corner, bin_width, points, middles, rotations, found)
    places = middles * (1 + found[..., 1] / middles[:, 2])[..., None]
    off, turned = belief.differences(places, rotations[:, None])
    chi2 = (off**2).sum(axis=-1) / belief.sigmas[0] ** 2 + (turned**2).sum(axis=-1) / belief.sigmas[1] ** 2
    scores = (found[..., 0] - PALM_SEARCH.prior_weight * chi2).reshape(-1)
    best = np.argpartition(-scores, min(most, len(scores) - 1))[:most]
    best = best[np.isfinite(scores[best])]
    r, s = np.divmod(best, len(middles))
    candidates = np.zeros(len(best), dtype=CANDIDATE)
    candidates["score"], candidates["pose"]["rotation"] = scores[best], rotations[r]
    candidates["pose"]["position"] = places[r, s] - rotations[r] @ belief.hand.middle
    return candidates


@lru_cache(maxsize=16)
def _turns(reach: float, step: float) -> Array:
    """Returns rotations (r, 3, 3) `step` apart, up to `reach` [rad]; none but 0 where that is less than half a step."""
    count = max(int(np.ceil(reach / step - 0.5)), 0)
    steps = step * np.arange(-count, count + 1)
    turns = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.linalg.norm(turns, axis=1) <= reach + 0.8 * step
    return np.stack([se3.rotation_exp(turn) for turn in turns[inside]])


def _shifts(reach: float) -> Array:
    """Returns shifts (s, 3) up to `reach` [m], close together across the direction to the camera, in layers along
    it."""
    steps = np.array([PALM_SEARCH.shift, PALM_SEARCH.shift, PALM_SEARCH.layer])
    count, _, layers = np.maximum(np.ceil(reach / steps - 0.5).astype(int), 0).tolist()
    across, along = steps[0] * np.arange(-count, count + 1), steps[2] * np.arange(-layers, layers + 1)
    shifts = np.stack(np.meshgrid(across, across, along, indexing="ij"), axis=-1).reshape(-1, 3)
    # A cell counts where any of it is within reach: by its nearest corner, not by its middle.
    nearest = np.maximum(np.abs(shifts) - steps / 2, 0.0)
    return np.asarray(shifts[np.linalg.norm(nearest, axis=1) <= reach])


def distinct(hand: PlacedHand, candidates: Candidates, spacing: float, most: int) -> Candidates:
    """Returns the best candidates, the best first, each at least `spacing` from all better ones. Their distance is the
    root mean square of that of a few points of the hand [m]."""
    candidates = candidates[np.argsort(-candidates["score"], kind="stable")]
    points = hand.skin[0, : PALM_SEARCH.compared]
    places = se3.apply(poses_of(candidates), points).reshape(len(candidates), points.size)
    taken, kept = np.zeros(len(candidates), dtype=bool), list[int]()
    for k in range(len(candidates)):
        if not taken[k] and len(kept) < most:
            kept.append(k)
            away = places - places[k]
            taken |= np.einsum("ki,ki->k", away, away) < PALM_SEARCH.compared * spacing**2
    return candidates[kept]
