"""An object's first pose from a depth image, without a guess."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import se3
from handsight._deprecated import renamed_members
from handsight._kernels.image import depth_term, outline, pose_score, votes
from handsight._kernels.image.vision_records import CANDIDATE, STAGE
from handsight.checks import Array
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.vision.candidates import (
    NOTHING_KNOWN,
    Candidates,
    candidates_at,
    center_depths,
    distinct,
    pose_covariances,
    poses_of,
)
from handsight.vision.depth_noise import STRUCTURED_LIGHT, DepthNoise
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.region import Scene, observed_points


class FirstPoseOptions(NamedTuple):
    """`FirstPoseOptions` say how a first pose is found: by points that vote, and candidates that are compared."""

    spacing: float = 1 / 24  # of observed points [diameters]
    max_points: int = 1200  # observed points
    references: int = 28  # points that vote
    min_references: int = 4  # of each segment at least
    partners: int = 140  # points that each is paired with
    min_pixels: int = 10  # points with a normal that a segment must have to vote
    max_voted: int = 150  # candidates of the votes that are compared with the image
    voted_spacing: float = 0.05  # between these [diameters]
    candidate_spacing: float = 0.08  # between those that go on [diameters]
    turned: int = 2  # candidates that are turned to where the surface is nearly the same
    passed_share: float = 0.05  # of the expected pixels, above which the best candidates slide
    slides: tuple[float, ...] = (-0.06, -0.045, -0.03, -0.015, 0.0, 0.015, 0.03, 0.045, 0.06)  # [diameters]
    bound: float = 0.006  # depth within this of the surface is explained [m]
    bound_sigmas: float = 4.0  # or within so many sigmas of the depth, where that is more
    max_bound: float = 0.5  # beyond which depth tells no shape from another: it is too far away [diameters]
    place: float = 0.25  # poses whose centres are nearer to each other are of one place [diameters]
    score_weight: float = 1.5  # of the score in the logarithm of a mode's weight among those of its place
    passed: float = 2.0  # cost of a pixel that the camera sees past, against one that such a mode explains
    step: float = 0.3  # between poses of one place that may be one unobserved motion [diameters]
    least_spread: float = 0.02  # weight of such a pose, as a share of the likeliest one's
    support: tuple[float, float] = (30.0, 0.018)
    """Those pixels by which that logarithm differs by 1, and what is added to them per expected pixel: neighbouring
    pixels have errors in common, and so has all of the surface."""


FIRST_POSE = FirstPoseOptions()

STAGES = np.array(
    [(0, 0.12, 0.08, 4, 1), (0, 0.08, 0.05, 4, 1), (1, 0.05, 0.03, 4, 1), (1, 0.03, 0.0, 5, 1)], dtype=STAGE
)
"""How candidates are moved to the image, with bounds in diameters."""
POINTS, KEPT, AT_PLACE = (0.3, 0.5, 1.0, 1.0), (24, 12, 8, 8), (2, 2, 3, 6)
"""Share of the observed points by which each stage moves them, candidates that go on, and of one place at most."""
BESIDE = (150, 300, 600, 1200)  # pixels about a candidate that show whether the surface goes on beyond it
TURNED = 3  # before this stage the best candidates are also turned to where the surface is nearly the same

EVIDENCE = -3.71, 8.82, -2.23, -6.47, -8.38
"""The weights of the columns of `evidence_of` in the log odds that the object is there (`experiments/sight_fit.py`)."""


@dataclass(frozen=True, eq=False)
class JudgedStarts:
    """`JudgedStarts` say what a depth image says of k poses that somebody else has estimated."""

    Ts_camera_object: Array
    """(k, 4, 4) refined on the image, where that makes them better."""
    moved: Array
    """(k,) how far that moved the farthest point of the surface, modulo the object's symmetries [m]."""
    probabilities: Array
    """(k,) that the refined pose is right."""
    better: NDArray[np.bool_]
    """(k,) whether a pose elsewhere, more than a tenth of the diameter away, is twenty times as likely."""
    right: NDArray[np.bool_]
    """(k,) whether the pose as it was given is right: it was moved by at most a tenth of the diameter, its probability
    is high enough to be answered, and no other pose is better."""


