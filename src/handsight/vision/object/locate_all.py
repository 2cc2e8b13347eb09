"""All objects that a depth image shows, explained together: each of its pixels by one of them at most.

Each object is first searched by itself. Of all candidates those are chosen that explain most of the image together, as
by Aldoma and others (A Global Hypotheses Verification Method for 3D Object Recognition, ECCV 2012). Each object is then
searched once more without the pixels of the others, which therefore do not count against it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels.image import depth_term
from handsight._kernels.image.pose_score import POSE_SCORE
from handsight._kernels.image.vision_records import HAND
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.candidates import Candidates, poses_of
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import (
    ObjectDetection,
    first_pose,
    log_odds,
    probabilities,
    score_candidates,
)
from handsight.vision.object.locate import LOCATE, Box, search_mask
from handsight.vision.object.region import Scene, scene_of

Pixels = NDArray[np.int32]


class LocateAllOptions(NamedTuple):
    """`LocateAllOptions` say which candidates explain an image together, in pixels that one of them explains."""

    modes: int = 12  # poses of each object in the complete image that are compared
    pixels: int = 3000  # of the image by which candidates are compared
    twice: float = 1.0  # what a pixel costs that two explain
    unexplained: float = 0.5  # and one close to a chosen surface that nobody explains
    around: float = 0.1  # so close is close [diameters]
    expected: float = 0.3  # and each pixel that a candidate should fill, unless another chosen one hides it
    rival: float = (
        0.5  # share of an object's pixels that another candidate explains, to be there instead of it
    )
    changed: float = (
        0.02  # share of its pixels by which its surroundings change before an object is searched again
    )
    max_rounds: int = 6  # of the search for one more of each
    min_another: float = 0.5  # least probability of one more of an object of which the number is not given


LOCATE_ALL = LocateAllOptions()


@dataclass(frozen=True, eq=False)
class ObjectInstance:
    """An `ObjectInstance` is one of the objects in an image, given the others."""

    name: str
    detection: ObjectDetection
    """Its poses, covariances and weights, the likeliest first."""
    probability: float
    """That the first pose is right, and that no other object is there instead."""
    pixels: Mask
    """(h, w) those that it explains, and no other instance."""


@dataclass(frozen=True, eq=False)
class SceneDetection:
    """A `SceneDetection` has all instances of objects that an image shows."""

    instances: tuple[ObjectInstance, ...]
    """The most probable first."""
    missing: dict[str, str]
    """Why none is there, of each object of which the image shows no instance."""


def locate_all(
    models: Mapping[str, ObjectModel],
    depth: Depth,
    camera: Camera,
    *,
    counts: Mapping[str, int] | None = None,
    box: Box | None = None,
    mask: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> SceneDetection:
    """Returns every instance of the models (by name) that a depth image shows; images are as `locate` takes them.

    counts: how many there are at most, by name; those without one, or all if it is None, are counted. No two instances
    explain the same pixels. Raises InvalidInput as `locate` does, for no models, and for counts of other objects.
    """
    limits = _checked_counts(models, counts)
    extent = LOCATE.max_plane * max(model.diameter for model in models.values())
    wanted = search_mask(camera, box, mask)
    scene = scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)
    if not len(scene.sizes):
        return SceneDetection((), dict.fromkeys(models, scene.reason))
    # In the order of their names, so that the order in which models are given changes nothing.
    found = {
        name: first_pose(models[name], scene, noise=noise, modes=LOCATE_ALL.modes) for name in sorted(models)
    }
    pool = _Pool(scene, models, noise, [_Search(name, one, None) for name, one in found.items()])
    chosen, more = pool.best(limits, []), set(models)
    for k in range(LOCATE_ALL.max_rounds):
        owner = pool.owners(chosen)
        again = [pool.searched(chosen, n, owner) for n in range(len(chosen))] if k == 0 else []
        left, counted = scene.without(owner >= 0), Counter(pool.names[n] for n in chosen)
        for name in sorted(more):
            if len(left.sizes) and len(chosen) and counted[name] < limits.get(name, np.inf):
                again.append(_Search(name, first_pose(models[name], left, noise=noise), owner >= 0))
        pool = pool.extended(again)
        chosen = pool.best(limits, chosen)
        more = {name for name, n in Counter(pool.names[n] for n in chosen).items() if n > counted[name]}
        if not more:
            break
    return _answer(pool, limits, pool.present(limits, chosen), found)


def _checked_counts(models: Mapping[str, ObjectModel], counts: Mapping[str, int] | None) -> dict[str, int]:
    """Returns the most instances of each model whose number is given; raises InvalidInput."""
    if not models:
        raise InvalidInput("models: expected at least one, got none")
    limits = {name: checks.integer(n, f"counts[{name!r}]", 10_000) for name, n in (counts or {}).items()}
    if wrong := next((name for name in limits if name not in models), None):
        raise InvalidInput(f"counts: expected names of models, got {wrong!r:.80}")
    if wrong := next((name for name, n in limits.items() if n < 0), None):
        raise InvalidInput(f"counts[{wrong!r}]: expected a number of at least 0, got {limits[wrong]}")
    return limits


class _Search(NamedTuple):
    """A `_Search` is what was found of an object without the pixels (h, w) of others; None: in the complete image."""

    name: str
    detection: ObjectDetection
    excluded: Mask | None


class _Pool:
    """A `_Pool` has candidates of all objects, and how they explain an image together, by a grid of its pixels."""

    def __init__(
        self, scene: Scene, models: Mapping[str, ObjectModel], noise: DepthNoise, searches: list[_Search]
    ) -> None:
        """Its candidates are those of the searches, one search after another."""
        self.scene, self.models, self.noise, self.searches = scene, models, noise, searches
        step = max(1, int(np.sqrt((scene.labels >= 0).sum() / LOCATE_ALL.pixels)))
        depth, labels = (np.ascontiguousarray(image[::step, ::step]) for image in (scene.depth, scene.labels))
        height, width = depth.shape
        matrix = np.diag([1 / step, 1 / step, 1]) @ scene.camera.matrix
        camera = Camera(matrix, (width, height), scene.camera.lens)
        self.coarse = Scene(camera, depth, labels, np.zeros(len(scene.sizes)))
        self.inside = labels >= 0
        rays, z = camera.rays[self.inside].astype(np.float64), depth[self.inside].astype(np.float64)
        self.points = np.c_[rays * z[:, None], z]
        self.names = [each.name for each in searches for _ in each.detection.candidates]
        self.source = [each for each in searches for _ in each.detection.candidates]
        self.candidates = np.concatenate([each.detection.candidates for each in searches])
        explained, around = list[Array](), list[Array]()
        for each in searches:
            model, some = models[each.name], each.detection.candidates
            within = some["bound"].max(initial=0.0) + LOCATE_ALL.around * model.diameter
            distances = surface_distances(model, self.points, within, some)
            explained.append(np.maximum(1 - (distances / some["bound"][:, None]) ** 2, 0))
            around.append(np.isfinite(distances) & (explained[-1] == 0))
        self.explained, self.around = np.concatenate(explained), np.concatenate(around).astype(np.float32)
        self.total = self.explained.sum(axis=1)

    def extended(self, searches: list[_Search]) -> _Pool:
        """Returns a pool with the candidates of more searches after those of this one."""
        return _Pool(self.scene, self.models, self.noise, [*self.searches, *searches]) if searches else self

    def costs(self, owned: Mask, which: NDArray[np.int64]) -> Array:
        """Returns what candidates (k,) cost by pixels that they should explain, where others own some points (n,)."""
        labels, costs = self.coarse.labels.copy(), np.empty(len(which))
        labels[self.inside] = np.where(owned, HAND, labels[self.inside])
        scene, names = replace(self.coarse, labels=labels), np.array(self.names)[which]
        for name in set(names):
            candidates = self.candidates[which[names == name]]
            score_candidates(self.models[name], scene, candidates)
            cost = POSE_SCORE.passed * candidates["passed"] + POSE_SCORE.hidden * candidates["hidden"]
            costs[names == name] = cost + LOCATE_ALL.expected * candidates["expected"]
        return costs

    def value(self, chosen: list[int]) -> float:
        """Returns how well candidates explain the image together [pixels of the grid]."""
        explained, value = self.explained[chosen], 0.0
        for k, n in enumerate(chosen):
            others = np.delete(explained, k, axis=0).any(axis=0)
            value -= float(self.costs(others, np.array([n]))[0])
        best = explained.max(axis=0, initial=0.0)
        value += float(best.sum() - LOCATE_ALL.twice * (explained.sum(axis=0) - best).sum())
        left = self.around[chosen].any(axis=0) & (best == 0)
        return value - LOCATE_ALL.unexplained * float(left.sum())

    def gains(self, chosen: list[int]) -> Array:
        """Returns by how much the value rises with each candidate more, but for pixels of others that it hides."""
        best = self.explained[chosen].max(axis=0, initial=0.0)
        near = (self.around[chosen].any(axis=0) & (best == 0)).astype(np.float32)
        free = ((best == 0) & (near == 0)).astype(np.float32)
        twice = np.minimum(self.explained, best).sum(axis=1)
        left = self.around @ free - (self.explained > 0) @ near
        costs = self.costs(best > 0, np.arange(len(self.names)))
        gains = self.total - (1 + LOCATE_ALL.twice) * twice - costs - LOCATE_ALL.unexplained * left
        gains[chosen] = -np.inf
        return np.asarray(gains)

    def best(self, limits: Mapping[str, int], start: list[int]) -> list[int]:
        """Returns the candidates that explain the image best together, at most so many of a name.

        From the start on one is added, or put in the place of another, as long as that raises the value.
        """
        chosen, value, names = list(start), self.value(start), np.array(self.names)

        def one_more(rest: list[int]) -> list[int]:
            """Returns the candidates and the one that the value gains most by."""
            gains, counted = self.gains(rest), Counter(names[rest].tolist())
            for name in {name for name, most in limits.items() if counted[name] >= most}:
                gains[names == name] = -np.inf
            return [*rest, int(gains.argmax())] if gains.max(initial=-np.inf) > -np.inf else rest

        while True:
            before = value
            while (now := self.value(option := one_more(chosen))) > value + 1e-6:
                chosen, value = option, now
            for n in chosen:
                rest = [other for other in chosen if other != n]
                for option in (rest, one_more(rest)):
                    if (now := self.value(option)) > value + 1e-6:
                        chosen, value = option, now
            if value <= before:
                return chosen

    def owners(self, chosen: Sequence[int]) -> Pixels:
        """Returns which of the candidates (in their order) explains each pixel (h, w): the one with the nearest
        surface; -1 where none does."""
        return owners(self.scene, [(self.models[self.names[n]], self.candidates[n : n + 1]) for n in chosen])

    def searched(self, chosen: list[int], k: int, owner: Pixels) -> _Search:
        """Returns the search for the k-th of the chosen candidates without the pixels (h, w) of the others."""
        n, others = chosen[k], (owner >= 0) & (owner != k)
        name, source = self.names[n], self.source[n]
        if source.excluded is not None:
            changed = np.count_nonzero(source.excluded != others)
            if changed < LOCATE_ALL.changed * self.candidates["expected"][n]:
                return source
        if not others.any():  # as `locate` has it
            return _Search(name, first_pose(self.models[name], self.scene, noise=self.noise), others)
        given = self.candidates[n : n + 1].copy()
        found = first_pose(self.models[name], self.scene.without(others), noise=self.noise, given=given)
        return _Search(name, found, others)

    def odds(self, limits: Mapping[str, int], chosen: list[int], k: int, owner: Pixels) -> dict[int, float]:
        """Returns the log odds that the k-th of the chosen candidates is there, given the others, and of the likeliest
        candidate of each object that could be there instead, by their indices."""
        n, counted = chosen[k], Counter(self.names[other] for other in chosen)
        scene, names, odds = self.scene.without((owner >= 0) & (owner != k)), np.array(self.names), {}
        there = np.minimum(self.explained, self.explained[n]).sum(axis=1) > LOCATE_ALL.rival * self.total[n]
        there &= [counted[name] < limits.get(name, np.inf) for name in self.names]
        there &= names != self.names[n]
        for which in ([n], *(np.flatnonzero(there & (names == name)) for name in sorted({*names[there]}))):
            candidates = self.candidates[which]
            score_candidates(self.models[self.names[which[0]]], scene, candidates)
            each = log_odds(candidates)
            odds[int(which[each.argmax()])] = float(each.max())
        return odds

    def present(self, limits: Mapping[str, int], chosen: list[int]) -> list[int]:
        """Returns those of the candidates that are likely enough, given the others.

        One by one the least likely is left out, or a likelier one of another object is put in a candidate's place.
        """
        chosen, tried = list(chosen), set(chosen)
        while chosen:
            owner = self.owners(chosen)
            odds = [self.odds(limits, chosen, k, owner) for k in range(len(chosen))]
            own = np.array([one[n] for one, n in zip(odds, chosen, strict=True)])
            better = [
                (value - own[k], k, n)
                for k, one in enumerate(odds)
                for n, value in one.items()
                if value > own[k] and n not in tried
            ]
            if better:
                _, k, chosen[k] = max(better)
                tried.add(chosen[k])
                continue
            short = own - _least_odds(limits, [self.names[n] for n in chosen], own)
            if (short >= 0).all():
                break
            del chosen[int(short.argmin())]
        return chosen


def _least_odds(limits: Mapping[str, int], names: Sequence[str], odds: Array) -> Array:
    """Returns the log odds (k,) that instances must have: more for one more of an object that is counted."""
    p = np.full(len(names), LOCATE.min_probability)
    for k, name in enumerate(names):
        if name not in limits and k != max(
            (j for j, other in enumerate(names) if other == name), key=odds.__getitem__
        ):
            p[k] = LOCATE_ALL.min_another
    return np.asarray(np.log(p / (1 - p)))


def _answer(
    pool: _Pool, limits: Mapping[str, int], chosen: list[int], found: Mapping[str, ObjectDetection]
) -> SceneDetection:
    """Returns the chosen candidates as instances, each searched without the pixels of the others."""
    owner, names = pool.owners(chosen), [pool.names[n] for n in chosen]
    detections = [pool.searched(chosen, k, owner).detection for k in range(len(chosen))]
    own = np.array([_log_odds(each.probability) for each in detections])
    stays = own >= _least_odds(limits, names, own)
    bodies = [(pool.models[name], each.candidates[:1]) for name, each in zip(names, detections, strict=True)]
    pixels, instances = owners(pool.scene, bodies), list[ObjectInstance]()
    for k in np.flatnonzero(stays):
        odds = pool.odds(limits, chosen, k, owner)
        rivals = [value for n, value in odds.items() if n != chosen[k]]
        probability = (
            float(probabilities(np.array([own[k], *rivals]))[0]) if rivals else detections[k].probability
        )
        instances.append(ObjectInstance(names[k], detections[k], probability, pixels == k))
    missing = dict[str, str]()
    for name in pool.models:
        if not any(each.name == name for each in instances):
            p = found[name].probability
            missing[name] = f"the likeliest pose of {name} is right with a probability of {p:.2f} only"
    return SceneDetection(tuple(sorted(instances, key=lambda each: -each.probability)), missing)


def _log_odds(p: float) -> float:
    return float(np.log(max(p, 1e-300) / max(1 - p, 1e-16)))


def owners(scene: Scene, bodies: Sequence[tuple[ObjectModel, Candidates]]) -> Pixels:
    """Returns which object with its CANDIDATE (1,) explains each pixel (h, w) of a scene: the one with the nearest
    surface; -1: none."""
    nearest = np.full(scene.depth.shape, np.inf, dtype=np.float32)
    owner = np.full(nearest.shape, -1, dtype=np.int32)
    for k, (model, candidate) in enumerate(bodies):
        bound, middle = (
            float(candidate["bound"][0]),
            se3.apply(poses_of(candidate)[0], model.center_object[None]),
        )
        reach, z = 1.2 * model.radius + bound, float(middle[0, 2])
        focal = np.diag(scene.camera.matrix)[:2] / max(z - reach, 0.05)
        corners = scene.camera.project(middle) + np.outer((-reach, reach), focal) + [[0], [1]]
        (left, top), (right, below) = np.nan_to_num(corners).clip(0, scene.camera.size).astype(int)
        box = slice(top, below), slice(left, right)
        inside = (scene.labels[box] >= 0) & (abs(scene.depth[box] - z) < reach)
        depth = scene.depth[box][inside].astype(np.float64)
        points = np.c_[scene.camera.rays[box][inside] * depth[:, None], depth]
        distance = np.full(inside.shape, np.inf, dtype=np.float32)
        distance[inside] = surface_distances(model, points, bound, candidate)[0]
        near = distance < nearest[box]
        nearest[box][near], owner[box][near] = distance[near], k
    return owner


def surface_distances(model: ObjectModel, points: Array, within: float, candidates: Candidates) -> Array:
    """Returns the distances (k, n) of points (n, 3) from the surface at CANDIDATE (k,); infinity where they are not
    `within` it [m]."""
    distances = np.empty((len(candidates), len(points)), dtype=np.float32)
    depth_term.surface_distances(*model.record[:2], points, within, candidates, distances)
    return distances
