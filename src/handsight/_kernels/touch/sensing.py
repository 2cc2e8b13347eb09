"""Contact sensing: wrenches on a fingertip to contacts (eq. 7).

Many wrenches go through in blocks, column by column of a flat workspace, without a branch: the compiler does four at
a time. The steps are loops of their own because a short loop has several rounds under way at once; one loop of all
steps takes 1.4 times as long.
"""

from typing import Any

import numpy as np

from handsight._kernels.math.vec3 import Vec3
from handsight._kernels.runtime.compilation import entry
from handsight._kernels.touch.sensing_records import FINGERTIP, TIP_CONTACT
from handsight._kernels.touch.sensing_steps import (
    CONTACT,
    OFF_CAP,
    Fingertip,
    Vec6,
    fingertip,
    judged,
    lane,
    on_sphere,
    prepared,
    rescaled,
    root,
    spread,
    store,
    sum_of_products,
    times,
    vector,
    wrench_to_contact,
)

LANES = 32
# Columns of the workspace, LANES numbers each.
REASON, SIZE, Q, NORMAL, FORCE, MOMENT, C, KAPPA, READING = 0, 1, 2, 5, 8, 11, 14, 15, 16
COLUMNS = 22


@lane
def _three(w: Any, column: int, j: int) -> Vec3:
    return w[column * LANES + j], w[(column + 1) * LANES + j], w[(column + 2) * LANES + j]


@lane
def _put(w: Any, column: int, j: int, value: Vec3) -> None:
    for i in range(3):
        w[(column + i) * LANES + j] = value[i]


@lane
def _read(w: Any, forces: Any, torques: Any, start: int, count: int) -> None:
    """`count` readings from number `start` on; the arrays are flat."""
    for j in range(count):
        i = 3 * (start + j)
        _put(w, READING, j, (forces[i], forces[i + 1], forces[i + 2]))
        _put(w, READING + 3, j, (torques[i], torques[i + 1], torques[i + 2]))


@lane
def _solve(w: Any, tip: Fingertip) -> None:
    """From the columns READING to the others; forces, c and κ over the size."""
    for j in range(LANES):
        reason, size, force, moment = prepared(_three(w, READING, j), _three(w, READING + 3, j), tip)
        w[REASON * LANES + j], w[SIZE * LANES + j] = reason, size
        _put(w, FORCE, j, force)
        _put(w, MOMENT, j, moment)
    for j in range(LANES):
        c, kappa, pushes = root(_three(w, FORCE, j), _three(w, MOMENT, j), tip)
        w[C * LANES + j], w[KAPPA * LANES + j] = c, kappa
        reason = w[REASON * LANES + j]
        w[REASON * LANES + j] = reason if reason > CONTACT else (CONTACT if pushes else OFF_CAP)
    for j in range(LANES):
        c, kappa = w[C * LANES + j], w[KAPPA * LANES + j]
        _put(w, Q, j, on_sphere(_three(w, FORCE, j), _three(w, MOMENT, j), c, kappa, tip))


@lane
def _finish(w: Any, tip: Fingertip) -> None:
    """The answers in the columns: points for q, normal forces and local torques for c and κ, and the size undone."""
    for j in range(LANES):
        q, force, size = _three(w, Q, j), _three(w, FORCE, j), w[SIZE * LANES + j]
        normal, push, twist, against = judged(q, force, w[C * LANES + j], w[KAPPA * LANES + j], tip)
        reason = w[REASON * LANES + j]
        w[REASON * LANES + j] = reason if reason > CONTACT else against
        w[C * LANES + j], w[KAPPA * LANES + j] = rescaled(push, size), rescaled(twist, size)
        _put(w, Q, j, times(q, tip.semi_axes))
        _put(w, NORMAL, j, normal)
        _put(w, FORCE, j, (rescaled(force[0], size), rescaled(force[1], size), rescaled(force[2], size)))


@lane
def _write(w: Any, j: int, contact: Any) -> None:
    for i in range(3):
        contact.point[i] = w[(Q + i) * LANES + j]
        contact.normal[i] = w[(NORMAL + i) * LANES + j]
        contact.force[i] = w[(FORCE + i) * LANES + j]
    contact.force_normal, contact.torque = w[C * LANES + j], w[KAPPA * LANES + j]


