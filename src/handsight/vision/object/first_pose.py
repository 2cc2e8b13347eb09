"""An object's first pose from a depth image, without a guess."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._kernels.image import depth_term, pose_score, votes
from handsight._kernels.image.vision_records import LOOK
from handsight._kernels.solve import distinct_poses
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.pose_covariance import pose_covariances
from handsight.vision.object.presence import log_odds, probabilities
from handsight.vision.object.region import Scene, observed_points

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
    (MOST_POINTS, True, 0.03, 0.0, 5, 8),
)
"""Seen points, whether on the fine field, Tukey's bound at first and at last [diameters], steps, and how many go on."""
APART = 0.08
"""How far apart those are that go on [diameters]."""
BOUND, SIGMAS = 0.006, 4.0
"""What is explained lies within this [m], or so many deviations of the depth: no bound is less."""

CLOSE = 1.25
"""Deviations of the depth, its bias with it, within which a seen point lies on the surface."""
WORTH = 1.2, 22.0
"""What the score, and the pixels that such points stand for to the power of the score's units, are worth in the
logarithm of a mode's weight: chosen by hand between fits to two sets of drawn pictures, which differ
(`experiments/sight_fit.py` prints the likeliest of the one it draws)."""

Looks = NDArray[np.void]


@dataclass(frozen=True, eq=False)
class ObjectDetection:
    """Where an object may be, the likeliest first; nowhere, if it is not there."""

    Ts_camera_object: Array
    """(k, 4, 4)"""
    covariances: Array
    """(k, 6, 6) of (δp [m], δθ [rad]) along the camera's axes."""
    weights: Array
    """(k,) their sum is 1."""
    looks: Looks
    """(k,) LOOK: what the image says of each."""
    probability: float = 0.0
    """That the first is right, where as often as not the object is not there at all."""
    reason: str | None = None
    """Why it is nowhere."""


def first_pose(model: ObjectModel, scene: Scene, *, noise: DepthNoise = STRUCTURED_LIGHT) -> ObjectDetection:
    """The poses of the object that a depth image supports, modulo its symmetries; `noise`: of its depth.

    Votes of point pairs, each of them laid on the image by more and more of its points, those that the image as a
    whole supports best going on. At last it counts too how many points lie on the surface as close as noise lets them.
    """
    seen, appearance = observed_points(scene, SPACING * model.diameter, MOST_POINTS), appearance_of(model)
    D, references = model.diameter, _references(seen, len(scene.sizes))
    voted = np.zeros((len(references), votes.PEAKS), dtype=LOOK)
    votes.vote(appearance.pairs, appearance.voters, seen, references, np.array([D, PARTNERS]), voted)
    looks = voted.reshape(-1)
    looks = looks[distinct(model, looks, looks["votes"], VOTED, VOTED_APART)]
    limits = np.array([appearance.sample_area, BOUND, *model.center_object])
    for points, fine, first, last, steps, kept in RUNGS:
        looks["bound"] = np.maximum(BOUND, SIGMAS * noise.sigma(depths(model, looks)))
        rung = np.array([fine, first * D, last * D, steps])
        depth_term.settle_all(*model.record[:2], seen[:points], rung, looks)
        image = scene.depth, scene.labels
        pose_score.score_all(scene.camera.record, image, appearance.sides, scene.sizes, limits, looks)
        looks = looks[distinct(model, looks, looks["score"], kept, APART)]
    z = depths(model, looks)
    depth_term.closeness(*model.record[:2], seen, CLOSE * np.hypot(noise.sigma(z), noise.bias(z)), looks)
    looks["close"] *= scene.sizes.sum() / max(len(seen), 1)
    worth = worths(looks) @ WORTH
    order = np.argsort(-worth, kind="stable")
    looks, weights = looks[order], np.exp(worth[order] - worth.max(initial=-np.inf))
    covariances = pose_covariances(model, scene.camera, seen, looks, noise)
    here = probabilities(log_odds(looks[:1]))[0] if len(looks) else 0.0
    return ObjectDetection(
        poses_of(looks), covariances, weights / max(weights.sum(), 1.0), looks, float(here)
    )


def poses_of(looks: Looks) -> Array:
    """(..., 4, 4) T_camera_object of LOOK (...)."""
    return se3.compose(looks["pose"]["rotation"], looks["pose"]["position"])


def worths(looks: Looks) -> Array:
    """(k, 2) of LOOK (k,): score, and close pixels in its units."""
    return np.stack([looks["score"], looks["close"] ** (1 - pose_score.POWER)], axis=1)


def depths(model: ObjectModel, looks: Looks) -> Array:
    """(k,) how far off the object's centre is along the optical axis [m]; 1 mm where it is not before the camera."""
    z = looks["pose"]["position"][:, 2] + looks["pose"]["rotation"][:, 2] @ model.center_object
    return np.asarray(np.maximum(z, 1e-3))


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


def distinct(model: ObjectModel, looks: Looks, worth: Array, most: int, far: float) -> Indices:
    """Which looks, the best first, are apart from all better ones, modulo symmetry; far: [diameters]."""
    axes, kept = model.symmetries.axes, np.empty(most, dtype=np.int64)
    about = axes[0][0] if axes else model.center_object
    group = model.symmetries.rotations, np.array([axis for _, axis in axes]).reshape(-1, 3)
    limits = np.array([*about, model.radius, far * model.diameter])
    return kept[: distinct_poses.apart(group, limits, looks, np.argsort(-worth, kind="stable"), kept)]
