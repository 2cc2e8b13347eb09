"""An object's first pose from a depth image, without a guess."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import se3
from handsight._deprecated import renamed_members
from handsight._kernels.image import depth_term, pose_score, votes
from handsight._kernels.image.vision_records import CANDIDATE
from handsight._kernels.solve import distinct_poses
from handsight.checks import Array, Indices
from handsight.objects import ObjectModel
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.pose_covariance import pose_covariances
from handsight.vision.object.presence import log_odds, probabilities
from handsight.vision.object.region import Scene, observed_points


class FirstPoseOptions(NamedTuple):
    """`FirstPoseOptions` say how a first pose is found: points that vote, poses that are compared."""

    spacing: float = 1 / 24  # of observed points [diameters]
    max_points: int = 900  # observed points
    references: int = 28  # points that vote
    min_references: int = 4  # of each part at least
    partners: int = 140  # points that each is paired with
    min_pixels: int = 10  # points with a normal that a part must have to vote
    max_voted: int = 90  # poses that were voted for and are compared with the image
    voted_spacing: float = 0.05  # how far apart these are [diameters]
    candidate_spacing: float = 0.08  # how far apart those are that go on [diameters]
    bound: float = 0.006  # what is explained lies within this [m]
    bound_sigmas: float = 4.0  # or within so many deviations of the depth: no bound is less
    close_sigmas: float = 1.25
    """Deviations of the depth, its bias with it, within which an observed point lies on the surface."""


FIRST_POSE = FirstPoseOptions()

STAGES = (
    (80, False, 0.12, 0.08, 4, 24),
    (160, False, 0.08, 0.05, 4, 12),
    (300, True, 0.05, 0.03, 4, 8),
    (FIRST_POSE.max_points, True, 0.03, 0.0, 5, 8),
)
"""Seen points, whether on the fine field, Tukey's bound at first and at last [diameters], steps, and how many go on."""

SCORE_WEIGHTS = 1.2, 22.0
"""What the score, and the pixels that such points stand for to the power of the score's units, are worth in the
logarithm of a mode's weight: chosen by hand between fits to two sets of drawn pictures, which differ
(`experiments/sight_fit.py` prints the likeliest of the one it draws)."""

Candidates = NDArray[np.void]


@renamed_members(looks="candidates")
@dataclass(frozen=True, eq=False)
class ObjectDetection:
    """An `ObjectDetection` says where an object may be, the likeliest first; nowhere, if it is not there."""

    Ts_camera_object: Array
    """(k, 4, 4)"""
    covariances: Array
    """(k, 6, 6) of (δp [m], δθ [rad]) along the camera's axes."""
    weights: Array
    """(k,) their sum is 1."""
    candidates: Candidates
    """(k,) CANDIDATE: what the image says of each."""
    probability: float = 0.0
    """That the first is right, where as often as not the object is not there at all."""
    reason: str | None = None
    """Why it is nowhere."""


