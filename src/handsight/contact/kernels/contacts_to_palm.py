"""From the raw wrenches of a hand's fingertips to contacts in the palm, with their covariances.

Fingertips may touch each other: the less their distance, the more it adds to a contact's covariance.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.symmetry import transform_of
from handsight._compiled.vec3 import (
    Mat33,
    Vec3,
    add,
    apply,
    block,
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
from handsight.contact.kernels.sensing import (
    CONTACT,
    Vec6,
    uncertain_contact,
    unpack_fingertip,
)


class TipToTip(NamedTuple):
    """`TipToTip` are the parameters of contacts between two fingertips."""

    max_gap: float = 0.003
    """Below this distance a tip touches another with a probability above 5 % [m]. One degree of each joint is 1.3 mm
    per axis at each of two tips."""
    far: float = 0.02
    """Beyond this distance tips do not touch, with a probability below 1e-26, and it is not computed further [m]."""
    gap_scale: float = 1.645 / (math.sqrt(2.0) * max_gap)
    """Factor of a gap in the argument of `erfc` [1/m], by which `max_gap` is 1.645 of its standard deviations."""
    variance_point: float = 0.002**2
    """Added variance of a contact's point where two contacts are taken for one [m²]."""
    variance_normal: float = math.radians(12.0) ** 2  # the same of its normal [rad²]
    iterations: int = 12
    """Steps to the direction that separates two tips best; the gap is then too small by 0.1-1 mm."""


TIP_TO_TIP = TipToTip()


@inner
def _support(R: Mat33, axes: Vec3, u: Vec3) -> Vec3:
    """Returns the point of an ellipsoid that is farthest along u, from the ellipsoid's centre."""
    local = times(axes, tmul(R, u))
    return mul(R, scale(times(axes, local), 1.0 / norm(local)))


@inner
def _gap(T: Any, axes: Vec3, T_other: Any, axes_other: Vec3) -> float:
    """Returns the distance of two ellipsoids, below zero where they overlap; of those that are `far` a lower bound.

    The distance of convex bodies is the width of the widest slab between them. Each step turns the slab's normal
    halfway towards the line between the two points that touch the slab.
    """
    R, R_other = matrix(T), matrix(T_other)
    between = sub(vector(T_other[:3, 3]), vector(T[:3, 3]))
    u = scale(between, 1.0 / max(norm(between), 1e-12))
    widest = -np.inf
    for _ in range(TIP_TO_TIP.iterations):
        v = sub(add(between, _support(R_other, axes_other, scale(u, -1.0))), _support(R, axes, u))
        widest = max(widest, dot(u, v))
        length = norm(v)
        if not 0.0 < widest < TIP_TO_TIP.far or length < 1e-12:
            break
        u = add(u, scale(v, 1.0 / length))
        u = scale(u, 1.0 / max(norm(u), 1e-12))
    return widest


@inner
def find_gaps(fingers: Any, Ts_palm_surface: Any, contacts: Any) -> None:
    """Writes to each contact its tip's gap to the nearest other tip."""
    for i in range(len(contacts)):
        contacts[i].gap = np.inf
        for j in range(i):
            axes = vector(fingers[i].tip.semi_axes)
            axes_other = vector(fingers[j].tip.semi_axes)
            gap = _gap(Ts_palm_surface[i], axes, Ts_palm_surface[j], axes_other)
            contacts[i].gap = min(gap, contacts[i].gap)
            contacts[j].gap = min(gap, contacts[j].gap)


@inner
def touch_probability(gap: float) -> float:
    """Returns the probability that two tips touch, given their gap by the measured joint positions [m]."""
    return 0.5 * math.erfc(TIP_TO_TIP.gap_scale * gap)


