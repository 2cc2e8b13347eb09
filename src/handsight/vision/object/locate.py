"""Where an object is in one depth image, and which of several objects it shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection, first_pose, log_odds, probabilities
from handsight.vision.object.region import scene_of


class LocateOptions(NamedTuple):
    """`LocateOptions` say when an object is found in an image."""

    max_plane: float = 1.5  # a plane wider than this is no part of the object [diameters]
    min_probability: float = 0.02
    """Least probability of the best pose at which the object counts as found. It is low because the probability was
    fitted to drawn images, from which those of real cameras differ
    (`experiments/sight_recognition.py` prints what it accepts and claims)."""


LOCATE = LocateOptions()


def locate(
    model: ObjectModel,
    camera: Camera,
    depth: Depth,
    *,
    wanted: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> ObjectDetection:
    """Returns the poses that the object may have in a depth image (h, w) [m], 0 or NaN where there is no depth; none,
    with the reason, if the object is not in it.

    wanted (h, w): pixels that the object may be in; None: all. hand (h, w): those of the hand. table (4,):
    `n·P + offset = 0` in the camera, n towards it; None: the widest plane. noise: of the depth. Raises InvalidInput
    for images of another size than the camera's, and for depth that is not in metres.
    """
    extent = LOCATE.max_plane * model.diameter
    scene = scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)
    if not len(scene.sizes):
        return ObjectDetection.nowhere(scene.reason)
    found = first_pose(model, scene, noise=noise)
    if found.probability >= LOCATE.min_probability:
        return found
    if not len(found.candidates):
        return ObjectDetection.nowhere("no surface there is large enough to tell its shape")
    name, probability = model.name or "the object", f"with a probability of {found.probability:.2f} only"
    return ObjectDetection.nowhere(f"the likeliest pose of {name} is right {probability}")


@dataclass(frozen=True, eq=False)
class Recognition:
    """A `Recognition` says which object a depth image shows, and where."""

    scores: dict[str, float]
    """Probability of each name, the likeliest first."""
    none: float
    """Probability that it is none of them; with the scores it sums to 1."""
    found: dict[str, ObjectDetection]
    """Where each would be, in the same order."""
    reason: str | None = None
    """Why it is none."""

    @property
    def name(self) -> str | None:
        """The likeliest; None: none of them."""
        best = next(iter(self.scores), None)
        return best if best is not None and self.scores[best] > self.none else None


def recognise(
    models: Mapping[str, ObjectModel],
    camera: Camera,
    depth: Depth,
    *,
    wanted: Mask | None = None,
    hand: Mask | None = None,
    table: Array | None = None,
    noise: DepthNoise = STRUCTURED_LIGHT,
) -> Recognition:
    """Returns which of the models (by name) the wanted pixels of a depth image show; images are as `locate` takes them.

    Each is searched in the same segments of the image. Raises InvalidInput as `locate` does, and for no models.
    """
    if not models:
        raise InvalidInput("models: expected at least one, got none")
    extent = LOCATE.max_plane * max(model.diameter for model in models.values())
    scene = scene_of(camera, depth, wanted=wanted, hand=hand, table=table, extent=extent)
    found = {name: first_pose(model, scene, noise=noise) for name, model in models.items()}
    detected = [name for name, one in found.items() if len(one.candidates)]
    odds = np.array([log_odds(found[name].candidates[:1])[0] for name in detected])
    scores = dict.fromkeys(models, 0.0) | dict(zip(detected, probabilities(odds).tolist(), strict=True))
    order = sorted(scores, key=lambda name: -scores[name])
    none, reason = 1 - sum(scores.values()), None
    if not len(scene.sizes):
        reason = scene.reason
    elif none >= scores[order[0]]:
        best = f"{order[0]} is the likeliest, with a probability of {scores[order[0]]:.2f}"
        reason = f"nothing there looks like one of them; {best}"
    return Recognition({n: scores[n] for n in order}, max(none, 0.0), {n: found[n] for n in order}, reason)
