"""Where in a depth image a hand may be, given a belief that is off: turns and shifts, tried in steps."""

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
from handsight.vision.object.first_pose import poses_of
from handsight.vision.palm.hand_appearance import PlacedHand


class PalmSearchOptions(NamedTuple):
    """`PalmSearchOptions` say how poses of the palm are searched."""

    cell: float = 0.005  # of the image as the search has it, at the hand [m]
    max_cells: int = 160  # to a side
    shift: float = 0.025  # between poses that are tried, across the way to the camera [m]
    layer: float = 0.10  # and along it [m]
    rotation: float = float(np.deg2rad(12))  # and between their rotations [rad]
    max_sigmas: float = 2.6  # of the belief that are searched
    prior_weight: float = 0.01
    """What a squared sigma that a pose is off the belief takes from the share of points that agree."""
    bin: float = 0.010  # distances that are told apart there [m]
    scanned: int = 80  # points in the search
    refined: int = 48  # poses whose neighbours are tried
    kept: int = 40  # poses that go on
    compared: int = 8  # points of the hand by which poses are told apart


PALM_SEARCH = PalmSearchOptions()

SAMPLED_POINTS = (300, 30)
"""Points in the search; poses that are looked around of; that go on; how many of all, and around each, are compared."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A `Picture` is a depth image as the kernels take it, with the cells around where the hand may be."""

    camera: Camera
    depth: Depth
    cells: NDArray[np.float32]
    corner: Array

    @property
    def arrays(self) -> tuple[Depth, NDArray[np.float32], NDArray[np.float32], Array]:
        return self.depth, self.camera.rays, self.cells, self.corner


def picture_of(camera: Camera, depth: Depth, hand: PlacedHand, T: Array, sigma: float) -> Picture | None:
    """Returns the image, None where the hand cannot be in the image."""
    middle, reach = se3.apply(T, hand.middle[None])[0], PALM_SEARCH.max_sigmas * sigma + hand.radius
    nearest = max(middle[2] - reach, 0.1)
    if not middle[2] > -reach:
        return None
    known = np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)
    far = max(middle[2], 0.1)
    size, half = PALM_SEARCH.cell / far, reach / max(nearest, 0.5 * far)
    count = min(int(2 * half / size) + 1, PALM_SEARCH.max_cells)
    size = 2 * half / count
    corner = np.array([middle[0] / far - half, middle[1] / far - half, size])
    cells = np.empty((count + 1, count + 1, 4), dtype=np.float32)
    palm_scan.cells_of(camera.record, camera.rays, known, corner, cells)
    return Picture(camera, known, cells, corner) if (cells[..., 0] > 0).any() else None


@dataclass(frozen=True, slots=True)
class Belief:
    """A `Belief` says where a hand is thought to be, and how far that is off."""

    hand: PlacedHand
    T: Array
    """(4, 4) camera from palm."""
    sigmas: tuple[float, float]
    """Of the hand's middle and of a turn, per axis [m, rad]."""

    def chi2(self, middles: Array, rotations: Array) -> Array:
        """Returns χ² of middles (..., 3) [m] and rotations (..., 3, 3) of the hand in the camera."""
        off = middles - se3.apply(self.T, self.hand.middle[None])[0]
        turned = se3.rotation_log(rotations @ self.T[:3, :3].T)
        return np.asarray(
            (off**2).sum(axis=-1) / self.sigmas[0] ** 2 + (turned**2).sum(axis=-1) / self.sigmas[1] ** 2
        )


