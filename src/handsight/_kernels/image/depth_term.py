"""Depth points as evidence for a pose in the camera: each lies on the object's surface, or on something else.

Residual of a point P: `d(Rᵀ(P - p))`, with Tukey's weight, so that what is farther off than a bound counts nothing.
The object moves by a step (τ, radius ω) about its centre c; the residual's derivative is `-(g, (P - c)/radius × g)`, g
the field's gradient in the camera.
"""

from typing import Any

import numpy as np

from handsight._kernels.evidence.contact_term import Frame, Pose
from handsight._kernels.evidence.prior_term import add_prior
from handsight._kernels.image.depth_covariance import covariance_of
from handsight._kernels.math.simd import accumulate, local
from handsight._kernels.math.symmetry import pose_of, store_pose
from handsight._kernels.math.vec3 import (
    Vec3,
    add,
    cross,
    dot,
    mul,
    neg,
    scale,
    store,
    store33,
    sub,
    tmul,
    vector,
)
from handsight._kernels.mesh.field import field_at
from handsight._kernels.records import NO_PRIOR, PRIOR_TERM, UNCERTAINTY, VISION_PRIOR, WORKSPACE
from handsight._kernels.runtime.compilation import entry, inner
from handsight._kernels.solve.levenberg import IMAGE_DAMPING, damped_step, retract

AGREES = 0.3
"""The least cosine of a point's normal with the surface's."""
LONGEST_SHIFT, LONGEST_TURN = 0.15, 0.5
"""Of one step [diameters, rad]."""
PAIRED = 100
"""Points whose errors are compared with each other's, for the others too."""


@inner
def _point(surface: Any, points: Any, pose: Pose, bound: float) -> tuple[float, float, Vec3, Vec3]:
    """Returns weight and residual of a DEPTH_POINT, where it is, and the surface's normal there in the camera."""
    nodes, field = surface
    R, p = pose
    P = vector(points.point)
    distance, gradient, _ = field_at(nodes, field, tmul(R, sub(P, p)))
    ratio, g, normal = distance / bound, mul(R, gradient), vector(points.normal)
    if not ratio * ratio < 1 or (dot(normal, g) < AGREES and normal != (0.0, 0.0, 0.0)):
        return 0.0, distance, P, g
    return (1 - ratio * ratio) ** 2, distance, P, g


@inner
def _add_points(surface: Any, points: Any, pose: Pose, frame: Frame, bound: float, equations: Any) -> float:
    """Adds the rows of all points to normal equations by a step (τ, radius ω) about a frame; returns their weights'
    sum. surface: nodes, field."""
    total, (center, radius) = 0.0, frame
    for n in range(len(points)):
        weight, distance, P, g = _point(surface, points[n], pose, bound)
        if weight > 0:
            by_shift = neg(g)
            by_turn = cross(scale(sub(P, center), 1 / radius), by_shift)
            accumulate((weight,), (by_shift + by_turn + (distance,),), equations)
            total += weight
    return total


@inner
def expected_pose(model: Any, information: Any, pose: Pose, prior: Any) -> None:
    """Fills in what is known of a pose beforehand: its information (6, 6) by (τ, ω) about the object's centre."""
    R, p = pose
    center = vector(model.center)
    prior.kind, prior.has_axis = VISION_PRIOR, 0
    store(center, prior.pivot_object)
    store(add(mul(R, center), p), prior.pivot_palm)
    store33(R, prior.rotation)
    for i in range(6):
        for j in range(6):
            prior.information[i, j] = information[i, j]


@inner
def refine_pose(model: Any, nodes: Any, points: Any, stage: Any, prior: Any, pose: Pose) -> Pose:
    """Returns the pose after Gauss-Newton steps to where points lie on the surface.

    stage: as of `refine_poses`, and a bound that no step goes below [m]; prior: PRIOR_TERM, the pose expected.
    """
    field = model.fine if stage[0] else model.coarse
    workspace, center, steps = local(WORKSPACE), vector(model.center), int(stage[3])
    equations, longest = workspace.now, (LONGEST_SHIFT * 2 * model.radius, LONGEST_TURN)
    for step in range(steps):
        bound = max(stage[1] + (stage[2] - stage[1]) * (step / max(steps - 1, 1)), stage[4])
        frame = add(mul(pose[0], center), pose[1]), model.radius
        equations[:] = 0.0
        if not _add_points((nodes, field), points, pose, frame, bound, equations) > 0:
            break
        add_prior(prior, pose, frame, equations)
        moved = damped_step(equations, model.radius, IMAGE_DAMPING, longest, workspace)
        if np.isnan(moved[0][0]):
            break
        pose = retract(pose, moved, frame[0], model.radius)
    return pose


@entry
def refine_poses(model: Any, nodes: Any, points: Any, stage: Any, candidates: Any) -> None:
    """Moves CANDIDATE (k,) to where DEPTH_POINT (n,) lie on the surface.

    stage: whether on the fine field, Tukey's bound at first and at last [m], steps; no bound is less than a candidate's
    own.
    """
    nothing = local(PRIOR_TERM)
    nothing.kind = NO_PRIOR
    for k in range(len(candidates)):
        bounded = stage[0], stage[1], stage[2], stage[3], candidates[k].bound
        pose = refine_pose(model[0], nodes, points, bounded, nothing, pose_of(candidates[k].pose))
        store_pose(pose, candidates[k].pose)


