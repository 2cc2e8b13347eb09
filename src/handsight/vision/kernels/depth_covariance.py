"""The covariance of a pose from points of a depth image, and how far off it leaves the object's surface.

A point P of weight w on a surface of normal n adds w l lᵀ to the information A of the pose, with l = (n, (P - c)/r × n)
by (δp, r δθ) about a centre c. An error e of its depth moves the point along its ray by e P/z, which pulls the pose by
e w (n·P)/z l. The errors of different points are correlated, and so is their pull, of covariance S: the pose has the
covariance A⁻¹ S A⁻¹ (Huber's sandwich), where the points observe it.
"""

from typing import Any

import numpy as np

from handsight._compiled.dense6 import eigen, factor, from_eigen, solve
from handsight._compiled.jit import entry, inner
from handsight._compiled.so3 import IDENTITY, rotation_exp
from handsight._compiled.symmetry import transform_of
from handsight._compiled.vec3 import Mat33, Vec3, add, cross, dot, mul, scale, store, sub, tmul, vector
from handsight.correction.kernels.contact_term import Frame
from handsight.objects.kernels.field import field_at


@inner
def inform(
    weights: Any, points: Any, normals: Any, frame: Frame, error: Any, compared: int, out: Any
) -> None:
    """Fills `out` (2, 6, 6) with the information of points of a unit variance, and the covariance of their summed pull.

    weights (m,), points and normals (m, 3) in the camera; frame: centre and radius; error: DEPTH_ERROR. What neighbours
    share is summed over the pairs of the first `compared` points, and scaled to all pairs.
    """
    center, radius = frame
    count = len(weights)
    few = min(count, compared)
    pulls = np.empty((few, 6))
    total = np.zeros(6)
    shared = np.empty(6)
    out[:] = 0.0
    for n in range(count):
        P, normal = vector(points[n]), vector(normals[n])
        lever = normal + cross(scale(sub(P, center), 1 / radius), normal)
        pull = weights[n] * dot(normal, P) / P[2]
        for i in range(6):
            total[i] += pull * lever[i]
            if n < few:
                pulls[n, i] = pull * lever[i]
            for j in range(6):
                out[0, i, j] += weights[n] * lever[i] * lever[j]
                out[1, i, j] += (error.own + error.shared + error.smooth) * pull * lever[i] * pull * lever[j]
    for i in range(6):
        for j in range(6):
            out[1, i, j] += error.offset * total[i] * total[j]
    pairs = count * (count - 1) / max(few * (few - 1), 1)
    for n in range(few):
        shared[:] = 0.0
        for m in range(n):
            du = points[n, 0] / points[n, 2] - points[m, 0] / points[m, 2]
            dv = points[n, 1] / points[n, 2] - points[m, 1] / points[m, 2]
            distance2 = du * du + dv * dv
            shared_noise = error.shared * np.exp(-distance2 * error.shared_decay)
            covariance = pairs * (shared_noise + error.smooth * np.exp(-distance2 * error.smooth_decay))
            for i in range(6):
                shared[i] += covariance * pulls[m, i]
        for i in range(6):
            for j in range(6):
                out[1, i, j] += pulls[n, i] * shared[j] + shared[i] * pulls[n, j]


@inner
def congruence(J: Any, symmetric: Any, out: Any) -> None:
    """Fills `out` (6, 6) with J M Jᵀ, of a symmetric M, which may be `out` itself."""
    product = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            product[i, j] = 0.0
            for k in range(6):
                product[i, j] += J[i, k] * symmetric[k, j]
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for k in range(6):
                value += product[i, k] * J[j, k]
            out[i, j] = out[j, i] = value


@inner
def pose_jacobian(R: Mat33, arm: Vec3, before: float, after: float, out: Any) -> None:
    """Fills `out` (6, 6) with the derivative of (δp, after δθ) of a point of a body, along the axes R, by
    (δp, before δθ) of the body's origin; `arm`: from the origin to the point."""
    out[:] = 0.0
    for j in range(3):
        store(R[j], out[:3, j])
        store(scale(tmul(R, cross(IDENTITY[j], arm)), 1 / before), out[:3, 3 + j])
        store(scale(R[j], after / before), out[3:, 3 + j])


@inner
def pose_covariance(informed: Any, error: Any, out: Any) -> None:
    """Fills `out` (6, 6) with the covariance of a pose by (δp, r δθ) of its centre: (A S⁻¹ A + U)⁻¹ + v.

    informed (2, 6, 6): A and S, as `inform` fills them in; error: DEPTH_ERROR, with the diagonals of U and v.
    """
    A, S_inverse = informed[0].copy(), informed[1].copy()
    information, root, vectors = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    values, column = np.empty(6), np.empty(6)
    trace = 0.0
    for i in range(6):
        trace += informed[1, i, i]
    eigen(S_inverse, values, vectors)
    for k in range(6):
        # S is summed over some of the pairs of points, and may be less than nothing along a direction.
        values[k] = 1 / (max(values[k], 0.0) + 1e-3 * trace / 6 + 1e-12)
    from_eigen(values, vectors, 1.0, S_inverse)
    eigen(A, values, vectors)
    for k in range(6):
        values[k] = max(values[k], 0.0)
    from_eigen(values, vectors, 1.0, A)
    congruence(A, S_inverse, information)
    for i in range(6):
        information[i, i] += error.known_shift if i < 3 else error.known_turn
    factor(information, 6, 0.0, root)
    for j in range(6):
        for i in range(6):
            values[i] = 1.0 if i == j else 0.0
        solve(root, 6, values, column)
        column[j] += error.pose
        for i in range(6):
            out[i, j] = column[i]


@entry
def covariance_of(informed: Any, error: Any, out: Any) -> None:
    """Fills `out` (6, 6) as `pose_covariance` does; error: DEPTH_ERROR (1,)."""
    pose_covariance(informed, error[0], out)


@entry
def largest_shift(model: Any, nodes: Any, T_camera_object: Any, covariance: Any) -> float:
    """Returns the most that one sigma along any of the three least known directions moves the object's surface [m].

    covariance (6, 6): of (δp, δθ) of the object's origin along the camera's axes. A turn that the object looks the same
    after does not move its surface.
    """
    R = transform_of(T_camera_object)[0]
    radius = model[0].radius
    center = vector(model[0].center)
    J = np.empty((6, 6))
    along_object = np.empty((6, 6))
    values = np.empty(6)
    vectors = np.empty((6, 6))
    pose_jacobian(R, mul(R, center), 1.0, radius, J)
    congruence(J, covariance, along_object)
    eigen(along_object, values, vectors)
    largest = 0.0
    for _ in range(3):
        k = np.argmax(values)
        sigma = np.sqrt(max(values[k], 0.0))
        values[k] = -np.inf
        shift = scale(vector(vectors[:3, k]), sigma)
        turn = rotation_exp(scale(vector(vectors[3:, k]), sigma / radius))
        for m in range(len(model[0].samples)):
            arm = sub(vector(model[0].samples[m, 0]), center)
            point = add(mul(turn, arm), add(center, shift))
            largest = max(largest, abs(field_at(nodes, model[0].fine, point)[0]))
    return largest


@entry
def inform_points(
    weights: Any, points: Any, normals: Any, center: Any, radius: float, error: Any, compared: int, out: Any
) -> None:
    """Fills `out` (2, 6, 6) as `inform` does; center (3,) in the camera, error: DEPTH_ERROR (1,)."""
    inform(weights, points, normals, (vector(center), radius), error[0], compared, out)
