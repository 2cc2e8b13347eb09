"""A hand laid onto a depth image: each of its points lies on what is seen at its pixel, or is hidden, or not there.

Residual of a hand's point P with normal n, where the image has Q: `n·(Q - P)`, with Tukey's weight by |Q - P|. The hand
moves by (τ, ω), about its middle; the residual's derivative is `-(n, (P - c) × n)` (point to plane, Chen and Medioni).
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.image.palm_scan import PALM_SCAN
from handsight._kernels.image.pinhole import project
from handsight._kernels.math.simd import accumulate, local
from handsight._kernels.math.symmetry import pose_of, store_pose
from handsight._kernels.math.vec3 import Vec3, add, cross, dot, mul, neg, norm, scale, sub, vector
from handsight._kernels.records import WORKSPACE
from handsight._kernels.runtime.compilation import entry, inner
from handsight._kernels.solve.levenberg import IMAGE_DAMPING, damped_step, retract


class HandScoreOptions(NamedTuple):
    """`HandScoreOptions` say how a hand's pose is refined on a depth image, and what each of its pixels says of it."""

    max_shift: float = 0.03  # of one step [m]
    max_rotation: float = 0.3  # of one step [rad]
    min_points: float = 5.0  # points that a step needs, by weight
    explained_cosine: float = 0.8  # cosine of normals above which a pixel is explained entirely
    unexplained_cosine: float = 0.2  # cosine of normals below which a pixel is not explained at all
    without_normal: float = 0.6  # how much of a pixel without a normal is explained
    passed_weight: float = 1.5  # of a pixel that the camera sees past, against an explained one
    hidden_weight: float = 0.1  # of a pixel that something hides
    turned_weight: float = 0.2  # of a pixel with another normal
    size_exponent: float = 0.7  # of the number of pixels: between their sum and their share
    range_factor: float = 3.0  # bound along the ray, in bounds across it
    unknown_weight: float = 0.5  # of a pixel without depth
    min_expected: float = 100.0  # least number of expected pixels that a share is taken of [pixels]


HAND_SCORE = HandScoreOptions()


@inner
def _observed_at(camera: Any, depth: Any, P: Vec3) -> tuple[int, int, float]:
    """Returns row, column and depth of a point's pixel; depth below 0: out of the image."""
    u, v = project(camera, P)
    if not (-0.5 < u < depth.shape[1] - 0.5 and -0.5 < v < depth.shape[0] - 0.5):
        return 0, 0, -1.0
    row, column = int(v + 0.5), int(u + 0.5)
    z = depth[row, column]
    return row, column, float(z) if z > 0 else 0.0


@inner
def _cosine(cells: Any, corner: Any, P: Vec3, n: Vec3) -> float:
    """Returns the cosine of a normal with that of the cell that a point is in; above 1 where none is known."""
    row = int((P[1] / P[2] - corner[1]) / corner[2] + 0.5)
    column = int((P[0] / P[2] - corner[0]) / corner[2] + 0.5)
    if not (0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]):
        return 2.0
    cell = cells[row, column]
    if cell[1] == 0.0 and cell[2] == 0.0 and cell[3] == 0.0:
        return 2.0
    return n[0] * cell[1] + n[1] * cell[2] + n[2] * cell[3]


@inner
def row_of(camera: Any, image: Any, P: Vec3, n: Vec3, bound: float) -> tuple[float, float]:
    """Returns weight and residual of a point in the camera; image: depth (h, w), rays (h, w, 2), cells and their
    corner."""
    depth, rays, cells, corner = image
    if not -dot(n, P) > PALM_SCAN.facing_cosine * norm(P):
        return 0.0, 0.0
    row, column, z = _observed_at(camera, depth, P)
    if not z > 0:
        return 0.0, 0.0
    away = sub((float(rays[row, column, 0]) * z, float(rays[row, column, 1]) * z, z), P)
    ratio = norm(away) / bound
    if not ratio < 1 or _cosine(cells, corner, P, n) < PALM_SCAN.normal_cosine:
        return 0.0, 0.0
    return (1 - ratio * ratio) ** 2, dot(n, away)


@inner
def _add_points(
    camera: Any, image: Any, hand: Any, pose: Pose, frame: Frame, bound: float, equations: Any
) -> float:
    """Adds the rows of all of the hand's points to normal equations by a step (τ, radius ω) about a frame; returns
    their weights' sum."""
    (R, p), (center, radius), total = pose, frame, 0.0
    for k in range(hand.shape[1]):
        P, n = add(mul(R, vector(hand[0, k])), p), mul(R, vector(hand[1, k]))
        weight, residual = row_of(camera, image, P, n, bound)
        if weight > 0:
            by_shift = neg(n)
            by_turn = cross(scale(sub(P, center), 1 / radius), by_shift)
            accumulate((weight,), (by_shift + by_turn + (residual,),), equations)
            total += weight
    return total


