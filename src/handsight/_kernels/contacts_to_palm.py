"""A hand's raw wrenches to contacts in the palm, with all that is uncertain about them: a finger at a time."""

import math
from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.sensing import uncertain_contact
from handsight._kernels.sensing_records import FINGER, PALM_CONTACT
from handsight._kernels.sensing_steps import CONTACT, Vec6, fingertip
from handsight._kernels.vec3 import (
    Mat33,
    Vec3,
    add,
    cross,
    dot,
    matmul,
    matrix,
    mul,
    norm,
    scale,
    store,
    store33,
    sub,
    times,
    tmul,
    transpose,
    vector,
)

NEAR_TIP = 0.003
"""A tip closer than this to another may touch it as well, by one chance in twenty or more [m].

One degree of each joint is 1.3 mm per axis at each of two tips.
"""
GAP_SCALE = 1.645 / (math.sqrt(2.0) * NEAR_TIP)
"""To what `erfc` takes [1/m]: a gap of NEAR_TIP is 1.645 standard deviations of it."""
TWO_AT_ONCE = 0.002**2, math.radians(12.0) ** 2
"""Variances per axis of point [m²] and normal [rad²] of what one contact is taken for that is two."""
STEPS = 12
"""Halved steps to the direction that separates two tips best; the gap is too small by 0.1-1 mm after them."""


@inner
def _load(reading: Any, finger: Any, gravity_sensor: Vec3) -> Vec6:
    """Force and torque of the object on the tip, in the sensor's frame: bias and weight taken out of a reading."""
    weight = scale(gravity_sensor, finger.mass)
    force = scale(sub(vector(reading[:3]), vector(finger.bias[:3])), finger.sign)
    torque = scale(sub(vector(reading[3:]), vector(finger.bias[3:])), finger.sign)
    return sub(force, weight), sub(torque, cross(vector(finger.center_of_mass), weight))


@inner
def _support(R: Mat33, axes: Vec3, u: Vec3) -> Vec3:
    """The point of an ellipsoid, from its centre, that is farthest along u."""
    local = times(axes, tmul(R, u))
    return mul(R, scale(times(axes, local), 1.0 / norm(local)))


@inner
def _gap(T: Any, axes: Vec3, T_other: Any, axes_other: Vec3) -> float:
    """The distance of two ellipsoids; where they overlap, a number below zero that says no more.

    The distance of convex bodies is the widest slab that separates them; each step turns the slab halfway towards the
    line between the points that touch it.
    """
    R, R_other = matrix(T), matrix(T_other)
    between = sub(vector(T_other[:3, 3]), vector(T[:3, 3]))
    u, widest = scale(between, 1.0 / max(norm(between), 1e-12)), -np.inf
    for _ in range(STEPS):
        v = sub(add(between, _support(R_other, axes_other, scale(u, -1.0))), _support(R, axes, u))
        widest = max(widest, dot(u, v))
        length = norm(v)
        if widest <= 0.0 or length < 1e-12:
            break
        u = add(u, scale(v, 1.0 / length))
        u = scale(u, 1.0 / max(norm(u), 1e-12))
    return widest


@inner
def _set_gaps(fingers: Any, Ts_palm_surface: Any, felt: Any) -> None:
    """Each tip's distance to the nearest other one."""
    for i in range(len(felt)):
        felt[i].gap = np.inf
        for j in range(i):
            axes, axes_other = vector(fingers[i].tip.semi_axes), vector(fingers[j].tip.semi_axes)
            gap = _gap(Ts_palm_surface[i], axes, Ts_palm_surface[j], axes_other)
            felt[i].gap, felt[j].gap = min(felt[i].gap, gap), min(felt[j].gap, gap)


@inner
def _rotate(R: Mat33, C: Any) -> None:
    """A covariance (6, 6) of two vectors in another frame, in place: `R block Rᵀ`, 3 x 3 each."""
    for row in range(0, 6, 3):
        for column in range(0, 6, 3):
            block = C[row : row + 3, column : column + 3]
            store33(matmul(matmul(R, matrix(block)), transpose(R)), block)


