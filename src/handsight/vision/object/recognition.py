"""Which of several objects a depth image shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Array, Mask
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.first_pose import ObjectDetection, first_pose
from handsight.vision.object.locate import LOCATE, nothing_in, scene_in
from handsight.vision.object.presence import log_odds, probabilities


@dataclass(frozen=True, eq=False)
class Recognition:
    """A `Recognition` says which object it is, and where."""

    scores: dict[str, float]
    """Probability of each name, the likeliest first."""
    none: float
    """That it is none of them; with the scores it sums to 1."""
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
    """Returns which of the models (by name) the wanted pixels of a depth image show, as `locate` takes them: scores
    over all.

    Each is looked for in the same parts of the image. Raises InvalidInput as `locate` does, and for no models.
    """
    if not models:
        raise InvalidInput("models: expected at least one, got none")
    extent = LOCATE.max_plane * max(model.diameter for model in models.values())
    scene = scene_in(camera, depth, extent, wanted=wanted, hand=hand, table=table)
    found = {name: first_pose(model, scene, noise=noise) for name, model in models.items()}
    detected = [name for name, one in found.items() if len(one.candidates)]
    odds = np.array([log_odds(found[name].candidates[:1])[0] for name in detected])
    scores = dict.fromkeys(models, 0.0) | dict(zip(detected, probabilities(odds).tolist(), strict=True))
    order = sorted(scores, key=lambda name: -scores[name])
    none, reason = 1 - sum(scores.values()), None
    if not len(scene.sizes):
        reason = nothing_in(scene)
    elif none >= scores[order[0]]:
        best = f"{order[0]} is the likeliest, with a probability of {scores[order[0]]:.2f}"
        reason = f"nothing there looks like one of them; {best}"
    return Recognition({n: scores[n] for n in order}, max(none, 0.0), {n: found[n] for n in order}, reason)