@entry
def refine_hand(camera: Any, image: Any, hand: Any, middle: Any, stage: Any, candidates: Any) -> None:
    """Moves CANDIDATE (k,) by Gauss-Newton steps to where the hand's points (2, m, 3: with normals) lie on the image.

    image: as of `row_of`. middle (3,) of the hand. stage: Tukey's bound at first and at last [m], steps, radius [m].
    """
    workspace, steps, radius = local(WORKSPACE), int(stage[2]), stage[3]
    equations, longest = workspace.now, (HAND_SCORE.max_shift, HAND_SCORE.max_rotation)
    for k in range(len(candidates)):
        pose = pose_of(candidates[k].pose)
        for step in range(steps):
            bound = stage[0] + (stage[1] - stage[0]) * (step / max(steps - 1, 1))
            frame = add(mul(pose[0], vector(middle)), pose[1]), radius
            equations[:] = 0.0
            weight = _add_points(camera[0], image, hand, pose, frame, bound, equations)
            if not weight > HAND_SCORE.min_points:
                break
            moved = damped_step(equations, radius, IMAGE_DAMPING, longest, workspace)
            if np.isnan(moved[0][0]):
                break
            pose = retract(pose, moved, frame[0], radius)
        store_pose(pose, candidates[k].pose)


@inner
def _add(camera: Any, image: Any, P: Vec3, n: Vec3, limits: Any, candidate: Any) -> None:
    """Adds what the image says of one point."""
    way = norm(P)
    cosine, bound = -dot(n, P) / way, limits[1]
    if not cosine > PALM_SCAN.facing_cosine:
        return
    _, _, z = _observed_at(camera, image[0], P)
    if z < 0:
        return
    pixels = limits[0] * camera.fx * camera.fy * cosine / (P[2] * P[2])
    candidate.expected += pixels if z > 0 else HAND_SCORE.unknown_weight * pixels
    if z == 0:
        return
    along = (z - P[2]) * way / P[2]
    off = along * cosine
    if off > bound or along > HAND_SCORE.range_factor * bound:
        candidate.passed += pixels
    elif off < -bound or along < -HAND_SCORE.range_factor * bound:
        candidate.hidden += pixels
    else:
        alike = _cosine(image[2], image[3], P, n)
        share = (
            HAND_SCORE.without_normal
            if alike > 1.5
            else min(
                max(
                    (alike - HAND_SCORE.unexplained_cosine)
                    / (HAND_SCORE.explained_cosine - HAND_SCORE.unexplained_cosine),
                    0.0,
                ),
                1.0,
            )
        )
        score = pixels * (1 - (off / bound) ** 2) * share
        candidate.explained += score
        candidate.unexplained += pixels * (1 - share)
        candidate.rms += score * off * off


@entry
def score_hand(camera: Any, image: Any, hand: Any, limits: Any, candidates: Any) -> None:
    """Fills in the score of CANDIDATE (k,), and what it is made of; `unexplained`: pixels that have another normal.

    hand: points and normals (2, m, 3) that are seen from there. limits: area of a point [m²], bound of what is
    explained [m].
    """
    for k in range(len(candidates)):
        candidate = candidates[k]
        R, p = pose_of(candidate.pose)
        candidate.expected = candidate.explained = candidate.passed = candidate.hidden = (
            candidate.unexplained
        ) = candidate.rms = 0.0
        for m in range(hand.shape[1]):
            P, n = add(mul(R, vector(hand[0, m])), p), mul(R, vector(hand[1, m]))
            _add(camera[0], image, P, n, limits, candidate)
        candidate.rms = np.sqrt(candidate.rms / candidate.explained) if candidate.explained > 0 else np.inf
        cost = (
            HAND_SCORE.passed_weight * candidate.passed
            + HAND_SCORE.hidden_weight * candidate.hidden
            + HAND_SCORE.turned_weight * candidate.unexplained
        )
        candidate.score = (candidate.explained - cost) / max(
            candidate.expected, HAND_SCORE.min_expected
        ) ** HAND_SCORE.size_exponent


@entry
def rows_of(camera: Any, image: Any, hand: Any, pose: Any, bound: float, rows: Any) -> None:
    """Fills in `rows` (m, 8) at a POSE (1,): the weight, the residual [m], and (n, P × n) in the camera."""
    R, p = pose_of(pose[0])
    for k in range(hand.shape[1]):
        P, n = add(mul(R, vector(hand[0, k])), p), mul(R, vector(hand[1, k]))
        rows[k, 0], rows[k, 1] = row_of(camera[0], image, P, n, bound)
        line = n + cross(P, n)
        for i in range(6):
            rows[k, 2 + i] = line[i]