@renamed_members(looks="candidates")
@dataclass(frozen=True, eq=False)
class ObjectDetection:
    """An `ObjectDetection` has the poses that an object may have, the likeliest first; none, if it is not there."""

    Ts_camera_object: Array
    """(k, 4, 4)"""
    covariances: Array
    """(k, 6, 6) of (δp [m], δθ [rad]) along the camera's axes."""
    weights: Array
    """(k,) their sum is 1."""
    candidates: Candidates
    """(k,) CANDIDATE: what the image says of each."""
    probability: float = 0.0
    """That the object is where the first has it, against its absence, with a prior of one half; poses at one place,
    which may be turned differently, share it by their weights."""
    reason: str | None = None
    """Why there is none."""
    starts: JudgedStarts | None = None
    """Of the poses that were given: are they right? None: none was."""

    @classmethod
    def nowhere(cls, reason: str, starts: JudgedStarts | None = None, probability: float = 0.0) -> Self:
        """Returns a detection without poses, with the probability of the likeliest that was rejected."""
        none, T, covariance = np.zeros(0), np.zeros((0, 4, 4)), np.zeros((0, 6, 6))
        return cls(T, covariance, none, np.zeros(0, dtype=CANDIDATE), probability, reason, starts)


def first_pose(
    model: ObjectModel,
    scene: Scene,
    *,
    noise: DepthNoise = STRUCTURED_LIGHT,
    given: Candidates | None = None,
    prior: float = 0.0,
    modes: int = 0,
) -> ObjectDetection:
    """Returns the poses of the object that a depth image supports, modulo its symmetries; `noise`: of its depth.

    given CANDIDATE (k,): poses from elsewhere, which are scored in place and compared with those that are found. prior:
    the log odds that the object is there, before the image. modes: least number of poses that go on from each stage.

    Pairs of points vote for candidates. These are moved to where more and more points lie on the surface, and those
    that the image supports best go on. In the end the log odds rank the places that they have, and say how probable the
    first of these is; at each place the scores rank the poses.
    """
    appearance, D, camera = appearance_of(model), model.diameter, scene.camera
    image = camera.rays, scene.depth, scene.labels
    observed = observed_points(scene, FIRST_POSE.spacing * D, FIRST_POSE.max_points)
    # The points that vote are spread over the segments by the roots of their sizes: a big one must not take all.
    has = (observed["normal"] != 0).any(axis=1)
    counts = np.bincount(observed["part"][has], minlength=len(scene.sizes))
    share, chosen = np.sqrt(counts), [np.empty(0, dtype=np.int64)]
    for part in np.flatnonzero(counts >= FIRST_POSE.min_pixels):
        number = max(FIRST_POSE.min_references, round(FIRST_POSE.references * share[part] / share.sum()))
        chosen.append(np.flatnonzero(has & (observed["part"] == part))[:number])
    references = np.concatenate(chosen)
    voted = np.zeros((len(references), votes.PEAKS), dtype=CANDIDATE)
    votes.vote(appearance.pairs, appearance.voters, D, observed, references, FIRST_POSE.partners, voted)
    found = voted.reshape(-1)
    found = distinct(model, found, found["votes"], FIRST_POSE.max_voted, FIRST_POSE.voted_spacing)

    def refine(candidates: Candidates, stage: int, effort: int) -> None:
        """Moves candidates as one stage does, with as many points and pixels as another one takes."""
        candidates["bound"], now = explained_within(noise, center_depths(model, candidates)), STAGES[stage]
        points, record = observed[: round(POINTS[effort] * len(observed))], model.record[:2]
        depth_term.refine_poses(*record, points, np.atleast_1d(now), D, NOTHING_KNOWN, candidates)
        score_candidates(model, scene, candidates, effort=effort)

    for stage, kept in enumerate(KEPT):
        if stage == TURNED and len(appearance.turns):
            best = poses_of(found[: FIRST_POSE.turned])
            turned = candidates_at((best[:, None] @ appearance.turns).reshape(-1, 4, 4))
            refine(turned, stage, 0)
            found = np.concatenate([found, turned])
            found = distinct(model, found, found["score"], KEPT[1], FIRST_POSE.candidate_spacing)
        refine(found, stage, stage)
        found = distinct(model, found, found["score"], len(found), FIRST_POSE.candidate_spacing)
        places = places_of(model, found)
        better = np.tril(places[:, None] == places, -1).sum(axis=1)  # of the same place
        found = found[better < max(AT_PLACE[stage], modes)][: max(kept, modes)]
    for k in range(min(FIRST_POSE.turned, len(found))):
        if found["passed"][k] > FIRST_POSE.passed_share * found["expected"][k]:
            found[k : k + 1] = slid(model, scene, observed, found[k : k + 1], noise)
    outline.cross_outlines(camera.record, model.record[:2], image, found)
    if given is not None:
        given["bound"] = explained_within(noise, center_depths(model, given))
        score_candidates(model, scene, given)
        outline.cross_outlines(camera.record, model.record[:2], image, given)
        found, most = np.concatenate([given, found]), max(KEPT[-1], modes) + len(given)
        found = distinct(model, found, found["score"], most, FIRST_POSE.candidate_spacing)
    found = found[np.argsort(-log_odds(found), kind="stable")]
    covariances = pose_covariances(model, camera, observed, found, noise)
    places, support = places_of(model, found), mode_support(found, scene.sizes.sum() / max(len(observed), 1))
    best, most = np.full((2, places.max(initial=-1) + 1), -np.inf)
    np.maximum.at(best, places, log_odds(found) + prior)
    np.maximum.at(most, places, support)
    log_weights = best[places] + support - most[places]
    order = np.argsort(-log_weights, kind="stable")
    found, covariances = found[order], covariances[order]
    weights = np.exp(log_weights[order] - log_weights.max(initial=-np.inf))
    weights /= max(weights.sum(), 1.0)
    covariances += spread_of_modes(model, poses_of(found), weights, places[order])
    # Of several places all may be right: objects may be equal.
    probability = float(probabilities(best[:1]).sum())
    return ObjectDetection(poses_of(found), covariances, weights, found, probability)


