"""An object's first pose from a depth image, without a guess."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import se3
from handsight.checks import Array, Indices
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
from handsight.vision.kernels import depth_term, outline, pose_score, votes
from handsight.vision.kernels.vision_records import CANDIDATE, STAGE
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.region import Scene, observed_points

FIRST_SPACING = 1 / 24  # of observed points [diameters]
MAX_POINTS = 1200  # observed points
FIRST_REFERENCES = 28  # points that vote
MIN_REFERENCES = 4  # of each segment at least
FIRST_PARTNERS = 140  # points that each is paired with
MIN_PIXELS = 10  # points with a normal that a segment must have to vote
MAX_VOTED = 150  # candidates of the votes that are compared with the image
VOTED_SPACING = 0.05  # between these [diameters]
CANDIDATE_SPACING = 0.08  # between those that go on [diameters]
FIRST_TURNED = 2  # candidates that are turned to where the surface is nearly the same
PASSED_SHARE = 0.05  # of the expected pixels, above which the best candidates slide
FIRST_SLIDES = 0.015 * np.arange(-4, 5)  # [diameters]
FIRST_BOUND = 0.006  # depth within this of the surface is explained [m]
BOUND_SIGMAS = 4  # or within so many sigmas of the depth, where that is more
MAX_BOUND = 0.5  # beyond which depth tells no shape from another: it is too far away [diameters]
FIRST_PLACE = 0.25  # poses whose centres are nearer to each other are of one place [diameters]
SCORE_WEIGHT = 1.5  # of the score in the logarithm of a mode's weight among those of its place
FIRST_PASSED = 2.0  # cost of a pixel that the camera sees past, against one that such a mode explains
FIRST_STEP = 0.3  # between poses of one place that may be one unobserved motion [diameters]
LEAST_SPREAD = 0.02  # weight of such a pose, as a share of the likeliest one's
FIRST_SUPPORT = (30, 0.018)
"""Those pixels by which that logarithm differs by 1, and what is added to them per expected pixel: neighbouring
pixels have errors in common, and so has all of the surface."""

STAGES = np.zeros(4, dtype=STAGE)
"""How candidates are moved to the image, with bounds in diameters."""
STAGES["fine"] = 0, 0, 1, 1
STAGES["first_bound"] = BOUNDS = 0.12, 0.08, 0.05, 0.03
STAGES["last_bound"] = *BOUNDS[1:], 0
STAGES["steps"] = 4, 4, 4, 5
STAGES["stride"] = 1
POINTS, KEPT, AT_PLACE = (0.3, 0.5, 1.0, 1.0), (24, 12, 8, 8), (2, 2, 3, 6)
"""Share of the observed points by which each stage moves them, candidates that go on, and of one place at most."""
BESIDE = (150, 300, 600, 1200)  # pixels about a candidate that show whether the surface goes on beyond it
TURNED = 3  # before this stage the best candidates are also turned to where the surface is nearly the same

EVIDENCE = -3.71, 8.82, -2.23, -6.47, -8.38
"""The weights of the columns of `evidence_of` in the log odds that the object is there,
fitted to real frames of YCB-Video and drawn images."""


@dataclass(frozen=True, eq=False)
class ObjectDetection:
    """The poses that an object may have, the likeliest first; none, if it is not there."""

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

    @classmethod
    def nowhere(cls, reason: str, probability: float = 0.0) -> Self:
        """Returns a detection without poses, with the probability of the likeliest that was rejected."""
        none = np.zeros(0, dtype=CANDIDATE)
        return cls(poses_of(none), np.zeros((0, 6, 6)), np.zeros(0), none, probability, reason)


def first_pose(
    model: ObjectModel,
    scene: Scene,
    *,
    noise: DepthNoise = STRUCTURED_LIGHT,
    given: Candidates | None = None,
    prior: float = 0.0,
) -> ObjectDetection:
    """Returns the poses of the object that a depth image supports, modulo its symmetries; `noise`: of its depth.

    given CANDIDATE (k,): poses from elsewhere, which are scored in place and compared with those that are found. prior:
    the log odds that the object is there, before the image.

    Pairs of points vote for candidates. These are moved to where more and more points lie on the surface, and those
    that the image supports best go on. In the end the log odds rank the places that they have, and say how probable the
    first of these is; at each place the scores rank the poses.
    """
    appearance = appearance_of(model)
    D = model.diameter
    camera = scene.camera
    image = camera.rays, scene.depth, scene.labels
    observed = observed_points(scene, FIRST_SPACING * D, MAX_POINTS)
    references = spread_references(scene, observed)
    voted = np.zeros((len(references), votes.PEAKS), dtype=CANDIDATE)
    votes.vote(appearance.pairs, appearance.voters, D, observed, references, FIRST_PARTNERS, voted)
    found = voted.reshape(-1)
    found = distinct(model, found, found["votes"], MAX_VOTED, VOTED_SPACING)

    def refine(candidates: Candidates, stage: int, effort: int) -> None:
        """Moves candidates as one stage does, with as many points and pixels as another one takes."""
        candidates["bound"] = explained_within(noise, center_depths(model, candidates))
        points = observed[: round(POINTS[effort] * len(observed))]
        stages = STAGES[[stage]]
        depth_term.refine_poses(*model.record[:2], points, stages, D, NOTHING_KNOWN, candidates)
        score_candidates(model, scene, candidates, effort=effort)

    for stage, kept in enumerate(KEPT):
        if stage == TURNED and len(appearance.turns):
            best = poses_of(found[:FIRST_TURNED])
            turned = candidates_at((best[:, None] @ appearance.turns).reshape(-1, 4, 4))
            refine(turned, stage, 0)
            found = np.concatenate([found, turned])
            found = distinct(model, found, found["score"], KEPT[1], CANDIDATE_SPACING)
        refine(found, stage, stage)
        found = distinct(model, found, found["score"], len(found), CANDIDATE_SPACING)
        places = places_of(model, found)
        better = np.tril(places[:, None] == places, -1).sum(axis=1)  # of the same place
        found = found[better < AT_PLACE[stage]][:kept]
    for k in range(min(FIRST_TURNED, len(found))):
        if found["passed"][k] > PASSED_SHARE * found["expected"][k]:
            found[k : k + 1] = slid(model, scene, observed, found[k : k + 1], noise)
    if given is not None:
        given["bound"] = explained_within(noise, center_depths(model, given))
        score_candidates(model, scene, given)
        found = np.concatenate([given, found])
        found = distinct(model, found, found["score"], len(found), CANDIDATE_SPACING)
    outline.cross_outlines(camera.record, model.record[:2], image, found)
    found = found[np.argsort(-log_odds(found), kind="stable")]
    covariances = pose_covariances(model, camera, observed, found, noise)  # fills in their weights
    places = places_of(model, found)
    support = mode_support(found, scene.sizes.sum() / max(len(observed), 1))
    best, most = np.full((2, places.max(initial=-1) + 1), -np.inf)
    np.maximum.at(best, places, log_odds(found) + prior)
    np.maximum.at(most, places, support)
    log_weights = best[places] + support - most[places]
    order = np.argsort(-log_weights, kind="stable")
    found = found[order]
    weights = np.exp(log_weights[order] - log_weights.max(initial=-np.inf))
    weights /= max(weights.sum(), 1.0)
    covariances = covariances[order]
    covariances += spread_of_modes(model, poses_of(found), weights, places[order])
    # Of several places all may be right: objects may be equal.
    probability = float(probabilities(best[:1]).sum())
    return ObjectDetection(poses_of(found), covariances, weights, found, probability)


def spread_references(scene: Scene, observed: NDArray[np.void]) -> Indices:
    """Returns the numbers (k,) of the DEPTH_POINT (n,) that vote. They are spread over the segments by the roots of
    their sizes: a big one must not take all."""
    has = (observed["normal"] != 0).any(axis=1)
    counts = np.bincount(observed["part"][has], minlength=len(scene.sizes))
    share = np.sqrt(counts)
    chosen = [np.empty(0, dtype=np.int64)]
    for part in np.flatnonzero(counts >= MIN_PIXELS):
        number = max(MIN_REFERENCES, round(FIRST_REFERENCES * share[part] / share.sum()))
        chosen.append(np.flatnonzero(has & (observed["part"] == part))[:number])
    return np.concatenate(chosen)


def slid(
    model: ObjectModel, scene: Scene, observed: NDArray[np.void], candidate: Candidates, noise: DepthNoise
) -> Candidates:
    """Returns CANDIDATE (1,) where the image supports it best along the direction that DEPTH_POINT (n,) observe least.
    Points on walls do not tell where the walls end: pixels do that see past them, and those that are explained."""
    T = poses_of(candidate)[0]
    center = model.center_object
    covariance = pose_covariances(model, scene.camera, observed, candidate, noise)[0]
    units = np.repeat([1.0, model.radius], 3)  # radius times a turn is a shift
    covariance = GaussianPose(T, covariance).at_point(center).covariance * np.outer(units, units)
    least = np.linalg.eigh(covariance)[1][:, -1 - len(model.symmetries.axes)] / units
    steps = model.diameter * FIRST_SLIDES[:, None] * least
    R = se3.rotation_exp(steps[:, 3:]) @ T[:3, :3]
    tried = np.repeat(candidate, len(steps))
    tried["pose"]["rotation"] = R
    tried["pose"]["position"] = T[:3, :3] @ center + T[:3, 3] + steps[:, :3] - R @ center
    score_candidates(model, scene, tried)
    best = int(tried["score"].argmax())
    return tried[best : best + 1]


def score_candidates(model: ObjectModel, scene: Scene, candidates: Candidates, *, effort: int = -1) -> None:
    """Fills in the score of CANDIDATE (k,) with a bound, and the pixels that it is made of, with a stage's effort."""
    appearance = appearance_of(model)
    camera = scene.camera
    image = (scene.depth, scene.labels)
    sides = appearance.sides if BESIDE[effort] == BESIDE[-1] else appearance.few_sides
    pose_score.score_all(camera.record, image, sides, model.center_object, candidates, pose_score.NOT_ASKED)
    around = camera.rays, *image
    outline.follow_outlines(camera.record, model.record[:2], around, BESIDE[effort], candidates)
    candidates["explained"][candidates["bound"] > MAX_BOUND * model.diameter] = 0


