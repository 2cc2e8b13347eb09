"""Depth points as evidence for a pose in the camera: each lies on the object's surface, or on something else.

The residual of a point P is the distance `d(Rᵀ(P - p))`, with Tukey's weight: a point farther off than a bound counts
nothing. By a step (τ, radius ω) of the object about a centre c its derivative is `-(g, (P - c)/radius × g)`, with the
field's gradient g in the camera's axes.
"""

from typing import Any

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.normal_equations import add_row
from handsight._compiled.records import NO_PRIOR, PRIOR_TERM, SHEET, VISION_PRIOR, WORKSPACE
from handsight._compiled.so3 import IDENTITY
from handsight._compiled.stack import local
from handsight._compiled.symmetry import pose_of, store_pose
from handsight._compiled.vec3 import (
    Pose,
    Vec3,
    apply,
    apply_inverse,
    dot,
    mul,
    neg,
    norm,
    scale,
    store,
    store33,
    sub,
    vector,
)
from handsight.correction.kernels.contact_term import Frame, distance_row
from handsight.correction.kernels.levenberg import IMAGE_DAMPING, damped_step, retract
from handsight.correction.kernels.prior_term import add_prior
from handsight.objects.kernels.field import field_at
from handsight.vision.kernels.depth_covariance import congruence, inform, pose_covariance, pose_jacobian

MIN_COSINE = 0.3  # the least cosine of a point's normal with the surface's
MAX_WALL = 0.05  # a wall that is thinner than this has points on both of its sides [diameters]
MAX_SHIFT, MAX_TURN = 0.15, 0.5  # the most that one step moves the object [diameters, rad]
COMPARED = 100  # points whose errors are compared with each other's, to stand for all


@inner
def bound_at(stage: Any, step: int) -> float:
    """Returns Tukey's bound of a step of a STAGE, in the unit of its bounds."""
    return stage.first_bound + (stage.last_bound - stage.first_bound) * (step / max(stage.steps - 1, 1))


@inner
def stepped(
    equations: Any, pose: Pose, frame: Frame, longest: tuple[float, float], workspace: Any
) -> tuple[bool, Pose]:
    """Returns whether the normal equations have a solution, and the pose after a damped step to it, at most so long."""
    step = damped_step(equations, frame[1], IMAGE_DAMPING, longest, workspace)
    if np.isnan(step[0][0]):
        return False, pose
    return True, retract(pose, step, frame[0], frame[1])


@inner
def _point(
    surface: Any, points: Any, pose: Pose, bound: float, wall: float
) -> tuple[float, float, Vec3, Vec3]:
    """Returns the weight and the residual of a DEPTH_POINT, its place, and the surface's normal there in the camera.

    A point whose normal is opposite to that of the nearest surface lies on the other side of a sheet, or of a wall
    that is thinner than `wall` [m]: its residual is the distance to that side.
    """
    nodes, field = surface
    P = vector(points.point)
    normal = vector(points.normal)
    across = 0.0
    place = apply_inverse(pose, P)
    has_normal = normal != (0.0, 0.0, 0.0)
    for side in range(2):
        distance, gradient, _ = field_at(nodes, field, place)
        ratio = (distance - across) / bound
        g = mul(pose[0], gradient)
        if has_normal:
            length = norm(g)
            cosine = dot(normal, g)
            if cosine < MIN_COSINE * length:
                if side == 0 and cosine < -MIN_COSINE * length and ratio * ratio < 1:
                    if field.kind == SHEET:
                        distance = -distance
                        g = neg(g)
                        break
                    across = distance + wall
                    place = sub(place, scale(gradient, across / length))
                    continue
                return 0.0, distance, P, g
        break
    distance -= across
    ratio = distance / bound
    if not ratio * ratio < 1:
        return 0.0, distance, P, g
    return (1 - ratio * ratio) ** 2, distance, P, g


@inner
def is_far(point: Any, center: Vec3, radius: float, bound: float) -> bool:
    """Returns whether a point in the camera is farther than a bound from an object, by the object's centre there.

    No point of an object is farther from its centre than 1.2 radii. Most points of an image are far from a candidate,
    and its field is not evaluated at them.
    """
    way = sub(vector(point), center)
    reach = 1.2 * radius + bound
    return dot(way, way) > reach * reach


