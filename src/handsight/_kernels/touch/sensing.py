"""Contact sensing: from wrenches on a fingertip to contacts (eq. 7), one at a time or many.

Many wrenches are computed in blocks of `LANES`, column by column of a flat workspace, without a branch, so that the
compiler vectorises it. Each step is a loop of its own, because the processor overlaps several rounds of a short loop;
one loop of all steps takes 1.4 times as long.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.math.vec3 import Vec3
from handsight._kernels.runtime.compilation import entry
from handsight._kernels.touch.sensing_steps import (
    CONTACT,
    OFF_CAP,
    Fingertip,
    Vec6,
    contact_loads,
    covariance_factor,
    lane,
    point_on_sphere,
    solve_push,
    store,
    sum_of_products,
    times,
    unpack_fingertip,
    vector,
    wrench_on_surface,
    wrench_to_contact,
)

LANES = 32  # wrenches of a block


class Columns(NamedTuple):
    """`Columns` are the first columns of each quantity in the workspace; a column has `LANES` numbers."""

    reason: int = 0
    q: int = 1
    normal: int = 4
    force: int = 7
    moment: int = 10
    c: int = 13
    kappa: int = 14
    reading: int = 15
    total: int = 21


AT = Columns()


@lane
def _get3(w: Any, column: int, j: int) -> Vec3:
    return w[column * LANES + j], w[(column + 1) * LANES + j], w[(column + 2) * LANES + j]


@lane
def _set3(w: Any, column: int, j: int, value: Vec3) -> None:
    for i in range(3):
        w[(column + i) * LANES + j] = value[i]


@lane
def _read(w: Any, forces: Any, torques: Any, start: int, count: int) -> None:
    """Copies `count` readings, from number `start` on, from flat arrays to the columns `reading`."""
    for j in range(count):
        i = 3 * (start + j)
        _set3(w, AT.reading, j, (forces[i], forces[i + 1], forces[i + 2]))
        _set3(w, AT.reading + 3, j, (torques[i], torques[i + 1], torques[i + 2]))


@lane
def _solve(w: Any, tip: Fingertip) -> None:
    """Fills the other columns from `reading`: at the end `q` has points, `c` normal forces, `kappa` local torques."""
    for j in range(LANES):
        reason, force, moment = wrench_on_surface(_get3(w, AT.reading, j), _get3(w, AT.reading + 3, j), tip)
        w[AT.reason * LANES + j] = reason
        _set3(w, AT.force, j, force)
        _set3(w, AT.moment, j, moment)
    for j in range(LANES):
        c, kappa, pushes = solve_push(_get3(w, AT.force, j), _get3(w, AT.moment, j), tip)
        w[AT.c * LANES + j], w[AT.kappa * LANES + j] = c, kappa
        reason = w[AT.reason * LANES + j]
        w[AT.reason * LANES + j] = reason if reason > CONTACT else (CONTACT if pushes else OFF_CAP)
    for j in range(LANES):
        c, kappa = w[AT.c * LANES + j], w[AT.kappa * LANES + j]
        _set3(w, AT.q, j, point_on_sphere(_get3(w, AT.force, j), _get3(w, AT.moment, j), c, kappa, tip))
    for j in range(LANES):
        q, c, kappa = _get3(w, AT.q, j), w[AT.c * LANES + j], w[AT.kappa * LANES + j]
        normal, push, twist, contact_reason = contact_loads(q, _get3(w, AT.force, j), c, kappa, tip)
        reason = w[AT.reason * LANES + j]
        w[AT.reason * LANES + j] = reason if reason > CONTACT else contact_reason
        w[AT.c * LANES + j], w[AT.kappa * LANES + j] = push, twist
        _set3(w, AT.q, j, times(q, tip.semi_axes))
        _set3(w, AT.normal, j, normal)


@entry
def sense(forces: Any, torques: Any, tip: Any, reasons: Any, rows: Any, contacts: Any) -> int:
    """Returns k, the number of contacts among n wrenches, and writes the contacts in the order of their wrenches.

    `forces` [N] and `torques` [N m] (n, 3); `tip` (1,) FINGERTIP. Written are the `reasons` (n) int8 of all wrenches,
    and in the first k entries of `rows` (n) int64 and `contacts` (n) TIP_CONTACT each contact's wrench and the contact.
    """
    fingertip, w = unpack_fingertip(tip[0]), np.zeros(AT.total * LANES)
    forces, torques = forces.reshape(-1), torques.reshape(-1)
    n, k = len(reasons), 0
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        if count == LANES:
            _read(w, forces, torques, start, LANES)
        else:
            _read(w, forces, torques, start, count)
        _solve(w, fingertip)
        for j in range(count):
            # Written always, and kept only for a contact: a branch could not be predicted.
            reasons[start + j] = np.int8(w[AT.reason * LANES + j])
            rows[k] = start + j
            contact = contacts[k]
            store(_get3(w, AT.q, j), contact.point)
            store(_get3(w, AT.normal, j), contact.normal)
            store(_get3(w, AT.force, j), contact.force)
            contact.force_normal, contact.torque = w[AT.c * LANES + j], w[AT.kappa * LANES + j]
            k += 1 if w[AT.reason * LANES + j] == CONTACT else 0
    return k


@lane
def _pair(six: Any) -> Vec6:
    return (six[0], six[1], six[2]), (six[3], six[4], six[5])


@entry
def covariances(contacts: Any, tip: Any, sigmas: Any, out: Any) -> None:
    """Writes the covariances `out` (k, 6, 6) of point [m] and normal of contacts (k,) TIP_CONTACT. `tip` (1,)
    FINGERTIP; `sigmas` (6): standard deviations of a reading [N, N m]."""
    # Columns of a block: two factors of six, then point, normal force and local torque.
    fingertip, noise, out = unpack_fingertip(tip[0]), _pair(sigmas), out.reshape(-1)
    n, w = len(contacts), np.ones(17 * LANES)
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        for j in range(count):
            contact = contacts[start + j]
            _set3(w, 12, j, vector(contact.point))
            w[15 * LANES + j], w[16 * LANES + j] = contact.force_normal, contact.torque
        for j in range(LANES):
            push, twist = w[15 * LANES + j], w[16 * LANES + j]
            first, second = covariance_factor(_get3(w, 12, j), push, twist, fingertip, noise)
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
    """Returns what `wrench_to_contact` returns; for a contact the `covariance` (6, 6) is written."""
    answer = wrench_to_contact(load[0], load[1], tip)
    if answer[0] == CONTACT:
        first, second = covariance_factor(answer[1], answer[4], answer[5], tip, sigmas)
        for i in range(6):
            for j in range(6):
                covariance[i, j] = sum_of_products(first[i], first[j], second[i], second[j])
    return answer


@entry
def sense_one(load: Any, tip: Any, sigmas: Any, vectors: Any, covariance: Any) -> Any:
    """Returns reason, normal force [N] and local torque [N m] of one wrench, `load`: force and torque (6). For a
    contact, `vectors` (3, 3), its point, normal and force, and the `covariance` (6, 6) are written."""
    answer = uncertain_contact(_pair(load), unpack_fingertip(tip[0]), _pair(sigmas), covariance)
    reason, point, normal, force, force_normal, twist = answer
    store(point, vectors[0])
    store(normal, vectors[1])
    store(force, vectors[2])
    return int(reason), force_normal, twist