def first_pose(model: ObjectModel, scene: Scene, *, noise: DepthNoise = STRUCTURED_LIGHT) -> ObjectDetection:
    """Returns the poses of the object that a depth image supports, modulo its symmetries; `noise`: of its depth.

    Votes of point pairs, each of them laid on the image by more and more of its points, those that the image as a
    whole supports best going on. At last it counts too how many points lie on the surface as close as noise lets them.
    """
    observed, appearance = (
        observed_points(scene, FIRST_POSE.spacing * model.diameter, FIRST_POSE.max_points),
        appearance_of(model),
    )
    D, references = model.diameter, _references(observed, len(scene.sizes))
    voted = np.zeros((len(references), votes.PEAKS), dtype=CANDIDATE)
    votes.vote(
        appearance.pairs, appearance.voters, observed, references, np.array([D, FIRST_POSE.partners]), voted
    )
    candidates = voted.reshape(-1)
    candidates = candidates[
        distinct(model, candidates, candidates["votes"], FIRST_POSE.max_voted, FIRST_POSE.voted_spacing)
    ]
    limits = np.array([appearance.sample_area, FIRST_POSE.bound, *model.center_object])
    for points, fine, first, last, steps, kept in STAGES:
        candidates["bound"] = np.maximum(
            FIRST_POSE.bound, FIRST_POSE.bound_sigmas * noise.sigma(depths(model, candidates))
        )
        stage = np.array([fine, first * D, last * D, steps])
        depth_term.refine_poses(*model.record[:2], observed[:points], stage, candidates)
        image = scene.depth, scene.labels
        pose_score.score_all(scene.camera.record, image, appearance.sides, scene.sizes, limits, candidates)
        candidates = candidates[
            distinct(model, candidates, candidates["score"], kept, FIRST_POSE.candidate_spacing)
        ]
    z = depths(model, candidates)
    depth_term.closeness(
        *model.record[:2],
        observed,
        FIRST_POSE.close_sigmas * np.hypot(noise.sigma(z), noise.bias(z)),
        candidates,
    )
    candidates["close"] *= scene.sizes.sum() / max(len(observed), 1)
    score = scores(candidates) @ SCORE_WEIGHTS
    order = np.argsort(-score, kind="stable")
    candidates, weights = candidates[order], np.exp(score[order] - score.max(initial=-np.inf))
    covariances = pose_covariances(model, scene.camera, observed, candidates, noise)
    here = probabilities(log_odds(candidates[:1]))[0] if len(candidates) else 0.0
    return ObjectDetection(
        poses_of(candidates), covariances, weights / max(weights.sum(), 1.0), candidates, float(here)
    )


def poses_of(candidates: Candidates) -> Array:
    """Returns (..., 4, 4) T_camera_object of CANDIDATE (...)."""
    return se3.compose(candidates["pose"]["rotation"], candidates["pose"]["position"])


def scores(candidates: Candidates) -> Array:
    """Returns (k, 2) of CANDIDATE (k,): score, and close pixels in its units."""
    return np.stack(
        [candidates["score"], candidates["close"] ** (1 - pose_score.POSE_SCORE.size_exponent)], axis=1
    )


def depths(model: ObjectModel, candidates: Candidates) -> Array:
    """Returns (k,) how far off the object's centre is along the optical axis [m]; 1 mm where it is not before the
    camera."""
    z = candidates["pose"]["position"][:, 2] + candidates["pose"]["rotation"][:, 2] @ model.center_object
    return np.asarray(np.maximum(z, 1e-3))


def _references(observed: Candidates, parts: int) -> Indices:
    """Returns points that vote: spread over the parts by the roots of their sizes, else big ones take them all."""
    has = (observed["normal"] != 0).any(axis=1)
    counts = np.bincount(observed["part"][has], minlength=parts)
    share = np.sqrt(counts)
    chosen = []
    for part in np.flatnonzero(counts >= FIRST_POSE.min_pixels):
        number = max(FIRST_POSE.min_references, round(FIRST_POSE.references * share[part] / share.sum()))
        chosen.append(np.flatnonzero(has & (observed["part"] == part))[:number])
    return np.concatenate(chosen) if chosen else np.empty(0, dtype=np.int64)


def distinct(model: ObjectModel, candidates: Candidates, score: Array, most: int, far: float) -> Indices:
    """Returns which looks, the best first, are apart from all better ones, modulo symmetry; far: [diameters]."""
    axes, kept = model.symmetries.axes, np.empty(most, dtype=np.int64)
    about = axes[0][0] if axes else model.center_object
    group = model.symmetries.rotations, np.array([axis for _, axis in axes]).reshape(-1, 3)
    limits = np.array([*about, model.radius, far * model.diameter])
    return kept[
        : distinct_poses.distinct_candidates(
            group, limits, candidates, np.argsort(-score, kind="stable"), kept
        )
    ]
