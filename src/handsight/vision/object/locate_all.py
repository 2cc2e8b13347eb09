"""All objects that a depth image shows, explained together: each of its pixels by one of them at most.

Each object is first searched by itself. Of all candidates those are chosen that explain most of the image together, as
by Aldoma and others (A Global Hypotheses Verification Method for 3D Object Recognition, ECCV 2012). Each object is then
searched once more without the pixels of the others, which therefore do not count against it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels.image import outline, pose_score
from handsight._kernels.image.pose_score import POSE_SCORE
from handsight._kernels.image.vision_records import CANDIDATE
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.candidates import Candidates, poses_of, surface_distances
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.appearance import FEW, appearance_of
from handsight.vision.object.first_pose import (
    ObjectDetection,
    first_pose,
    log_odds,
    logit,
    probabilities,
    score_candidates,
)
from handsight.vision.object.locate import LOCATE, Box, search_mask
from handsight.vision.object.region import Scene, scene_of

Pixels = NDArray[np.int32]
Distances = tuple[tuple[slice, slice], NDArray[np.float32]]


class LocateAllOptions(NamedTuple):
    """`LocateAllOptions` say which candidates explain an image together, in pixels that one of them explains."""

    modes: int = 12  # poses of each object in the complete image that are compared
    pixels: int = 3000  # of the image by which candidates are compared
    twice: float = 1.0  # what a pixel costs that two explain
    unexplained: float = 0.5  # and one close to a chosen surface that nobody explains
    around: float = 0.1  # so close is close [diameters]
    rejected: float = 0.8  # a candidate that explains less than so much of what it costs takes no part
    expected: float = 0.3  # and each pixel that a candidate should fill, unless another chosen one hides it
    exchanged: int = 12  # candidates that are put in the place of all that explain the same pixels
    overlap: float = 0.25  # share of a candidate's pixels that another one explains, to be put in its place
    max_left_out: int = 10  # unlikely candidates in whose place others are searched
    rival: float = 0.5  # share of an object's pixels that another candidate explains, to be there instead
    changed: float = 0.02  # share of its pixels that its surroundings change by, to be searched again
    visible: float = 0.1  # share of the pixels that an object would fill, of which less is no evidence
    max_rounds: int = 6  # of the search for one more of each


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
    found: Mapping[str, Sequence[ObjectDetection]] | None = None,
    box: Box | None = None,
    mask: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> SceneDetection:
    """Returns every instance of the models (by name) that a depth image shows; images are as `locate` takes them.

    counts: how many there are at most, by name; those without one, or all if it is None, are counted. found: what
    `locate` answers in the boxes of a detector or from the poses of an estimator, by name, in place of a search for
    these objects. No two instances explain the same pixels. Raises InvalidInput as `locate` does, for no models, and
    for counts of other objects.
    """
    limits = _checked_counts(models, counts)
    extent = LOCATE.max_plane * max(model.diameter for model in models.values())
    wanted = search_mask(camera, box, mask)
    scene = scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)
    if not len(scene.sizes):
        return SceneDetection((), dict.fromkeys(models, scene.reason))
    # In the order of their names, so that the order in which models are given changes nothing.
    given, pool = dict(found or {}), _Pool(scene, models, noise)
    for name in sorted(models):
        if name in given:
            pool.add([_Search(name, one, np.zeros(depth.shape, dtype=bool)) for one in given[name]])
        else:
            one = first_pose(models[name], scene, noise=noise, modes=LOCATE_ALL.modes)
            pool.add([_Search(name, one, None)])
    chosen, more = pool.best(limits, []), set(models).difference(given)
    for k in range(LOCATE_ALL.max_rounds):
        owner = pool.owners(chosen)
        again = [pool.searched(chosen, n, owner) for n in range(len(chosen))] if k == 0 else []
        left, counted = scene.without(owner >= 0), Counter(pool.names[n] for n in chosen)
        for name in sorted(more):
            if len(left.sizes) and len(chosen) and counted[name] < limits.get(name, np.inf):
                again.append(_Search(name, first_pose(models[name], left, noise=noise), owner >= 0))
        pool.add(again)
        chosen = pool.best(limits, chosen)
        now = Counter(pool.names[n] for n in chosen)
        more = {name for name in more if now[name] > counted[name]}
        if not more:
            break
    return _answer(pool, limits, pool.present(limits, chosen))


def _checked_counts(models: Mapping[str, ObjectModel], counts: Mapping[str, int] | None) -> dict[str, int]:
    """Returns the most instances of each model whose number is given; raises InvalidInput."""
    if not models:
        raise InvalidInput("models: expected at least one, got none")
    if not isinstance(counts or {}, Mapping):
        raise InvalidInput(f"counts: expected a number by name, got {type(counts).__name__}")
    limits = {name: checks.integer(n, f"counts[{name!r}]", 10_000) for name, n in (counts or {}).items()}
    if wrong := next((name for name in limits if name not in models), None):
        raise InvalidInput(f"counts: expected names of models, got {wrong!r:.80}")
    return limits


class _Search(NamedTuple):
    """A `_Search` is what was found of an object without the pixels (h, w) of others; None: in the complete image."""

    name: str
    detection: ObjectDetection
    excluded: Mask | None


class _Pool:
    """A `_Pool` has candidates of all objects, and how they explain an image together, by a grid of its pixels."""

    def __init__(self, scene: Scene, models: Mapping[str, ObjectModel], noise: DepthNoise) -> None:
        """It has no candidates yet."""
        self.scene, self.models, self.noise = scene, models, noise
        step = max(1, round(np.sqrt((scene.labels >= 0).sum() / LOCATE_ALL.pixels)))
        depth = np.ascontiguousarray(scene.depth[::step, ::step])
        labels = np.ascontiguousarray(scene.labels[::step, ::step])
        matrix = np.diag([1 / step, 1 / step, 1]) @ scene.camera.matrix
        camera = Camera(matrix, depth.shape[::-1], scene.camera.lens)
        self.coarse = replace(scene, camera=camera, depth=depth, labels=labels)
        self.inside = labels.reshape(-1) >= 0
        self.points = camera.points(depth).reshape(-1, 3)[self.inside].astype(np.float64)
        self.searches, self.names, self.source = list[_Search](), list[str](), list[_Search]()
        self.candidates, self.cost = np.zeros(0, dtype=CANDIDATE), np.zeros(0)
        self.explained = self.around = np.zeros((0, len(self.points)), dtype=np.float32)
        self.hidden = np.zeros((0, FEW, 2))
        self.distances = dict[int, Distances]()

    def add(self, searches: Sequence[_Search]) -> None:
        """Adds the candidates of searches, but those that cannot gain, whatever hides them."""
        for each in searches:
            model, some = self.models[each.name], each.detection.candidates.copy()
            sides, hidden = appearance_of(model).few_sides, np.zeros((len(some), FEW, 2))
            image = self.coarse.depth, self.coarse.labels
            pose_score.score_all(self.coarse.camera.record, image, sides, model.center_object, some, hidden)
            hidden[..., 1] *= self.inside[hidden[..., 0].astype(int)]
            score_candidates(model, self.coarse, some, effort=0)
            cost = POSE_SCORE.passed * some["passed"] + LOCATE_ALL.expected * some["expected"]
            keep = some["explained"] > LOCATE_ALL.rejected * (cost - LOCATE_ALL.expected * some["hidden"])
            keep[:1] = True
            cost, some = (cost + POSE_SCORE.hidden * some["hidden"])[keep], some[keep]
            within = some["bound"].max(initial=0.0) + LOCATE_ALL.around * model.diameter
            distances = surface_distances(model, self.points, within, some)
            explained = np.maximum(1 - (distances / some["bound"][:, None].astype(np.float32)) ** 2, 0)
            around = (np.isfinite(distances) & (explained == 0)).astype(np.float32)
            self.searches.append(each)
            self.names += [each.name] * len(some)
            self.source += [each] * len(some)
            self.candidates = np.concatenate([self.candidates, each.detection.candidates[keep]])
            self.cost, self.hidden = np.append(self.cost, cost), np.concatenate([self.hidden, hidden[keep]])
            self.explained = np.concatenate([self.explained, explained])
            self.around = np.concatenate([self.around, around])
        self.total = self.explained.sum(axis=1)

    def costs(self, owned: Mask, which: slice = slice(None)) -> Array:
        """Returns what candidates (k,) cost by pixels that they should explain, where others own some points (n,)."""
        excuses = np.zeros(len(self.inside), dtype=bool)
        excuses[self.inside] = owned
        hiding, hidden = self.hidden[which, :, 0].astype(int), self.hidden[which, :, 1]
        excused = (hidden * excuses[hiding]).sum(axis=1)
        return np.asarray(self.cost[which] - (POSE_SCORE.hidden + LOCATE_ALL.expected) * excused)

    def value(self, chosen: list[int]) -> float:
        """Returns how well candidates explain the image together [pixels of the grid]."""
        explained, value = self.explained[chosen], 0.0
        for k, n in enumerate(chosen):
            others = np.asarray(np.delete(explained, k, axis=0).any(axis=0))
            value -= float(self.costs(others, slice(n, n + 1))[0])
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
        costs = self.costs(best > 0)
        gains = self.total - (1 + LOCATE_ALL.twice) * twice - costs - LOCATE_ALL.unexplained * left
        gains[chosen] = -np.inf
        return np.asarray(gains)

    def overlap(self, n: int, chosen: list[int]) -> Mask:
        """Returns which of the chosen candidates (k,) share so many pixels with the n-th that one of both goes."""
        same = np.minimum(self.explained[n], self.explained[chosen]).sum(axis=1)
        return np.asarray(same > LOCATE_ALL.overlap * np.minimum(self.total[n], self.total[chosen]))

    def best(self, limits: Mapping[str, int], start: list[int], banned: Collection[int] = ()) -> list[int]:
        """Returns the candidates that explain the image best together, at most so many of a name, none that is banned.

        From the start on one is added, or put in another's place, while that raises the value; with some banned, added.
        """
        chosen, value, names = list(start), self.value(start), np.array(self.names)

        def one_more(rest: list[int]) -> list[int]:
            """Returns the candidates and the one that the value gains most by."""
            gains, counted = self.gains(rest), Counter(names[rest].tolist())
            gains[[counted[name] >= limits.get(name, np.inf) for name in self.names]] = -np.inf
            gains[list(banned)] = -np.inf
            return [*rest, int(gains.argmax())] if gains.max(initial=-np.inf) > -np.inf else rest

        def raised(option: list[int]) -> bool:
            """Returns whether an option has a higher value than what is chosen, and then chooses it."""
            nonlocal chosen, value
            if not (now := self.value(option)) > value + 1e-6:
                return False
            chosen, value = option, now
            return True

        alone = self.total - self.costs(np.ones(len(self.points), dtype=bool))
        alone[[limits.get(name, 1) == 0 for name in self.names]] = -np.inf
        likely = np.argsort(-alone)[: LOCATE_ALL.exchanged]
        while True:
            before = value
            while raised(one_more(chosen)):
                pass
            if banned:
                return chosen
            for n in chosen:
                rest = [other for other in chosen if other != n]
                raised(rest)
                raised(one_more(rest))
            for n in likely[alone[likely] > 0].tolist():
                same = self.overlap(n, chosen) | (names[chosen] == names[n])
                option = [*np.array(chosen)[~same].tolist(), n]
                for _ in range(same.sum() if n not in chosen else 0):
                    option = one_more(option)
                    raised(option)
            if value <= before:
                return chosen

    def owners(self, chosen: Sequence[int]) -> Pixels:
        """Returns which of the candidates (in their order) explains each pixel (h, w): the one with the nearest
        surface; -1 where none does."""
        for n in chosen:
            if n not in self.distances:
                model = self.models[self.names[n]]
                self.distances[n] = distances_in(self.scene, model, self.candidates[n : n + 1])
        nearest = np.full(self.scene.depth.shape, np.inf, dtype=np.float32)
        owner = np.full(nearest.shape, -1, dtype=np.int32)
        for k, (box, distance) in enumerate(self.distances[n] for n in chosen):
            near = distance < nearest[box]
            nearest[box][near], owner[box][near] = distance[near], k
        return owner

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
        others = [np.flatnonzero(there & (names == name)) for name in sorted({*names[there]})]
        for which in (np.array([n]), *others):
            candidates = self.candidates[which]
            model = self.models[self.names[which[0]]]
            score_candidates(model, scene, candidates)
            image = scene.camera.rays, scene.depth, scene.labels
            outline.cross_outlines(scene.camera.record, model.record[:2], image, candidates)
            each = log_odds(candidates)
            odds[int(which[each.argmax()])] = float(each.max())
        return odds

    def present(self, limits: Mapping[str, int], chosen: list[int]) -> list[int]:
        """Returns those of the candidates that are likely enough, given the others. One by one the least likely is left
        out, or a likelier one of another object is put in a candidate's place."""
        chosen, banned = list(chosen), list[int]()
        # Where nothing else is, an object is there if `locate` finds it.
        for each in self.searches:
            if each.detection.probability >= LOCATE.min_probability and limits.get(each.name, 1):
                n = self.source.index(each)
                if each.name not in {self.names[m] for m in chosen} and not self.overlap(n, chosen).any():
                    chosen.append(n)
        tried = set(chosen)
        while chosen:
            owner = self.owners(chosen)
            odds = [self.odds(limits, chosen, k, owner) for k in range(len(chosen))]
            own = np.array([one[n] for one, n in zip(odds, chosen, strict=True)])
            free = [(k, n) for k, one in enumerate(odds) for n in one if n not in tried and n not in banned]
            if better := [(odds[k][n] - own[k], k, n) for k, n in free if odds[k][n] > own[k]]:
                _, k, chosen[k] = max(better)
                tried.add(chosen[k])
                continue
            if (own >= logit(LOCATE.min_probability)).all():
                break
            banned.append(chosen.pop(int(own.argmin())))
            if len(banned) <= LOCATE_ALL.max_left_out:
                chosen = self.best(limits, chosen, banned)
        return chosen


