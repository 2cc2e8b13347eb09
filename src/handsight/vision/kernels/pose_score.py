"""How well a depth image supports an object at a pose: pixels that it explains, that see past it, that hide it.

Samples of its surface stand for the object: those that are visible from about the camera's direction, each with as many
pixels as its area covers in the image.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.pinhole import project
from handsight._compiled.symmetry import pose_of
from handsight._compiled.vec3 import Vec3, apply, dot, mul, norm, scale, tmul, vector
from handsight.vision.kernels.vision_records import HAND, TABLE


class ScoreWeights(NamedTuple):
    """`ScoreWeights` say what pixels add to the score of a pose, against an explained one."""

    passed: float  # of a pixel where the camera sees past
    hidden: float  # of a pixel that something hides
    unexplained: float  # of an unexplained pixel
    min_expected: float  # least number of expected pixels that a share is taken of [pixels]
    unknown: float = 0.5  # what a pixel without depth, or out of the image, adds to those that are expected
    size_exponent: float = 0.7
    """Of the number of pixels: a sum prefers what is large and near, a share what is tiny."""


POSE_SCORE = ScoreWeights(passed=2.0, hidden=0.3, unexplained=1.0, min_expected=30.0)
NOT_ASKED = np.empty((0, 0, 2))  # in place of an array in which `score_all` says what hides each sample
MIN_FACING = 0.12
"""Least cosine between a sample's normal and the direction to the camera for the sample to be visible."""


@inner
def _nearest(directions: Any, way: Vec3) -> int:
    """Returns which of the directions (k, 3) is nearest to a direction."""
    best = 0
    most = -np.inf
    for k in range(len(directions)):
        cosine = dot(vector(directions[k]), way)
        if cosine > most:
            best, most = k, cosine
    return best


@inner
def _add(image: Any, sample: tuple[float, float, float, float], bound: float, candidate: Any) -> None:
    """Adds to a candidate what the image says of a sample: its column, row, depth [m] and number of pixels."""
    depth, labels = image
    column = int(sample[0] + 0.5)
    row = int(sample[1] + 0.5)
    z = sample[2]
    pixels = sample[3]
    observed, label = depth[row, column], labels[row, column]
    if not observed > 0:
        candidate.expected += POSE_SCORE.unknown * pixels
        return
    off = observed - z
    if off < -bound and label == HAND:
        return
    if label == TABLE and abs(off) <= bound:  # what is thin and lies on the table is left out with it
        return
    candidate.expected += pixels
    if off > bound or (off < -bound and label == TABLE):  # nothing is under the table
        candidate.passed += pixels
    elif off < -bound:
        candidate.hidden += pixels
    elif label >= 0:
        score = pixels * (1 - (off / bound) ** 2)
        candidate.explained += score
        candidate.rms += score * off * off


@inner
def finish_score(weights: ScoreWeights, candidate: Any) -> None:
    """Fills in the score of a candidate whose pixels are counted, and makes `rms` of its sum of squared distances."""
    candidate.rms = np.sqrt(candidate.rms / candidate.explained) if candidate.explained > 0 else np.inf
    size = max(candidate.expected, weights.min_expected)
    cost = weights.passed * candidate.passed + weights.hidden * candidate.hidden
    cost += weights.unexplained * candidate.unexplained
    candidate.score = (candidate.explained - cost) / size**weights.size_exponent


@entry
def score_all(camera: Any, image: Any, sides: Any, center: Any, candidates: Any, hidden: Any) -> None:
    """Fills in the score of CANDIDATE (k,) and the pixels that it is made of, none of which is unexplained.

    image: depth (h, w) [m] and labels (h, w) of segments, `TABLE`, `HAND` or `OUT`. sides: samples and normals
    (2, m, 3), directions (d, 3), visible (d, m / 8) in bits, area of a sample [m²].
    center: the object's (3,). hidden (k, m, 2): is filled, where something hides a sample, with the number of the pixel
    there, row by row, and how many the sample has; `NOT_ASKED`: neither is.
    """
    samples, directions, visible, area = sides
    height, width = image[0].shape
    density = area * camera[0].fx * camera[0].fy
    for k in range(len(candidates)):
        candidate = candidates[k]
        pose = pose_of(candidate.pose)
        middle = apply(pose, vector(center))
        side = _nearest(directions, scale(tmul(pose[0], middle), -1 / max(norm(middle), 1e-9)))
        candidate.expected = candidate.explained = candidate.passed = candidate.hidden = candidate.rms = 0.0
        candidate.unexplained = 0.0
        for m in range(samples.shape[1]):
            if visible[side, m >> 3] >> (m & 7) & 1:
                P = apply(pose, vector(samples[0, m]))
                u, v = project(camera[0], P)
                cosine = -dot(mul(pose[0], vector(samples[1, m])), P) / norm(P)
                if not cosine > 0:
                    continue
                pixels = density * cosine / (P[2] * P[2])
                if -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5:
                    before = candidate.hidden
                    _add(image, (u, v, P[2], pixels), candidate.bound, candidate)
                    if candidate.hidden > before and len(hidden):
                        hidden[k, m, 0] = int(v + 0.5) * width + int(u + 0.5)
                        hidden[k, m, 1] = pixels
                else:
                    candidate.expected += POSE_SCORE.unknown * pixels
        finish_score(POSE_SCORE, candidate)
