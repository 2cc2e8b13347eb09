"""Phase 1: Gauss-Newton on the nearest surface samples in (point, w normal)."""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.normal_equations import add_equal_rows, add_row
from handsight._compiled.records import WORKSPACE
from handsight._compiled.stack import local
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
    skew,
    sub,
    tmul,
    vector,
)
from handsight.correction.kernels.contact_term import Frame, distance_row
from handsight.correction.kernels.levenberg import LONGEST_STEP, damped_step, retract
from handsight.correction.kernels.search_options import MATCH, SEARCH
from handsight.correction.kernels.terms import FIXED_NOISE, PRIOR, Evidence, add_evidence
from handsight.objects.kernels.samples import scan

f4 = np.float32
COSINE = float(np.cos(SEARCH.same_after_match[1]))


@inner
def nearest_sample(model: Any, contact: Any, pose: Pose) -> tuple[Vec3, Vec3]:
    """Returns point and normal, in the object's frame, of the sample nearest to a contact in (point, w normal)."""
    x = scale(apply_inverse(pose, vector(contact.point)), -2.0)
    n = scale(tmul(pose[0], vector(contact.normal)), -2 * model.normal_weight2)
    # |a - b|² without |a|², which is the same for every sample.
    query = f4(1.0), f4(x[0]), f4(x[1]), f4(x[2]), f4(n[0]), f4(n[1]), f4(n[2])
    sample = model.samples[scan(model.scan, query)]
    return vector(sample[0]), vector(sample[1])


@inner
def add_match(model: Any, term: Any, pose: Pose, frame: Frame, equations: Any) -> None:
    """Adds a contact's rows: the distance to its sample's plane, the distance along the plane beyond a band around the
    sample, and the difference of the normals."""
    contact = term.contact
    place, normal = nearest_sample(model, contact, pose)
    point = vector(contact.point)
    n = mul(pose[0], normal)
    offset = sub(point, apply(pose, place))
    distance = dot(offset, n)
    lateral = sub(offset, scale(n, distance))
    reach = norm(lateral)
    by_reach = scale(lateral, -1 / max(reach, 1e-300))
    turned = skew(scale(n, -1 / frame[1]))
    error = sub(n, vector(contact.normal))
    plane = 1 / (term.variance_point + model.sample_variance_distance)
    add_row(plane, distance_row(point, neg(n), distance, frame), equations)
    if reach > model.band:
        row = distance_row(point, by_reach, reach - model.band, frame)
        add_row(model.tangential_weight, row, equations)
    if contact.has_normal:
        facing = 1 / max(term.variance_normal + model.sample_variance_normal, 1e-12)
        still = (0.0, 0.0, 0.0)
        by_normal = (
            still + turned[0] + (error[0],),
            still + turned[1] + (error[1],),
            still + turned[2] + (error[2],),
        )
        add_equal_rows(facing, by_normal, equations)


@inner
def match(evidence: Evidence, pose: Pose, most: int) -> tuple[Pose, int, bool]:
    """Returns the pose after at most so many Gauss-Newton steps on nearest samples, the number of steps, and whether
    they converged."""
    workspace = local(WORKSPACE)
    model, equations = evidence.model, workspace.now
    frame = (evidence.center, model.radius)
    for taken in range(1, most + 1):
        equations[:] = 0.0
        for i in range(len(evidence.terms)):
            term = evidence.terms[i]
            if term.contact.used:
                add_match(model, term, pose, frame, equations)
        # Without walls: they would stop the object on the way to its place, as their cost is large from far away.
        add_evidence(evidence, PRIOR | FIXED_NOISE, model.coarse, pose, frame, equations)
        step = damped_step(equations, model.radius, 1e-9, LONGEST_STEP, workspace)
        pose = retract(pose, step, evidence.center, model.radius)
        longest = 0.0
        for k in range(3):
            longest = max(longest, max(abs(step[0][k]), abs(step[1][k])))
        if longest < MATCH.tolerance * model.radius:
            return pose, taken, True
    return pose, most, False


@inner
def are_near(model: Any, pose: Pose, other: Pose) -> bool:
    """Returns whether phase 1 led to nearly the same pose twice, not counting symmetries."""
    (R, _), (Q, _), center = pose, other, vector(model.center)
    gap = sub(apply(pose, center), apply(other, center))
    trace = dot(R[0], Q[0]) + dot(R[1], Q[1]) + dot(R[2], Q[2])
    return dot(gap, gap) < SEARCH.same_after_match[0] ** 2 and trace > 1 + 2 * COSINE
