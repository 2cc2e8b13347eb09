"""Points of the hand, which cannot be inside the object: one-sided evidence, one residual row for each link.

All points x_i of a link share the link's position error e. The link is outside the object if d(x_i + e) ≥ 0 for all of
them, and its cost is the smallest squared Mahalanobis length of such an e. Where all points are pushed out in the same
direction, that is the squared residual of the deepest point alone. The residual of a link is therefore the POWER-norm
of its points' residuals, a smooth maximum: there is no kink where another point becomes the deepest, and a link of one
point costs the square of its residual.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.normal_equations import add_row
from handsight._compiled.symmetry import pose_of, store_pose
from handsight._compiled.vec3 import (
    Pose,
    Vec3,
    add,
    apply,
    apply_inverse,
    cross,
    mul,
    norm,
    scale,
    sub,
    vector,
)
from handsight.checks import MAX_DISTANCE
from handsight.correction.kernels.contact_term import Frame
from handsight.objects.kernels.field import field_at

POWER = 8
"""Exponent of the norm, an even number; a hundred points of the same depth count as 1.8 times one of them."""
CLEARANCE_REACH = 0.2
"""Clearances are measured again when the object has moved by this many radii."""
MAX_FIELD_SLOPE = 1.25
"""Upper bound of the gradient's length on a grid, whose distance is not exact everywhere."""


@entry
def load_points(points: Any, contacts: Any, diameter: float, rows: Any) -> bool:
    """Fills in OUTSIDE rows of points (n, 3), each of a link by itself; returns whether all are within MAX_DISTANCE.

    Their sigma is 1.5 times that of the median contact (k,) or a thousandth of the object's diameter, whichever is
    larger: they are as uncertain as contacts, because of the same kinematics; the factor is for the common error of
    points near each other.
    """
    sigmas = np.empty(len(contacts))
    good = True
    for i in range(len(contacts)):
        C = contacts[i].covariance
        sigmas[i] = np.sqrt((C[0, 0] + C[1, 1] + C[2, 2]) / 3)
    sigma = 1.5 * max(np.median(sigmas), 1e-3 * diameter)
    for i in range(len(points)):
        row = rows[i]
        row.sigma, row.link = sigma, i
        for k in range(3):
            row.point[k] = points[i, k]
            good = good and abs(points[i, k]) <= MAX_DISTANCE
    return good


@inner
def _beyond_bounds(model: Any, place: Vec3) -> float:
    """Returns how far a point of the object's frame is outside the box around the object [m]; 0 within."""
    square = 0.0
    for k in range(3):
        off = max(model.bounds[0, k] - place[k], place[k] - model.bounds[1, k])
        if off > 0:
            square += off * off
    return np.sqrt(square)


@inner
def largest_move(model: Any, pose: Pose, other: Pose) -> float:
    """Returns an upper bound of how far any point within the object's bounds moves from one pose to another [m]."""
    R, Q = pose[0], other[0]
    low, high = vector(model.bounds[0]), vector(model.bounds[1])
    middle = scale(add(low, high), 0.5)
    shift = sub(apply(pose, middle), apply(other, middle))
    turn = 0.0
    for i in range(3):
        for j in range(3):
            turn += (R[i][j] - Q[i][j]) * (R[i][j] - Q[i][j])
    # A turn by θ moves the end of an arm by at most 2 sin(θ/2) arm lengths, and |R - Q|² = 8 sin²(θ/2).
    return norm(shift) + np.sqrt(turn / 2) * norm(sub(high, middle))


