"""A hand's raw wrenches to contacts in the palm, with all that is uncertain about them: a finger at a time."""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import (
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
    tmul,
    transpose,
    vector,
)
from handsight._kernels.runtime.compilation import entry, inner
from handsight._kernels.touch.sensing import uncertain_contact
from handsight._kernels.touch.sensing_records import FINGER, PALM_CONTACT
from handsight._kernels.touch.sensing_steps import CONTACT, Vec6, fingertip
from handsight._kernels.touch.tips_touching import TWO_AT_ONCE, add_press, chance_of_touch, set_gaps


@inner
def _load(reading: Any, finger: Any, gravity_sensor: Vec3) -> Vec6:
    """Force and torque of the object on the tip, in the sensor's frame: bias and weight taken out of a reading."""
    weight = scale(gravity_sensor, finger.mass)
    force = scale(sub(vector(reading[:3]), vector(finger.bias[:3])), finger.sign)
    torque = scale(sub(vector(reading[3:]), vector(finger.bias[3:])), finger.sign)
    return sub(force, weight), sub(torque, cross(vector(finger.center_of_mass), weight))


@inner
def _rotate(R: Mat33, C: Any) -> None:
    """A covariance (6, 6) of two vectors in another frame, in place: `R block Rᵀ`, 3 x 3 each."""
    for row in range(0, 6, 3):
        for column in range(0, 6, 3):
            block = C[row : row + 3, column : column + 3]
            store33(matmul(matmul(R, matrix(block)), transpose(R)), block)


@inner
def _add_joints(J: Any, lever: Vec3, normal: Vec3, C: Any) -> None:
    """Adds to a contact's covariance what independent errors of the joints make of it.

    `J` (6, j): how the tip moves and turns by each; overwritten by how point and normal change, the point by `lever`
    from where the tip's motion is given.
    """
    for j in range(J.shape[1]):
        turn = J[3, j], J[4, j], J[5, j]
        store(add((J[0, j], J[1, j], J[2, j]), cross(turn, lever)), J[:3, j])
        store(cross(turn, normal), J[3:, j])
    for i in range(6):
        for k in range(6):
            for j in range(J.shape[1]):
                C[i, k] += J[i, j] * J[k, j]


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
def _to_palm(finger: Any, T_palm_surface: Any, T_palm_tip: Any, J: Any, contacts: Any) -> None:
    """A contact sensed in its tip's frame, into the palm, with what tip and joints add to its covariance."""
    R, C = matrix(T_palm_surface), contacts.covariance
    point = add(mul(R, vector(contacts.point)), vector(T_palm_surface[:3, 3]))
    normal = mul(R, vector(contacts.normal))
    store(point, contacts.point)
    store(normal, contacts.normal)
    _rotate(R, C)
    _add_joints(J, sub(point, vector(T_palm_tip[:3, 3])), normal, C)
    two = chance_of_touch(contacts.gap)  # the sensor then feels the sum of two contacts
    for i in range(3):
        C[i, i] += finger.variance_point + two * TWO_AT_ONCE[0]
        C[3 + i, 3 + i] += finger.variance_normal + two * TWO_AT_ONCE[1]
    _keep_tangent(C, normal)


@entry
def contacts_to_palm(
    fingers: Any, readings: Any, Ts_palm_tip: Any, by_error: Any, gravity_palm: Any, contacts: Any
) -> None:
    """What n `fingers` FINGER feel, by raw `readings` (n, 6), NaN where a sensor is silent.

    `by_error` (n, 6, j): how the tips, at the origins of `Ts_palm_tip` (n, 4, 4), move and turn by one standard
    deviation of each of j independent errors; of a finger with a contact it becomes how that one's point and normal
    change. `gravity_palm` (3): zeros where it is not known, and the tips' weight stays in. Written: `contacts` (n)
    PALM_CONTACT.
    """
    Ts_palm_surface = np.empty((len(fingers), 3, 4))
    for i in range(len(fingers)):
        R, finger = matrix(Ts_palm_tip[i]), fingers[i]
        store33(matmul(R, matrix(finger.R_tip_surface)), Ts_palm_surface[i])
        center = add(mul(R, vector(finger.center_tip)), vector(Ts_palm_tip[i, :3, 3]))
        store(center, Ts_palm_surface[i, :, 3])
    n, nearest, loads = len(fingers), np.zeros((len(fingers), 4)), np.zeros((len(fingers), 6))
    set_gaps(fingers, Ts_palm_surface, nearest, contacts)
    gravity = vector(gravity_palm)
    for i in range(n):
        R_palm_sensor = matmul(matrix(Ts_palm_surface[i]), matrix(fingers[i].tip.R_surface_sensor))
        force, torque = _load(readings[i], fingers[i], tmul(R_palm_sensor, gravity))
        store(force, loads[i, :3])
        store(torque, loads[i, 3:])
    for i in range(n):
        finger, contact, load = fingers[i], contacts[i], (vector(loads[i, :3]), vector(loads[i, 3:]))
        tip = fingertip(finger.tip)
        sigmas = vector(finger.sigmas[:3]), vector(finger.sigmas[3:])
        answer = uncertain_contact(load, tip, sigmas, contact.covariance)
        contact.reason = int(answer[0])
        if answer[0] == CONTACT:
            store(answer[1], contact.point)
            store(answer[2], contact.normal)
            tangential = sub(answer[3], scale(answer[2], answer[4]))
            store(mul(matrix(Ts_palm_surface[i]), tangential), contact.load[:3])
            contact.load[3], contact.load[4] = answer[4], answer[5]
            other = norm(vector(loads[int(nearest[i, 0]), :3]))
            # Comparing is false where the other sensor is silent: then its own load must do.
            lighter = other if other < norm(load[0]) else norm(load[0])
            add_press(load, tip, Ts_palm_surface[i], vector(nearest[i, 1:]), lighter, contact)
            _to_palm(finger, Ts_palm_surface[i], Ts_palm_tip[i], by_error[i], contact)


def warm() -> None:
    """Compiles the kernel, or loads it."""
    fingers, poses = np.ones(1, FINGER), np.eye(4)[None]
    contacts_to_palm(
        fingers, np.zeros((1, 6)), poses, np.zeros((1, 6, 1)), np.zeros(3), np.empty(1, PALM_CONTACT)
    )
