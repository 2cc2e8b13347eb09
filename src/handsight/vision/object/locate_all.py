"""All objects that a depth image shows: the likeliest is located, its pixels are taken away, and so on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from handsight import checks
from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.candidates import center_depths, surface_distances
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection, first_pose
from handsight.vision.object.locate import MIN_PROBABILITY, Box, doubt, scene_of_any
from handsight.vision.object.region import Scene

MAX_INSTANCES = 10_000
"""Most instances of one object in an image."""
MIN_FREE = 0.9
"""Share of an object's pixels that no other one may have taken, or it is searched again without them."""
MIN_VISIBLE = 0.1
"""Share of the pixels that an object would fill, of which less is no evidence."""


@dataclass(frozen=True, eq=False)
class ObjectInstance:
    """One of the objects in an image."""

    name: str
    detection: ObjectDetection
    """Its poses, covariances and weights, the likeliest first, and their probability."""
    pixels: Mask
    """(h, w) those that it explains, and no other instance."""


@dataclass(frozen=True, eq=False)
class SceneDetection:
    """All instances of objects that an image shows."""

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
    """Returns the instances of the models (by name) that a depth image shows; images are as `locate` takes them.

    counts: how many there are at most, by name; of the others, or of all if it is None, one each: a second pose that
    explains an image as well is more often another place of the same object than a second object. found: what
    `locate` answers in the boxes of a detector, by name, in place of a search for these objects. The likeliest object
    is taken first, and its pixels are then no other's. Raises InvalidInput as `locate` does, for no models, and for
    counts of other objects.
    """
    limits = _checked_counts(models, counts)
    scene = scene_of_any(models, depth, camera, box=box, mask=mask, hand=hand, table=table)
    if not len(scene.sizes):
        return SceneDetection((), dict.fromkeys(models, scene.reason))
    given = found or {}
    names = sorted(models)  # so that the order in which models are given changes nothing
    places = [(name, one) for name in names for one in given.get(name, ())]
    instances = list[ObjectInstance]()
    best = dict.fromkeys(names, 0.0)
    taken = Counter[str]()
    more = True
    while more:
        for name in names:
            if name not in given and taken[name] < limits.get(name, 1):
                places.append((name, first_pose(models[name], scene, noise=noise)))
        candidates = [
            ObjectInstance(name, one, explained(models[name], scene, one))
            for name, one in sorted(places, key=lambda place: -place[1].probability)
        ]
        more = False
        places = []
        for each in candidates:
            best[each.name] = max(best[each.name], each.detection.probability)
            free = each.pixels & (scene.labels >= 0)
            enough = is_visible(each) and free.sum() >= MIN_FREE * each.pixels.sum()
            if enough and taken[each.name] < limits.get(each.name, 1):
                instances.append(replace(each, pixels=free))
                scene = scene.without(free)
                taken[each.name] += 1
                more = True
    instances.sort(key=lambda each: -each.detection.probability)
    missing = {name: _why(name, best[name]) for name in models if not taken[name]}
    return SceneDetection(tuple(instances), missing)


def _why(name: str, probability: float) -> str:
    """Returns why an object is missing, by the probability of its likeliest pose."""
    if probability >= MIN_PROBABILITY:
        return f"other objects explain the image where {name} would be"
    return doubt(name, probability)


def is_visible(instance: ObjectInstance) -> bool:
    """Returns whether an object is likely, and enough of it is seen."""
    detection = instance.detection
    if detection.probability < MIN_PROBABILITY:
        return False
    return bool(instance.pixels.sum() >= max(MIN_VISIBLE * detection.candidates["expected"][0], 1))


def explained(model: ObjectModel, scene: Scene, detection: ObjectDetection) -> Mask:
    """Returns the pixels (h, w) of the scene's segments that a detection's first pose explains, if there is one."""
    candidate = detection.candidates[:1]
    if not len(candidate):
        return np.zeros(scene.depth.shape, dtype=bool)
    bound = float(candidate["bound"][0])
    z = center_depths(model, candidate)
    inside = (scene.labels >= 0) & (np.abs(scene.depth - z) < model.radius + bound)
    depth = scene.depth[inside].astype(np.float64)
    points = np.c_[scene.camera.rays[inside] * depth[:, None], depth]
    inside[inside] = surface_distances(model, points, bound, candidate)[0] < bound
    return np.asarray(inside)


def _checked_counts(models: Mapping[str, ObjectModel], counts: Mapping[str, int] | None) -> dict[str, int]:
    """Returns the most instances of each model whose number is given; raises InvalidInput."""
    if not isinstance(counts or {}, Mapping):
        raise InvalidInput(f"counts: expected a number by name, got {type(counts).__name__}")
    limits = dict[str, int]()
    for name, count in (counts or {}).items():
        if name not in models:
            raise InvalidInput(f"counts: expected names of models, got {name!r:.80}")
        limits[name] = checks.integer(count, f"counts[{name!r}]", MAX_INSTANCES)
    return limits