def slid(
    model: ObjectModel, scene: Scene, observed: NDArray[np.void], candidate: Candidates, noise: DepthNoise
) -> Candidates:
    """Returns CANDIDATE (1,) where the image supports it best along the direction that DEPTH_POINT (n,) observe least.
    Points on walls do not tell where the walls end: pixels do that see past them, and those that are explained."""
    T, center = poses_of(candidate)[0], model.center_object
    covariance = pose_covariances(model, scene.camera, observed, candidate, noise)[0]
    units = np.repeat([1.0, model.radius], 3)  # radius times a turn is a shift
    covariance = GaussianPose(T, covariance).at_point(center).covariance * np.outer(units, units)
    least = np.linalg.eigh(covariance)[1][:, -1 - len(model.symmetries.axes)] / units
    steps = model.diameter * np.array(FIRST_POSE.slides)[:, None] * least
    R = se3.rotation_exp(steps[:, 3:]) @ T[:3, :3]
    tried = np.repeat(candidate, len(steps))
    tried["pose"]["rotation"] = R
    tried["pose"]["position"] = T[:3, :3] @ center + T[:3, 3] + steps[:, :3] - R @ center
    score_candidates(model, scene, tried)
    best = int(tried["score"].argmax())
    return tried[best : best + 1]


def score_candidates(model: ObjectModel, scene: Scene, candidates: Candidates, *, effort: int = -1) -> None:
    """Fills in the score of CANDIDATE (k,) with a bound, and the pixels that it is made of, with a stage's effort."""
    appearance, camera, image = appearance_of(model), scene.camera, (scene.depth, scene.labels)
    sides = appearance.sides if BESIDE[effort] == BESIDE[-1] else appearance.few_sides
    pose_score.score_all(camera.record, image, sides, model.center_object, candidates, pose_score.NOT_ASKED)
    around = camera.rays, *image
    outline.follow_outlines(camera.record, model.record[:2], around, BESIDE[effort], candidates)
    candidates["explained"][candidates["bound"] > FIRST_POSE.max_bound * model.diameter] = 0


def explained_within(noise: DepthNoise, z: Array) -> Array:
    """Returns how near to the surface a depth z (k,) [m] must be to be explained by it, (k,) [m]."""
    return np.asarray(np.maximum(FIRST_POSE.bound, FIRST_POSE.bound_sigmas * noise.sigma(z)))