@inner
def _to_palm(finger: Any, T_palm_surface: Any, T_palm_tip: Any, J: Any, contact: Any) -> None:
    """Transforms a contact from its tip's frame to the palm, adding the errors of tip and joints to its covariance.

    `J` (6, j) has the motion of the tip's origin by one standard deviation of each joint's error, and is overwritten by
    the motion of the contact's point and normal.
    """
    (R, p), C = transform_of(T_palm_surface), contact.covariance
    point = apply((R, p), vector(contact.point))
    n = mul(R, vector(contact.normal))
    store(point, contact.point)
    store(n, contact.normal)
    for i in range(0, 6, 3):
        for j in range(0, 6, 3):
            part = C[i : i + 3, j : j + 3]
            store33(matmul(matmul(R, matrix(part)), transpose(R)), part)
    lever = sub(point, vector(T_palm_tip[:3, 3]))
    for j in range(J.shape[1]):
        turn = J[3, j], J[4, j], J[5, j]
        store(add((J[0, j], J[1, j], J[2, j]), cross(turn, lever)), J[:3, j])
        store(cross(turn, n), J[3:, j])
    for i in range(6):
        for k in range(6):
            for j in range(J.shape[1]):
                C[i, k] += J[i, j] * J[k, j]
    two = touch_probability(contact.gap)  # of the sensor measuring the sum of two contacts
    for i in range(3):
        C[i, i] += finger.variance_point + two * TIP_TO_TIP.variance_point
        C[3 + i, 3 + i] += finger.variance_normal + two * TIP_TO_TIP.variance_normal
    for i in range(6):  # a unit normal cannot change along itself
        row = C[i, 3:]
        store(sub(vector(row), scale(n, dot(vector(row), n))), row)
    for j in range(6):
        column = C[3:, j]
        store(sub(vector(column), scale(n, dot(vector(column), n))), column)


@inner
def _sigmas(finger: Any, load: Vec6) -> Vec6:
    """Returns the sigmas of a reading: its noise, and the error of each axis' gain in proportion to the load."""
    s = finger.sigmas
    f = scale(load[0], finger.sigma_gain)
    t = scale(load[1], finger.sigma_gain)
    return (
        (np.hypot(s[0], f[0]), np.hypot(s[1], f[1]), np.hypot(s[2], f[2])),
        (np.hypot(s[3], t[0]), np.hypot(s[4], t[1]), np.hypot(s[5], t[2])),
    )


@entry
def contacts_to_palm(
    fingers: Any, readings: Any, Ts_palm_tip: Any, by_error: Any, gravity_palm: Any, contacts: Any
) -> None:
    """Writes the `contacts` (n) PALM_CONTACT of n `fingers` FINGER with raw `readings` (n, 6), NaN without a reading.

    `by_error` (n, 6, j): motion of the tips, at the origins of `Ts_palm_tip` (n, 4, 4), by one standard deviation of
    each of j independent errors; for a finger with a contact it is overwritten by the motion of the contact's point and
    normal. `gravity_palm` (3) [m/s²]: zeros where it is unknown; then the tips' weight stays in the readings.
    """
    Ts_palm_surface = np.empty((len(fingers), 3, 4))
    for i in range(len(fingers)):
        T_palm_tip = transform_of(Ts_palm_tip[i])
        finger = fingers[i]
        store33(matmul(T_palm_tip[0], matrix(finger.R_tip_surface)), Ts_palm_surface[i])
        store(apply(T_palm_tip, vector(finger.center_tip)), Ts_palm_surface[i, :, 3])
    n = len(fingers)
    loads = np.zeros((len(fingers), 6))
    find_gaps(fingers, Ts_palm_surface, contacts)
    gravity = vector(gravity_palm)
    for i in range(n):
        finger = fingers[i]
        R_palm_sensor = matmul(matrix(Ts_palm_surface[i]), matrix(finger.tip.R_surface_sensor))
        weight = scale(tmul(R_palm_sensor, gravity), finger.mass)
        force = scale(sub(vector(readings[i, :3]), vector(finger.bias[:3])), finger.sign)
        torque = scale(sub(vector(readings[i, 3:]), vector(finger.bias[3:])), finger.sign)
        store(sub(force, weight), loads[i, :3])
        store(sub(torque, cross(vector(finger.center_of_mass), weight)), loads[i, 3:])
    for i in range(n):
        finger = fingers[i]
        contact = contacts[i]
        load = (vector(loads[i, :3]), vector(loads[i, 3:]))
        tip = unpack_fingertip(finger.tip)
        answer = uncertain_contact(load, tip, _sigmas(finger, load), contact.covariance)
        contact.reason = int(answer[0])
        if answer[0] == CONTACT:
            store(answer[1], contact.point)
            store(answer[2], contact.normal)
            tangential = sub(answer[3], scale(answer[2], answer[4]))
            store(mul(matrix(Ts_palm_surface[i]), tangential), contact.load[:3])
            contact.load[3], contact.load[4] = answer[4], answer[5]
            _to_palm(finger, Ts_palm_surface[i], Ts_palm_tip[i], by_error[i], contact)