def searched(picture: Picture, belief: Belief, there: Mask) -> NDArray[np.void]:
    """Returns CANDIDATE (k,) from which the hand is laid on: the likeliest of all that are tried, and of those around
    them."""
    hand, rows = belief.hand, np.flatnonzero(there)
    air = hand.beside(picture.camera, belief.T, PALM_SEARCH.scanned)
    turns, shifts = (
        _turns(PALM_SEARCH.max_sigmas * belief.sigmas[1]),
        _shifts(PALM_SEARCH.max_sigmas * belief.sigmas[0]),
    )
    points = _scanned(hand, rows[: PALM_SEARCH.scanned], air[: PALM_SEARCH.scanned // 2])
    candidates = _tried(
        picture, belief, points, belief.T, (turns, shifts), (PALM_SEARCH.bin, SAMPLED_POINTS[0])
    )
    candidates = distinct(hand, candidates, PALM_SEARCH.shift, PALM_SEARCH.refined)
    points = _scanned(hand, rows[: 2 * PALM_SEARCH.scanned], air)
    finer = _turns(PALM_SEARCH.rotation / 2, PALM_SEARCH.rotation / 2), np.zeros((1, 3))
    around = [
        _tried(picture, belief, points, near, finer, (PALM_SEARCH.bin / 2, SAMPLED_POINTS[1]))
        for near in poses_of(candidates)
    ]
    return distinct(hand, np.concatenate([candidates[:0], *around]), PALM_SEARCH.shift / 2, PALM_SEARCH.kept)


def _scanned(hand: PlacedHand, rows: Indices, air: Array) -> Array:
    """Returns (2, k, 3) points of its skin about its middle with normals, and points in the air without."""
    points = np.concatenate([hand.skin[0, rows], air]) - hand.middle
    return np.stack([points, np.concatenate([hand.skin[1, rows], np.zeros_like(air)])])


def _tried(
    picture: Picture,
    belief: Belief,
    points: Array,
    T: Array,
    steps: tuple[Array, Array],
    fine: tuple[float, int],
) -> NDArray[np.void]:
    """Returns CANDIDATE (k,) the best of all turns (r, 3, 3) and shifts (s, 3) from a pose, by points as of
    `_scanned`."""
    hand = belief.hand
    rotations = steps[0] @ T[:3, :3]
    middles = se3.apply(T, hand.middle[None])[0] + steps[1]
    found = np.empty((len(rotations), len(middles), 2))
    palm_scan.scan(picture.cells, np.append(picture.corner, fine[0]), points, middles, rotations, found)
    places = middles * (1 + found[..., 1] / middles[:, 2])[..., None]
    scores = (found[..., 0] - PALM_SEARCH.prior_weight * belief.chi2(places, rotations[:, None])).reshape(-1)
    best = np.argpartition(-scores, min(fine[1], len(scores) - 1))[: fine[1]]
    best = best[np.isfinite(scores[best])]
    r, s = np.divmod(best, len(middles))
    candidates = np.zeros(len(best), dtype=CANDIDATE)
    candidates["score"], candidates["pose"]["rotation"] = scores[best], rotations[r]
    candidates["pose"]["position"] = places[r, s] - rotations[r] @ hand.middle
    return candidates


@lru_cache(maxsize=16)
def _turns(reach: float, step: float = PALM_SEARCH.rotation) -> Array:
    """Returns (r, 3, 3) turns so far apart, up to `reach`; none but 0 where that is less than half a step."""
    count = max(int(np.ceil(reach / step - 0.5)), 0)
    steps = step * np.arange(-count, count + 1)
    turns = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.linalg.norm(turns, axis=1) <= reach + 0.8 * step
    return np.stack([se3.rotation_exp(turn) for turn in turns[inside]])


def _shifts(reach: float, step: float = PALM_SEARCH.shift) -> Array:
    """Returns (s, 3) shifts, so close together across the way to the camera, in layers along it."""
    count, layers = (max(int(np.ceil(reach / each - 0.5)), 0) for each in (step, PALM_SEARCH.layer))
    across, along = step * np.arange(-count, count + 1), PALM_SEARCH.layer * np.arange(-layers, layers + 1)
    shifts = np.stack(np.meshgrid(across, across, along, indexing="ij"), axis=-1).reshape(-1, 3)
    # A cell counts where any of it is within reach: by its nearest corner, not by its middle.
    nearest = np.maximum(np.abs(shifts) - np.array([step, step, PALM_SEARCH.layer]) / 2, 0.0)
    return np.asarray(shifts[np.linalg.norm(nearest, axis=1) <= reach])


def distinct(hand: PlacedHand, candidates: NDArray[np.void], spacing: float, most: int) -> NDArray[np.void]:
    """Returns the best first, each at least so far [m] from all better ones, by its points' root mean square."""
    candidates = candidates[np.argsort(-candidates["score"], kind="stable")]
    places = se3.apply(poses_of(candidates), hand.skin[0, : PALM_SEARCH.compared]).reshape(
        len(candidates), 3 * PALM_SEARCH.compared
    )
    taken = np.zeros(len(candidates), dtype=bool)
    kept = list[int]()
    for k in range(len(candidates)):
        if taken[k]:
            continue
        kept.append(k)
        if len(kept) == most:
            break
        away = places - places[k]
        taken |= np.einsum("ki,ki->k", away, away) < PALM_SEARCH.compared * spacing**2
    return candidates[kept]