@inner
def _add_joints(J: Any, lever: Vec3, normal: Vec3, variance: float, C: Any) -> None:
    """Adds to a contact's covariance what each joint's `variance` makes of it.

    `J` (6, j): how the tip moves and turns by each joint; overwritten by how point and normal change, the point by
    `lever` from where the tip's motion is given.
    """
    for j in range(J.shape[1]):
        turn = J[3, j], J[4, j], J[5, j]
        store(add((J[0, j], J[1, j], J[2, j]), cross(turn, lever)), J[:3, j])
        store(cross(turn, normal), J[3:, j])
    for i in range(6):
        for k in range(6):
            total = 0.0
            for j in range(J.shape[1]):
                total += J[i, j] * J[k, j]
            C[i, k] += variance * total


@inner
def _keep_tangent(C: Any, n: Vec3) -> None:
    """Takes out of a covariance (6, 6) what a unit normal cannot do: change along itself."""
    for i in range(6):
        row = C[i, 3:]
        store(sub(vector(row), scale(n, dot(vector(row), n))), row)
    for j in range(6):
        column = C[3:, j]
        store(sub(vector(column), scale(n, dot(vector(column), n))), column)


@inner
def _to_palm(finger: Any, T_palm_surface: Any, T_palm_tip: Any, J: Any, felt: Any) -> None:
    """A contact sensed in its tip's frame, into the palm, with what tip and joints add to its covariance."""
    R, C = matrix(T_palm_surface), felt.covariance
    point = add(mul(R, vector(felt.point)), vector(T_palm_surface[:3, 3]))
    normal = mul(R, vector(felt.normal))
    store(point, felt.point)
    store(normal, felt.normal)
    _rotate(R, C)
    _add_joints(J, sub(point, vector(T_palm_tip[:3, 3])), normal, finger.variance_joint, C)
    two = 0.5 * math.erfc(GAP_SCALE * felt.gap)  # the chance that the sensor feels the sum of two contacts
    for i in range(3):
        C[i, i] += finger.variance_point + two * TWO_AT_ONCE[0]
        C[3 + i, 3 + i] += finger.variance_normal + two * TWO_AT_ONCE[1]
    _keep_tangent(C, normal)


@entry
def contacts_to_palm(
    fingers: Any, readings: Any, Ts_palm_tip: Any, jacobians: Any, gravity_palm: Any, felt: Any
) -> None:
    """What n `fingers` FINGER feel, by raw `readings` (n, 6), NaN where a sensor is silent.

    `jacobians` (n, 6, j): how the tips, at the origins of `Ts_palm_tip` (n, 4, 4), move and turn by each joint;
    overwritten. `gravity_palm` (3): zeros where it is not known, and the tips' weight stays in. Written: `felt` (n)
    PALM_CONTACT.
    """
    Ts_palm_surface = np.empty((len(fingers), 3, 4))
    for i in range(len(fingers)):
        R, finger = matrix(Ts_palm_tip[i]), fingers[i]
        store33(matmul(R, matrix(finger.R_tip_surface)), Ts_palm_surface[i])
        center = add(mul(R, vector(finger.center_tip)), vector(Ts_palm_tip[i, :3, 3]))
        store(center, Ts_palm_surface[i, :, 3])
    _set_gaps(fingers, Ts_palm_surface, felt)
    gravity = vector(gravity_palm)
    for i in range(len(fingers)):
        finger, contact = fingers[i], felt[i]
        tip = fingertip(finger.tip)
        load = _load(readings[i], finger, tmul(tip.R, tmul(matrix(Ts_palm_surface[i]), gravity)))
        sigmas = vector(finger.sigmas[:3]), vector(finger.sigmas[3:])
        answer = uncertain_contact(load, tip, sigmas, contact.covariance)
        contact.reason = int(answer[0])
        if answer[0] == CONTACT:
            store(answer[1], contact.point)
            store(answer[2], contact.normal)
            _to_palm(finger, Ts_palm_surface[i], Ts_palm_tip[i], jacobians[i], contact)


def warm() -> None:
    """Compiles the kernel, or loads it."""
    fingers, poses = np.ones(1, FINGER), np.eye(4)[None]
    contacts_to_palm(
        fingers, np.zeros((1, 6)), poses, np.zeros((1, 6, 1)), np.zeros(3), np.empty(1, PALM_CONTACT)
    )
