"""An object's first pose from a depth image, without a guess."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels import depth_term, look_score, votes
from handsight._kernels.sight_records import LOOK
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel
from handsight.vision.appearance import appearance_of
from handsight.vision.region import Scene, seen_points

SPACING, MOST_POINTS = 1 / 24, 900
"""Of seen points [diameters], and how many at most."""
REFERENCES, LEAST_REFERENCES, PARTNERS = 28, 4, 140
"""Points that vote, at least so many of each part, and others that each is paired with."""
LEAST_SEEN = 10
"""Points with a normal that a part must have to vote."""
VOTED, VOTED_APART = 90, 0.05
"""Poses that were voted for and are laid on the image, and how far apart these are [diameters]."""
RUNGS = (
    (80, False, 0.12, 0.08, 4, 24),
    (160, False, 0.08, 0.05, 4, 12),
    (300, True, 0.05, 0.03, 4, 8),
    (MOST_POINTS, True, 0.03, 0.0, 5, 5),
)
"""Seen points, whether on the fine field, Tukey's bound at first and at last [diameters], steps, and how many go on."""
APART = 0.08
"""How far apart those are that go on [diameters]."""
BOUND, SIGMAS = 0.006, 4.0
"""What is explained lies within this [m], or so many deviations of the depth: no bound is less."""

Looks = NDArray[np.void]


@dataclass(frozen=True, eq=False)
class Found:
    """Where an object may be, the likeliest first."""

    Ts_camera_object: Array
    """(k, 4, 4)"""
    looks: Looks
    """(k,) what the image says of each."""


def first_pose(model: ObjectModel, scene: Scene, *, sigma: float = 0.0015) -> Found:
    """The poses of the object that a depth image supports; `sigma`: of its depth there [m].

    Votes of point pairs, each of them laid on the image by more and more of its points, those that the image as a
    whole supports best going on.
    """
    seen, appearance, D = (
        seen_points(scene, SPACING * model.diameter, MOST_POINTS),
        appearance_of(model),
        model.diameter,
    )
    references, bound = _references(seen, len(scene.sizes)), max(BOUND, SIGMAS * sigma)
    voted = np.zeros((len(references), votes.PEAKS), dtype=LOOK)
    votes.vote(appearance.pairs, appearance.voters, seen, references, np.array([D, PARTNERS]), voted)
    looks = voted.reshape(-1)
    looks = looks[distinct(model, looks, looks["votes"], VOTED, VOTED_APART)]
    limits = np.array([appearance.sample_area, bound, *model.center_object])
    for points, fine, first, last, steps, kept in RUNGS:
        rung = np.array([fine, max(first * D, bound), max(last * D, bound), steps])
        depth_term.settle_all(*model.record[:2], seen[:points], rung, looks)
        image = scene.depth, scene.labels
        look_score.score_all(scene.camera.record, image, appearance.sides, scene.sizes, limits, looks)
        looks = looks[distinct(model, looks, looks["score"], kept, APART)]
    return Found(se3.compose(looks["rotation"], looks["position"]), looks)


def _references(seen: Looks, parts: int) -> Indices:
    """Points that vote: spread over the parts by the roots of their sizes, else big ones take them all."""
    has = (seen["normal"] != 0).any(axis=1)
    counts = np.bincount(seen["part"][has], minlength=parts)
    share = np.sqrt(counts)
    chosen = []
    for part in np.flatnonzero(counts >= LEAST_SEEN):
        number = max(LEAST_REFERENCES, round(REFERENCES * share[part] / share.sum()))
        chosen.append(np.flatnonzero(has & (seen["part"] == part))[:number])
    return np.concatenate(chosen) if chosen else np.empty(0, dtype=np.int64)


def distinct(model: ObjectModel, looks: Looks, worth: Array, most: int, apart: float) -> Indices:
    """Which looks, the best first, are apart from all better ones; apart: [diameters]."""
    order, kept = np.argsort(-worth, kind="stable"), list[int]()
    places = se3.apply(se3.compose(looks["rotation"], looks["position"]), model.points_object[::16])
    taken = np.zeros(len(looks), dtype=bool)
    for k in order:
        if taken[k]:
            continue
        kept.append(int(k))
        if len(kept) == most:
            break
        taken |= np.abs(places - places[k]).max(axis=(1, 2)) < apart * model.diameter
    return np.array(kept, dtype=np.int64)
