"""A hand aligned with a depth image: each of its points lies on the surface at its pixel, is hidden, or is not there.

The residual of the hand's point P with normal n, where the image has the point Q, is `n·(Q - P)`, with Tukey's weight
by |Q - P|. By a step (τ, radius ω) of the hand about its middle c its derivative is `-(n, (P - c)/radius × n)` (point
to plane, Chen and Medioni 1991).
"""

from typing import Any

from handsight._compiled.jit import entry, inner
from handsight._compiled.normal_equations import add_row
from handsight._compiled.pinhole import whole
from handsight._compiled.records import WORKSPACE
from handsight._compiled.stack import local
from handsight._compiled.symmetry import pose_of, store_pose
from handsight._compiled.vec3 import Vec3, apply, cross, dot, mul, neg, norm, sub, vector
from handsight.correction.kernels.contact_term import distance_row
from handsight.vision.kernels.depth_term import bound_at, stepped
from handsight.vision.kernels.palm_scan import PALM_SCAN, observed_at
from handsight.vision.kernels.pose_score import ScoreWeights, finish_score

RANGE_FACTOR = 3.0  # bound along the ray, in bounds across it
HAND_SCORE = ScoreWeights(passed=1.5, hidden=0.1, unexplained=0.2, min_expected=100.0)


@inner
def _cosine(cells: Any, corner: Any, P: Vec3, n: Vec3) -> float:
    """Returns the cosine of a normal with that of the cell that a point is in; above 1 where none is known."""
    row = whole((P[1] / P[2] - corner[1]) / corner[2])
    column = whole((P[0] / P[2] - corner[0]) / corner[2])
    if not (0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]):
        return 2.0
    cell = cells[row, column]
    if cell[1] == 0.0 and cell[2] == 0.0 and cell[3] == 0.0:
        return 2.0
    return n[0] * cell[1] + n[1] * cell[2] + n[2] * cell[3]


@inner
def _row(camera: Any, image: Any, P: Vec3, n: Vec3, bound: float) -> tuple[float, float]:
    """Returns the weight and the residual of a point in the camera with its normal.

    image: depth (h, w) [m], rays (h, w, 2), cells and their corner as of `palm_scan.cells_of`.
    """
    depth, rays, cells, corner = image
    if not -dot(n, P) > PALM_SCAN.facing_cosine * norm(P):
        return 0.0, 0.0
    row, column, z = observed_at(camera, depth, P)
    if not z > 0:
        return 0.0, 0.0
    away = sub((float(rays[row, column, 0]) * z, float(rays[row, column, 1]) * z, z), P)
    ratio = norm(away) / bound
    if not ratio < 1 or _cosine(cells, corner, P, n) < PALM_SCAN.normal_cosine:
        return 0.0, 0.0
    return (1 - ratio * ratio) ** 2, dot(n, away)


@entry
def refine_hand(
    camera: Any, image: Any, hand: Any, middle: Any, radius: float, stages: Any, candidates: Any
) -> None:
    """Moves CANDIDATE (k,) by Gauss-Newton steps to where the hand's points (2, m, 3: with normals) lie on the image.

    image: as of `_row`. middle (3,) and radius of the hand [m]. stages: STAGE (1,), with bounds in metres.
    """
    workspace = local(WORKSPACE)
    stage = stages[0]
    equations, longest = workspace.now, (0.03, 0.3)  # [m, rad], of one step
    for k in range(len(candidates)):
        pose = pose_of(candidates[k].pose)
        for step in range(stage.steps):
            bound = bound_at(stage, step)
            total = 0.0
            frame = apply(pose, vector(middle)), radius
            equations[:] = 0.0
            for m in range(hand.shape[1]):
                P = apply(pose, vector(hand[0, m]))
                n = mul(pose[0], vector(hand[1, m]))
                weight, residual = _row(camera[0], image, P, n, bound)
                if weight > 0:
                    add_row(weight, distance_row(P, neg(n), residual, frame), equations)
                    total += weight
            if not total > 5.0:  # points that a step needs, by weight
                break
            solved, pose = stepped(equations, pose, frame, longest, workspace)
            if not solved:
                break
        store_pose(pose, candidates[k].pose)


@entry
def score_hand(camera: Any, image: Any, hand: Any, area: float, bound: float, candidates: Any) -> None:
    """Fills in the score of CANDIDATE (k,), and what it is made of; `unexplained`: pixels that have another normal.

    image: as of `_row`. hand: its visible points and normals (2, m, 3). area: what each point stands for [m²]. bound:
    depth within this is explained [m].
    """
    for k in range(len(candidates)):
        candidate = candidates[k]
        pose = pose_of(candidate.pose)
        candidate.expected = candidate.explained = candidate.passed = candidate.hidden = 0.0
        candidate.unexplained = candidate.rms = 0.0
        for m in range(hand.shape[1]):
            P = apply(pose, vector(hand[0, m]))
            n = mul(pose[0], vector(hand[1, m]))
            way = norm(P)
            cosine = -dot(n, P) / way
            if not cosine > PALM_SCAN.facing_cosine:
                continue
            _, _, z = observed_at(camera[0], image[0], P)
            if z < 0:
                continue
            pixels = area * camera[0].fx * camera[0].fy * cosine / (P[2] * P[2])
            candidate.expected += pixels if z > 0 else HAND_SCORE.unknown * pixels
            if z == 0:
                continue
            along = (z - P[2]) * way / P[2]
            off = along * cosine
            if off > bound or along > RANGE_FACTOR * bound:
                candidate.passed += pixels
            elif off < -bound or along < -RANGE_FACTOR * bound:
                candidate.hidden += pixels
            else:
                alike = _cosine(image[2], image[3], P, n)
                least, enough = 0.2, 0.8  # from none of a pixel to all of it
                share = min(max((alike - least) / (enough - least), 0.0), 1.0)
                if alike > 1.5:  # the pixel has no normal
                    share = 0.6
                score = pixels * (1 - (off / bound) ** 2) * share
                candidate.explained += score
                candidate.unexplained += pixels * (1 - share)
                candidate.rms += score * off * off
        finish_score(HAND_SCORE, candidate)


@entry
def rows_of(camera: Any, image: Any, hand: Any, pose: Any, bound: float, rows: Any) -> None:
    """Fills in `rows` (m, 8) of the hand's points at a POSE (1,): weight, residual [m], and (n, P × n) in the
    camera."""
    at = pose_of(pose[0])
    for k in range(hand.shape[1]):
        P = apply(at, vector(hand[0, k]))
        n = mul(at[0], vector(hand[1, k]))
        rows[k, 0], rows[k, 1] = _row(camera[0], image, P, n, bound)
        line = n + cross(P, n)
        for i in range(6):
            rows[k, 2 + i] = line[i]