def evidence_of(candidates: Candidates) -> Array:
    """Returns (k, 5) of CANDIDATE (k,): 1; the explained and the passed pixels by those that nothing hides; the shares
    of the outline at which the surface goes on, and (root) across which the observed one is smooth."""
    least = pose_score.POSE_SCORE.min_expected
    size = np.maximum(candidates["expected"], least)
    free = np.maximum(size - candidates["hidden"], least)
    shares = candidates["explained"] / free, candidates["passed"] / free, candidates["unexplained"] / size
    return np.stack([np.ones(len(candidates)), *shares, np.sqrt(candidates["smooth"])], axis=1)


def log_odds(candidates: Candidates) -> Array:
    """Returns (k,) log odds that the object is where CANDIDATE (k,) have it, against that it is not."""
    return np.asarray(evidence_of(candidates) @ EVIDENCE)


def probabilities(odds: Array) -> Array:
    """Returns the probabilities (n,) of answers with log odds (n,) against none of them; the rest to 1 is none's."""
    most = max(float(odds.max(initial=0.0)), 0.0)
    here = np.exp(odds - most)
    return np.asarray(here / (here.sum() + np.exp(-most)))


def logit(p: ArrayLike) -> Array:
    """Returns the log odds (n,) of probabilities (n,), finite also for 0 and 1."""
    p = np.asarray(p, dtype=np.float64)
    return np.asarray(np.log(np.maximum(p, 1e-300) / np.maximum(1 - p, 1e-16)))


def places_of(model: ObjectModel, candidates: Candidates) -> NDArray[np.int64]:
    """Returns the number (k,) of the place at which each of CANDIDATE (k,) has the object; the first one's is 0. Poses
    at one place may be turned differently."""
    centers = poses_of(candidates)[:, :3] @ np.append(model.center_object, 1.0)
    numbers = np.full(len(candidates), -1)
    for first in range(len(candidates)):
        if numbers[first] < 0:
            near = np.linalg.norm(centers - centers[first], axis=1) <= FIRST_POSE.place * model.diameter
            numbers[near & (numbers < 0)] = numbers.max() + 1
    return numbers


def spread_of_modes(model: ObjectModel, Ts: Array, weights: Array, places: NDArray[np.int64]) -> Array:
    """Returns the covariances (k, 6, 6) of the poses (k, 4, 4) that may be meant by each: of those of its place that
    are reached from it by small steps, as the spins of a mug are that hide its handle.

    Only likely poses of the first one's place count. The turns of a box are far apart: each is a mode by itself.
    """
    spread = np.zeros((len(Ts), 6, 6))
    likely = np.flatnonzero((places == 0) & (weights > FIRST_POSE.least_spread * weights.max(initial=0.0)))
    if len(likely) < 2:
        return spread
    nearest = np.array([[model.nearest(Ts[j], Ts[i]) for j in likely] for i in likely])
    moved = se3.apply(nearest, model.points_object) - se3.apply(Ts[likely], model.points_object)[:, None]
    near = np.linalg.norm(moved, axis=-1).max(axis=-1) < FIRST_POSE.step * model.diameter
    linked = np.linalg.matrix_power(near.astype(float), len(likely)) > 0
    off = se3.difference(nearest, Ts[likely][:, None])
    share = linked * weights[likely] / (linked * weights[likely]).sum(axis=1, keepdims=True)
    spread[likely] = np.einsum("ij,ija,ijb->iab", share, off, off)
    return spread


def mode_support(candidates: Candidates, pixels: float) -> Array:
    """Returns by how much (k,) the logarithms of the weights of CANDIDATE (k,) at one place differ, each with the
    weight of the points that support it; pixels: of a point.

    They share most of the surface, as poses of a mug do that differ by where the handle is. Shares of the expected
    pixels hardly differ between them; those that are explained, or that the camera sees past, do.
    """
    size = FIRST_POSE.support[0] + FIRST_POSE.support[1] * candidates["expected"][:1].sum()
    explained = pixels * candidates["weight"] - FIRST_POSE.passed * candidates["passed"]
    return np.asarray(explained / size + FIRST_POSE.score_weight * candidates["score"])