def _answer(pool: _Pool, limits: Mapping[str, int], chosen: list[int]) -> SceneDetection:
    """Returns the chosen candidates as instances, each searched without the pixels of the others."""
    owner, names = pool.owners(chosen), [pool.names[n] for n in chosen]
    again = [pool.searched(chosen, k, owner) for k in range(len(chosen))]
    odds = [pool.odds(limits, chosen, k, owner) for k in range(len(chosen))]
    now, searches = list[int](), list(pool.searches)
    for each in again:
        now.append(len(pool.names))
        pool.add([each])
    pixels, instances = pool.owners(now), list[ObjectInstance]()
    for k, (name, search) in enumerate(zip(names, again, strict=True)):
        found, explained, candidate = search.detection, pixels == k, search.detection.candidates[:1].copy()
        score_candidates(pool.models[name], pool.scene, candidate, effort=0)  # with what others hide
        rivals = [value for n, value in odds[k].items() if n != chosen[k]]
        probability = found.probability
        if rivals:
            probability = float(probabilities(np.array([logit(probability), *rivals]))[0])
        few = explained.sum() < LOCATE_ALL.visible * candidate["expected"][0]
        if not few and probability >= LOCATE.min_probability:
            instances.append(ObjectInstance(name, found, probability, explained))
    missing = dict[str, str]()
    for name in pool.models:
        if not any(each.name == name for each in instances):
            p = max((each.detection.probability for each in searches if each.name == name), default=0.0)
            why = f"the likeliest pose of {name} is right with a probability of {p:.2f} only"
            likely_alone = p >= LOCATE.min_probability
            missing[name] = f"other objects explain the image where {name} would be" if likely_alone else why
    return SceneDetection(tuple(sorted(instances, key=lambda each: -each.probability)), missing)


def distances_in(scene: Scene, model: ObjectModel, candidate: Candidates) -> Distances:
    """Returns the part of a scene around an object at CANDIDATE (1,), and there the distances (h, w) [m] of the points
    that it explains from its surface; infinity at others."""
    bound, middle = float(candidate["bound"][0]), se3.apply(poses_of(candidate)[0], model.center_object[None])
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
    return box, distance