@entry
def refine_poses(
    model: Any, nodes: Any, points: Any, stages: Any, unit: float, known: Any, candidates: Any
) -> None:
    """Moves CANDIDATE (k,) by Gauss-Newton steps to where DEPTH_POINT (n,) lie on the surface.

    stages: STAGE (r,), one after another, with bounds in `unit` [m]; no bound is less than a candidate's own. known (6,
    6): the information of each candidate's pose before, by (δp, δθ) of the object's centre along the camera's axes, in
    units of one point's residual [1/m²]; 0 where nothing is known.
    """
    workspace, prior = local(WORKSPACE), local(PRIOR_TERM)
    center = vector(model[0].center)
    radius = model[0].radius
    equations = workspace.now
    longest = (MAX_SHIFT * 2 * radius, MAX_TURN)
    wall = MAX_WALL * 2 * radius
    prior.kind = VISION_PRIOR if known[0, 0] > 0 else NO_PRIOR
    prior.has_axis = 0
    store(center, prior.pivot_object)
    for i in range(6):
        for j in range(6):
            prior.information[i, j] = known[i, j]
    for k in range(len(candidates)):
        pose = pose_of(candidates[k].pose)
        store(apply(pose, center), prior.pivot_palm)
        store33(pose[0], prior.rotation)
        for s in range(len(stages)):
            stage = stages[s]
            surface = nodes, model[0].fine if stage.fine else model[0].coarse
            for step in range(stage.steps):
                bound = max(unit * bound_at(stage, step), candidates[k].bound)
                frame = (apply(pose, center), radius)
                total = 0.0
                equations[:] = 0.0
                for n in range(0, len(points), stage.stride):
                    if is_far(points[n].point, frame[0], radius, bound):
                        continue
                    weight, distance, P, g = _point(surface, points[n], pose, bound, wall)
                    if weight > 0:
                        add_row(weight, distance_row(P, neg(g), distance, frame), equations)
                        total += weight
                if not total > 0:
                    break
                add_prior(prior, pose, frame, equations)
                solved, pose = stepped(equations, pose, frame, longest, workspace)
                if not solved:
                    break
        store_pose(pose, candidates[k].pose)


@entry
def surface_distances(model: Any, nodes: Any, points: Any, within: float, candidates: Any, out: Any) -> None:
    """Fills `out` (k, n) with the distances [m] of points (n, 3) from the surface at CANDIDATE (k,); infinity where
    they are not `within` it."""
    for k in range(len(candidates)):
        pose = pose_of(candidates[k].pose)
        center = apply(pose, vector(model[0].center))
        for n in range(len(points)):
            out[k, n] = np.inf
            if not is_far(points[n], center, model[0].radius, within):
                distance = abs(field_at(nodes, model[0].fine, apply_inverse(pose, vector(points[n])))[0])
                if distance < within:
                    out[k, n] = distance


@entry
def pose_covariances(
    model: Any, nodes: Any, points: Any, errors: Any, candidates: Any, informed: Any, out: Any
) -> None:
    """Fills `out` (k, 6, 6) with the covariances of CANDIDATE (k,) by (δp, δθ) of the object's origin along the
    camera's axes, from DEPTH_POINT (n,) with DEPTH_ERROR (k,).

    Also fills in the candidates' weight and `informed` (k, 2, 6, 6), as `inform` does, by (δp, radius δθ) of the
    object's centre.
    """
    weights = np.empty(len(points))
    places = np.empty((len(points), 3))
    normals = np.empty((len(points), 3))
    J = np.empty((6, 6))
    radius = model[0].radius
    surface = (nodes, model[0].fine)
    wall = MAX_WALL * 2 * radius
    for k in range(len(candidates)):
        pose = pose_of(candidates[k].pose)
        count = 0
        total = 0.0
        center = vector(model[0].center)
        frame = apply(pose, center), radius
        for n in range(len(points)):
            if is_far(points[n].point, frame[0], radius, candidates[k].bound):
                continue
            weight, _, P, g = _point(surface, points[n], pose, candidates[k].bound, wall)
            if weight > 0:
                weights[count] = weight
                store(P, places[count])
                store(g, normals[count])
                total += weight
                count += 1
        candidates[k].weight = total
        inform(weights[:count], places, normals, frame, errors[k], COMPARED, informed[k])
        for i in range(3, 6):
            # The model's normals differ from the object's, and seem to observe turns that the object's do not.
            informed[k, 0, i, i] -= total * errors[k].normal
        pose_covariance(informed[k], errors[k], out[k])
        pose_jacobian(IDENTITY, neg(mul(pose[0], center)), radius, 1.0, J)
        congruence(J, out[k], out[k])