@entry
def refine_near(model: Any, nodes: Any, points: Any, stages: Any, known: Any, candidate: Any) -> None:
    """Moves CANDIDATE (1,) by stages (r, 5): as of `refine_poses`, and a stride, such that each takes every stride-th
    point.

    known (6, 6): information of its pose by (τ, ω) about the object's centre, in units of one point's residual [1/m²].
    """
    pose, prior = pose_of(candidate[0].pose), local(PRIOR_TERM)
    expected_pose(model[0], known, pose, prior)
    for k in range(len(stages)):
        bounded = stages[k, 0], stages[k, 1], stages[k, 2], stages[k, 3], candidate[0].bound
        pose = refine_pose(model[0], nodes, points[:: int(stages[k, 4])], bounded, prior, pose)
    store_pose(pose, candidate[0].pose)


@entry
def closeness(model: Any, nodes: Any, points: Any, within: Any, candidates: Any) -> None:
    """Fills in how many of DEPTH_POINT (n,) lie on the surface of CANDIDATE (k,), each by how near, within so far
    (k,) [m]."""
    for k in range(len(candidates)):
        R, p = pose_of(candidates[k].pose)
        close = 0.0
        for n in range(len(points)):
            point = tmul(R, sub(vector(points[n].point), p))
            ratio = field_at(nodes, model[0].fine, point)[0] / within[k]
            close += max(1 - ratio * ratio, 0.0)
        candidates[k].close = close


@inner
def _pulls(surface: Any, points: Any, pose: Pose, about: Vec3, bound: float, pulls: tuple[Any, Any]) -> int:
    """Returns how many points count, and how their depths pull the object by (τ, ω).

    told: `values`, the sum of pulls, `wider`, of their squares; (m, 8) slopes x/z and y/z and pull of those first.
    """
    u, rows = pulls
    count = 0
    u.values[:] = 0.0
    u.wider[:] = 0.0
    for n in range(len(points)):
        weight, _, P, g = _point(surface, points[n], pose, bound)
        if not weight > 0:
            continue
        pull, lever = weight * dot(g, P) / P[2], g + cross(sub(P, about), g)
        for i in range(6):
            u.values[i] += pull * lever[i]
            for j in range(6):
                u.wider[i, j] += pull * lever[i] * pull * lever[j]
        if count < len(rows):
            rows[count, 0], rows[count, 1] = P[0] / P[2], P[1] / P[2]
            for i in range(6):
                rows[count, 2 + i] = pull * lever[i]
        count += 1
    return count


@inner
def _spread(pulls: tuple[Any, Any], count: int, error: Any, out: Any) -> None:
    """Returns the covariance of the sum of all points' pulls; what neighbours share by a few. error: as of
    `inform_all`."""
    u, rows = pulls
    few = min(count, len(rows))
    pairs = count * (count - 1) / max(few * (few - 1), 1)
    for i in range(6):
        for j in range(6):
            out[i, j] = (error[0] + error[1] + error[2]) * u.wider[i, j] + error[3] * u.values[i] * u.values[
                j
            ]
    for n in range(few):
        u.values[:] = 0.0
        for m in range(n):
            du, dv = rows[n, 0] - rows[m, 0], rows[n, 1] - rows[m, 1]
            distance2 = du * du + dv * dv
            shared = pairs * (
                error[1] * np.exp(-distance2 * error[4]) + error[2] * np.exp(-distance2 * error[5])
            )
            for i in range(6):
                u.values[i] += shared * rows[m, 2 + i]
        for i in range(6):
            for j in range(6):
                out[i, j] += rows[n, 2 + i] * u.values[j] + u.values[i] * rows[n, 2 + j]


@entry
def inform_all(model: Any, nodes: Any, points: Any, errors: Any, candidates: Any, out: Any) -> None:
    """Fills in what DEPTH_POINT (n,) say of each CANDIDATE (k,) by (δp, δθ) of the object's centre along the camera's
    axes.

    `out` (k, 3, 6, 6): the information of independent points of a standard deviation of 1 m, by their weights, the
    covariance of their pulls, and that of the pose, by (δp, δθ) of the object's *origin*. errors (k, 11) of depth:
    variances of a pixel's own noise, of what neighbours share, of a smooth bias and of the whole image's [m²], one over
    the squared lengths of the second and the third [slopes], and Tukey's least bound [m]; then the variance of what an
    image is off aside [m²], half of that of the model's normals [rad²], and what is known without any point of a shift
    and of radius times a turn [1/m²].
    """
    u, rows = local(UNCERTAINTY), np.empty((PAIRED, 8))
    for k in range(len(candidates)):
        pose, bound = pose_of(candidates[k].pose), max(errors[k, 6], candidates[k].bound)
        arm = mul(pose[0], vector(model[0].center))
        surface, about = (nodes, model[0].fine), add(arm, pose[1])
        u.equations[:] = 0.0
        candidates[k].weight = _add_points(surface, points, pose, (about, 1.0), bound, u.equations)
        for i in range(6):
            for j in range(6):
                out[k, 0, i, j] = u.equations[i, j]
        count = _pulls(surface, points, pose, about, bound, (u, rows))
        _spread((u, rows), count, errors[k], out[k, 1])
        covariance_of(out[k], errors[k], arm, model[0].radius, candidates[k].weight, u)