@entry
def sense(forces: Any, torques: Any, tip: Any, reasons: Any, rows: Any, contacts: Any) -> int:
    """How many contacts n wrenches hold; these, in the order of the wrenches, from the arrays' start.

    `forces`, `torques` (n, 3); `tip` (1,) FINGERTIP. Written: `reasons` (n) int8, all of them; of the contacts `rows`
    (n) int64, whose wrench each is, and `contacts` (n) TIP_CONTACT.
    """
    numbers, w = fingertip(tip[0]), np.zeros(COLUMNS * LANES)
    forces, torques = forces.reshape(-1), torques.reshape(-1)
    n, k = len(reasons), 0
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        if count == LANES:
            _read(w, forces, torques, start, LANES)
        else:
            _read(w, forces, torques, start, count)
        _solve(w, numbers)
        _finish(w, numbers)
        for j in range(count):
            # Written in any case and passed by only where it is a contact: the branch could not be foreseen.
            reasons[start + j] = np.int8(w[REASON * LANES + j])
            rows[k] = start + j
            _write(w, j, contacts[k])
            k += 1 if w[REASON * LANES + j] == CONTACT else 0
    return k


@lane
def _pair(six: Any) -> Vec6:
    return (six[0], six[1], six[2]), (six[3], six[4], six[5])


@entry
def covariances(contacts: Any, tip: Any, sigmas: Any, out: Any) -> None:
    """`out` (k, 6, 6): of the point and normal of k contacts TIP_CONTACT; `tip` (1,) FINGERTIP, `sigmas` (6)."""
    numbers, noise, out = fingertip(tip[0]), _pair(sigmas), out.reshape(-1)
    n, w = len(contacts), np.ones(17 * LANES)
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        for j in range(count):
            contact = contacts[start + j]
            _put(w, 12, j, vector(contact.point))
            w[15 * LANES + j], w[16 * LANES + j] = contact.force_normal, contact.torque
        for j in range(LANES):
            first, second = spread(_three(w, 12, j), w[15 * LANES + j], w[16 * LANES + j], numbers, noise)
            for i in range(6):
                w[i * LANES + j], w[(6 + i) * LANES + j] = first[i], second[i]
        for j in range(count):
            for row in range(6):
                a, b = w[row * LANES + j], w[(6 + row) * LANES + j]
                for i in range(6):
                    c, d = w[i * LANES + j], w[(6 + i) * LANES + j]
                    out[36 * (start + j) + 6 * row + i] = sum_of_products(a, c, b, d)


@lane
def uncertain_contact(load: Vec6, tip: Fingertip, sigmas: Vec6, covariance: Any) -> Any:
    """As `wrench_to_contact`, of one wrench; its covariance is written where it is a contact."""
    answer = wrench_to_contact(load[0], load[1], tip)
    if answer[0] == CONTACT:
        first, second = spread(answer[1], answer[4], answer[5], tip, sigmas)
        for i in range(6):
            for j in range(6):
                covariance[i, j] = sum_of_products(first[i], first[j], second[i], second[j])
    return answer


@entry
def sense_one(load: Any, tip: Any, sigmas: Any, vectors: Any, covariance: Any) -> Any:
    """Reason, normal force and local torque of one wrench.

    `load`: its force and torque, six numbers. Written where it is a contact: `vectors` (3, 3), point, normal and force,
    and its `covariance`.
    """
    answer = uncertain_contact(_pair(load), fingertip(tip[0]), _pair(sigmas), covariance)
    reason, point, normal, force, force_normal, twist = answer
    store(point, vectors[0])
    store(normal, vectors[1])
    store(force, vectors[2])
    return int(reason), force_normal, twist


def warm() -> None:
    """Compiles every kernel, or loads it."""
    tip, none, sigmas = np.ones(1, FINGERTIP), np.empty((0, 3)), np.ones(6)
    contacts = np.empty(0, TIP_CONTACT)
    sense(none, none, tip, np.empty(0, np.int8), np.empty(0, np.int64), contacts)
    covariances(contacts, tip, sigmas, np.empty((0, 6, 6)))
    sense_one((0.0,) * 6, tip, sigmas, np.empty((3, 3)), np.empty((6, 6)))