def explained_within(noise: DepthNoise, z: Array) -> Array:
    """Returns how near to the surface a depth z (k,) [m] must be to be explained by it, (k,) [m]."""
    return np.asarray(np.maximum(FIRST_BOUND, BOUND_SIGMAS * noise.sigma(z)))


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
    most = odds.max(initial=0.0)
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
            near = np.linalg.norm(centers - centers[first], axis=1) <= FIRST_PLACE * model.diameter
            numbers[near & (numbers < 0)] = numbers.max() + 1
    return numbers


def spread_of_modes(model: ObjectModel, Ts: Array, weights: Array, places: NDArray[np.int64]) -> Array:
    """Returns the covariances (k, 6, 6) of the poses (k, 4, 4) that may be meant by each: of those of its place that
    are reached from it by small steps, as the spins of a mug are that hide its handle.

    Only likely poses of the first one's place count. The turns of a box are far apart: each is a mode by itself.
    """
    spread = np.zeros((len(Ts), 6, 6))
    likely = np.flatnonzero((places == 0) & (weights > LEAST_SPREAD * weights.max(initial=0.0)))
    if len(likely) < 2:
        return spread
    nearest = np.array([[model.nearest(Ts[j], Ts[i]) for j in likely] for i in likely])
    moved = se3.apply(nearest, model.points_object) - se3.apply(Ts[likely], model.points_object)[:, None]
    near = np.linalg.norm(moved, axis=-1).max(axis=-1) < FIRST_STEP * model.diameter
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
    size = FIRST_SUPPORT[0] + FIRST_SUPPORT[1] * candidates["expected"][:1].sum()
    explained = pixels * candidates["weight"] - FIRST_PASSED * candidates["passed"]
    return np.asarray(explained / size + SCORE_WEIGHT * candidates["score"])
