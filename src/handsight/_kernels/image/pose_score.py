"""What a depth image says of an object at a pose: pixels that it explains, that see past it, that hide it.

Surface samples stand for the object, those of them that can be seen from about the camera's side, each worth the pixels
that its area covers.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.image.pinhole import project
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.math.vec3 import add, dot, mul, norm, scale, tmul, vector
from handsight._kernels.mesh.field import field_at
from handsight._kernels.runtime.compilation import entry, inner


class PoseScoreOptions(NamedTuple):
    """`PoseScoreOptions` say how well a pose of the object explains a depth image, pixel by pixel."""

    facing_cosine: float = 0.12
    """Least cosine between a sample's normal and the way to the camera for the sample to be visible."""
    max_range: float = 2.2  # how far the way to the camera is followed [radii]
    max_steps: int = 60  # steps along it
    passed_weight: float = 2.0  # of a pixel that the camera sees past, against an explained one
    hidden_weight: float = 0.3  # of a pixel that something hides
    unexplained_weight: float = 0.5  # of a pixel of the same part that the object does not explain
    max_unexplained: float = 2.0  # unexplained pixels that count at most, per explained one
    size_exponent: float = 0.7
    """Of the number of pixels: a sum prefers what is large and near, a share what is tiny."""
    unknown_weight: float = 0.5  # of a pixel without depth that the object would fill
    min_expected: float = 30.0  # least number of expected pixels that a share is taken of [pixels]


POSE_SCORE = PoseScoreOptions()

TABLE, HAND, OUT = -3, -2, -1
"""Labels of pixels that are the table's, the hand's, and of no part that is looked at."""


@entry
def visible_sets(model: Any, nodes: Any, points: Any, normals: Any, directions: Any, visible: Any) -> None:
    """Fills in which samples (m,) are seen from far along each direction (k, 3): `visible` (k, m).

    The way is followed through the fine field, in steps of its distance, so that nothing is drawn.
    """
    radius, field = model[0].radius, model[0].fine
    for k in range(len(directions)):
        way = vector(directions[k])
        for m in range(len(points)):
            place, normal = vector(points[m]), vector(normals[m])
            visible[k, m] = dot(normal, way) > POSE_SCORE.facing_cosine
            if not visible[k, m]:
                continue
            along, start = 0.0, add(place, scale(normal, 0.02 * radius))
            for _ in range(POSE_SCORE.max_steps):
                distance, _, _ = field_at(nodes, field, add(start, scale(way, along)))
                if distance < -0.01 * radius:
                    visible[k, m] = False
                    break
                along += max(distance, 0.03 * radius)
                if along > POSE_SCORE.max_range * radius:
                    break


@inner
def _nearest(directions: Any, way: tuple[float, float, float]) -> int:
    best, most = 0, -np.inf
    for k in range(len(directions)):
        cosine = directions[k, 0] * way[0] + directions[k, 1] * way[1] + directions[k, 2] * way[2]
        if cosine > most:
            best, most = k, cosine
    return best


@inner
def _add(
    image: Any, sample: tuple[float, float, float, float], bound: float, candidate: Any, explained: Any
) -> None:
    """Adds what the image says of a sample at (column, row, depth) that is worth so many pixels."""
    depth, labels = image
    column, row, z, pixels = int(sample[0] + 0.5), int(sample[1] + 0.5), sample[2], sample[3]
    observed, label = depth[row, column], labels[row, column]
    if not observed > 0:
        candidate.expected += POSE_SCORE.unknown_weight * pixels
        return
    off = observed - z
    if off < -bound and label == HAND:
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
        explained[label] += pixels


@inner
def _score(sizes: Any, explained: Any, candidate: Any) -> None:
    """Finishes what `_add` has added up; unexplained are pixels of the parts that it lies on, by share."""
    unexplained = total = 0.0
    for part in range(len(sizes)):
        unexplained += explained[part] * max(sizes[part] - explained[part], 0.0)
        total += explained[part]
    candidate.unexplained = unexplained / total if total > 0 else 0.0
    candidate.rms = np.sqrt(candidate.rms / candidate.explained) if candidate.explained > 0 else np.inf
    size = max(candidate.expected, POSE_SCORE.min_expected)
    cost = POSE_SCORE.passed_weight * candidate.passed + POSE_SCORE.hidden_weight * candidate.hidden
    cost += POSE_SCORE.unexplained_weight * min(candidate.unexplained, POSE_SCORE.max_unexplained * size)
    candidate.score = (candidate.explained - cost) / size**POSE_SCORE.size_exponent


@entry
def score_all(camera: Any, image: Any, sides: Any, sizes: Any, limits: Any, candidates: Any) -> None:
    """Fills in the score of CANDIDATE (k,), and what it is made of.

    image: depth (h, w) [m] and labels (h, w) of parts, `TABLE`, `HAND` or `OUT`. sides: samples and normals (2, m, 3),
    directions (d, 3), visible (d, m). sizes: pixels of each part (p,). limits: area of a sample [m²], least bound of
    what is explained [m], the object's centre (3).
    """
    samples, directions, visible = sides
    height, width = image[0].shape
    explained, center = np.empty(len(sizes)), (limits[2], limits[3], limits[4])
    density = limits[0] * camera[0].fx * camera[0].fy
    for k in range(len(candidates)):
        candidate = candidates[k]
        R, p = pose_of(candidate.pose)
        middle = add(mul(R, center), p)
        side = _nearest(directions, scale(tmul(R, middle), -1 / max(norm(middle), 1e-9)))
        explained[:], bound = 0.0, max(limits[1], candidate.bound)
        candidate.expected = candidate.explained = candidate.passed = candidate.hidden = candidate.rms = 0.0
        for m in range(samples.shape[1]):
            if visible[side, m]:
                P = add(mul(R, vector(samples[0, m])), p)
                u, v = project(camera[0], P)
                cosine = -dot(mul(R, vector(samples[1, m])), P) / norm(P)
                if cosine > 0 and -0.5 < u < width - 0.5 and -0.5 < v < height - 0.5:
                    sample = u, v, P[2], density * cosine / (P[2] * P[2])
                    _add(image, sample, bound, candidate, explained)
        _score(sizes, explained, candidate)