@inner
def reachable(evidence: Any, field: Any, pose: Pose) -> int:
    """Returns how many rows of OUTSIDE, the points, can matter at a pose: all or, where that is certain, none.

    A point that was farther from the object than any part of the object has moved since then is outside. So clearances
    are measured only when the object has moved by CLEARANCE_REACH and past the least of them, or on another field;
    `measured.move` tells how far it has moved since. To leave out points that are farther away does not change the
    cost, as long as the distance of a grid rises by at most MAX_FIELD_SLOPE per metre.
    """
    rows, measured = evidence.outside, evidence.measured
    if len(rows) == 0:
        return 0
    move = largest_move(evidence.model, pose, pose_of(measured.pose))
    limit = max(measured.least, CLEARANCE_REACH * evidence.model.radius)
    if not move <= limit or measured.nodes != field.nodes:
        move = 0.0
        measured.least = np.inf
        measured.points = 0
        measured.nodes = field.nodes
        store_pose(pose, measured.pose)
        for i in range(len(rows)):
            if rows[i].is_plane:
                break
            place = apply_inverse(pose, vector(rows[i].point))
            clearance = _beyond_bounds(evidence.model, place)
            if clearance == 0.0:
                clearance = field_at(evidence.nodes, field, place)[0] / MAX_FIELD_SLOPE
            rows[i].clearance = clearance
            measured.least = min(measured.least, clearance)
            measured.points += 1
    measured.move = move
    return measured.points if measured.least <= move else 0


@inner
def _depth(evidence: Any, field: Any, pose: Pose, point: Any) -> tuple[float, Vec3]:
    """Returns how deep a point of OUTSIDE is in the object, in its sigmas, and the field's gradient there; a depth of 0
    where the point is beyond the object's bounds."""
    place = apply_inverse(pose, vector(point.point))
    if _beyond_bounds(evidence.model, place) > 0:
        return 0.0, (0.0, 0.0, 0.0)
    distance, g, _ = field_at(evidence.nodes, field, place)
    return -(distance + point.slack) / point.sigma, g


@inner
def add_outside(evidence: Any, field: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds the row of every link: the norm ρ of its points' depths u, with dρ = Σ (u / ρ)^(POWER - 1) du."""
    outside = evidence.outside
    center, radius = frame
    n = reachable(evidence, field, pose)
    link = 0
    total = 0.0
    if n == 0:
        return
    by_shift = (0.0, 0.0, 0.0)
    by_turn = (0.0, 0.0, 0.0)
    move = evidence.measured.move
    for i in range(n + 1):  # one more, for the last link's row
        u = 0.0
        g = (0.0, 0.0, 0.0)
        point = outside[min(i, n - 1)]
        if i < n:
            if point.clearance > move:
                continue
            u, g = _depth(evidence, field, pose, point)
            if u <= 0:
                continue
        if total > 0 and (i == n or point.link != link):
            rho = total ** (1 / POWER)
            down = rho / total
            add_row(1.0, scale(by_shift, down) + scale(by_turn, down) + (rho,), equations)
            by_shift = (0.0, 0.0, 0.0)
            by_turn = (0.0, 0.0, 0.0)
            total = 0.0
        if u > 0:
            power = u**POWER
            slope = scale(mul(pose[0], g), power / (u * point.sigma))
            lever = scale(sub(vector(point.point), center), 1 / radius)
            by_shift = add(by_shift, slope)
            by_turn = add(by_turn, cross(lever, slope))
            total += power
            link = point.link


@inner
def links_within(evidence: Any, pose: Pose) -> int:
    """Returns how many links have a point in the object."""
    count = 0
    link = -1
    for i in range(reachable(evidence, evidence.model.fine, pose)):
        point = evidence.outside[i]
        if (count == 0 or point.link != link) and point.clearance <= evidence.measured.move:
            depth, _ = _depth(evidence, evidence.model.fine, pose, point)
            if depth > 0:
                count += 1
                link = point.link
    return count


@inner
def outside_cost(evidence: Any, field: Any, pose: Pose) -> float:
    """Returns the squared residuals of all links."""
    cost = 0.0
    total = 0.0
    link = 0
    for i in range(reachable(evidence, field, pose)):
        point = evidence.outside[i]
        if point.clearance > evidence.measured.move:
            continue
        u, _ = _depth(evidence, field, pose, point)
        if u > 0:
            if point.link != link:
                cost += total ** (2 / POWER)
                total = 0.0
                link = point.link
            total += u**POWER
    return cost + total ** (2 / POWER)