@entry
def put_patches(
    numbers: Any, patches: Any, fingers: Any, Ts_palm_tip: Any, by_error: Any, contacts: Any
) -> None:
    """Writes `patches` (k) PATCH of taxels to the `contacts` (n) PALM_CONTACT of the tips `numbers` (k). `by_error` (n,
    6, j): as in `contacts_to_palm`. A contact that the tip's wrench gave keeps its load."""
    for k in range(len(numbers)):
        patch = patches[k]
        contact = contacts[numbers[k]]
        i = numbers[k]
        contact.point[:], contact.normal[:] = patch.point, patch.normal
        contact.covariance[:] = patch.covariance
        _to_palm(fingers[i], Ts_palm_tip[i], Ts_palm_tip[i], by_error[i], contact)
        if contact.reason != CONTACT:
            force = mul(matrix(Ts_palm_tip[i]), vector(patch.force))
            n = vector(contact.normal)
            store(sub(force, scale(n, dot(force, n))), contact.load[:3])
            contact.load[3] = dot(force, n)
            contact.load[4] = patch.torque
            contact.reason = CONTACT


@entry
def mark_on_table(T_world_palm: Any, table: Any, reason: int, contacts: Any) -> None:
    """Writes `reason` to those of the contacts (n) PALM_CONTACT that are on the table and not on the object.

    These are within three standard deviations of the table's height, with a normal that is upright as closely; where an
    object stands, none of its surface faces up. `table` (3): height [m] and the standard deviations of height [m] and
    tilt [rad].
    """
    up = vector(T_world_palm[2, :3])
    for i in range(len(contacts)):
        contact = contacts[i]
        if contact.reason != 0:
            continue
        height = dot(vector(contact.point), up) + T_world_palm[2, 3] - table[0]
        angle = np.arccos(min(max(dot(vector(contact.normal), up), -1.0), 1.0))
        C = contact.covariance
        variance_height = dot(up, mul(block(C, 0, 0), up)) + table[1] ** 2
        variance_angle = (C[3, 3] + C[4, 4] + C[5, 5]) / 2 + table[2] ** 2
        if height**2 < 9.0 * variance_height and angle**2 < 9.0 * variance_angle:
            contact.reason = reason


@entry
def gather_contacts(
    contacts: Any, by_error: Any, points: Any, normals: Any, covariance: Any, loads: Any, moved: Any
) -> None:
    """Writes points (k, 3), normals, covariance (k, 6, 6), loads (k, 5) and `moved` (k, 6, j), the rows of `by_error`
    (n, 6, j), of the k among the contacts (n) PALM_CONTACT that are contacts. NumPy takes ten times as long."""
    k = 0
    for i in range(len(contacts)):
        contact = contacts[i]
        if contact.reason == 0:
            points[k], normals[k], covariance[k] = contact.point, contact.normal, contact.covariance
            loads[k] = contact.load
            moved[k] = by_error[i]
            k += 1


@entry
def have_moved(contacts: Any, before: Any, far: float, cosine: float) -> bool:
    """Returns whether a coordinate of any of the same tips' contacts PALM_CONTACT has changed by more than `far` [m],
    or any normal by more than the angle of that `cosine`."""
    for i in range(len(contacts)):
        now, then = contacts[i], before[i]
        for k in range(3 if now.reason == 0 else 0):
            if abs(now.point[k] - then.point[k]) > far:
                return True
        if now.reason == 0 and dot(vector(now.normal), vector(then.normal)) < cosine:
            return True
    return False
