"""Contact sensing: from wrenches on a fingertip to contacts (eq. 7).

Many wrenches are computed in blocks, column by column of a flat workspace, without a branch: the compiler does four at
a time. Each step is a loop of its own, because the processor overlaps several rounds of a short loop; one loop of all
steps takes 1.4 times as long.
"""

from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.math.vec3 import Vec3
from handsight._kernels.runtime.compilation import entry
from handsight._kernels.touch.sensing_records import FINGERTIP, TIP_CONTACT
from handsight._kernels.touch.sensing_steps import (
    CONTACT,
    OFF_CAP,
    Fingertip,
    Vec6,
    contact_loads,
    covariance_factor,
    lane,
    point_on_sphere,
    rescaled,
    solve_push,
    store,
    sum_of_products,
    times,
    unpack_fingertip,
    vector,
    wrench_on_surface,
    wrench_to_contact,
)

LANES = 32


class Columns(NamedTuple):
    """`Columns` are the places of wrenches' numbers in the workspace, `LANES` numbers each."""

    reason: int = 0
    size: int = 1
    q: int = 2
    normal: int = 5
    force: int = 8
    moment: int = 11
    c: int = 14
    kappa: int = 15
    reading: int = 16
    total: int = 22


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
    """Copies `count` readings from number `start` on, of flat arrays, to the columns `reading`."""
    for j in range(count):
        i = 3 * (start + j)
        _set3(w, AT.reading, j, (forces[i], forces[i + 1], forces[i + 2]))
        _set3(w, AT.reading + 3, j, (torques[i], torques[i + 1], torques[i + 2]))


@lane
def _solve(w: Any, tip: Fingertip) -> None:
    """Computes the other columns from `reading`: `q` becomes points, `c` normal forces, `kappa` local torques."""
    for j in range(LANES):
        reason, size, force, moment = wrench_on_surface(
            _get3(w, AT.reading, j), _get3(w, AT.reading + 3, j), tip
        )
        w[AT.reason * LANES + j], w[AT.size * LANES + j] = reason, size
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
        q, force, size = _get3(w, AT.q, j), _get3(w, AT.force, j), w[AT.size * LANES + j]
        c, kappa = w[AT.c * LANES + j], w[AT.kappa * LANES + j]
        normal, push, twist, contact_reason = contact_loads(q, force, c, kappa, tip)
        reason = w[AT.reason * LANES + j]
        w[AT.reason * LANES + j] = reason if reason > CONTACT else contact_reason
        w[AT.c * LANES + j], w[AT.kappa * LANES + j] = rescaled(push, size), rescaled(twist, size)
        _set3(w, AT.q, j, times(q, tip.semi_axes))
        _set3(w, AT.normal, j, normal)
        _set3(w, AT.force, j, (rescaled(force[0], size), rescaled(force[1], size), rescaled(force[2], size)))


@lane
def _write(w: Any, j: int, contact: Any) -> None:
    for i in range(3):
        contact.point[i] = w[(AT.q + i) * LANES + j]
        contact.normal[i] = w[(AT.normal + i) * LANES + j]
        contact.force[i] = w[(AT.force + i) * LANES + j]
    contact.force_normal, contact.torque = w[AT.c * LANES + j], w[AT.kappa * LANES + j]


@entry
def sense(forces: Any, torques: Any, tip: Any, reasons: Any, rows: Any, contacts: Any) -> int:
    """Returns the number of contacts among n wrenches, and writes them in the order of the wrenches.

    `forces`, `torques` (n, 3); `tip` (1,) FINGERTIP. Written: `reasons` (n) int8 of all wrenches; and from the arrays'
    start on, for each contact, its wrench in `rows` (n) int64 and itself in `contacts` (n) TIP_CONTACT.
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
            _write(w, j, contacts[k])
            k += 1 if w[AT.reason * LANES + j] == CONTACT else 0
    return k


@lane
def _pair(six: Any) -> Vec6:
    return (six[0], six[1], six[2]), (six[3], six[4], six[5])


@entry
def covariances(contacts: Any, tip: Any, sigmas: Any, out: Any) -> None:
    """Writes the covariances `out` (k, 6, 6) of point and normal of contacts (k,) TIP_CONTACT.

    `tip` (1,) FINGERTIP; `sigmas` (6) of a reading.
    """
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
    """Returns what `wrench_to_contact` does; for a contact the `covariance` (6, 6) is written."""
    answer = wrench_to_contact(load[0], load[1], tip)
    if answer[0] == CONTACT:
        first, second = covariance_factor(answer[1], answer[4], answer[5], tip, sigmas)
        for i in range(6):
            for j in range(6):
                covariance[i, j] = sum_of_products(first[i], first[j], second[i], second[j])
    return answer


@entry
def sense_one(load: Any, tip: Any, sigmas: Any, vectors: Any, covariance: Any) -> Any:
    """Returns reason, normal force and local torque of one wrench, `load`: six numbers of force and torque.

    For a contact, `vectors` (3, 3) of point, normal and force, and the `covariance` (6, 6) are written.
    """
    answer = uncertain_contact(_pair(load), unpack_fingertip(tip[0]), _pair(sigmas), covariance)
    reason, point, normal, force, force_normal, twist = answer
    store(point, vectors[0])
    store(normal, vectors[1])
    store(force, vectors[2])
    return int(reason), force_normal, twist


def warm() -> None:
    """Compiles every kernel, or loads its machine code."""
    tip, none, sigmas = np.ones(1, FINGERTIP), np.empty((0, 3)), np.ones(6)
    contacts = np.empty(0, TIP_CONTACT)
    sense(none, none, tip, np.empty(0, np.int8), np.empty(0, np.int64), contacts)
    covariances(contacts, tip, sigmas, np.empty((0, 6, 6)))
    sense_one((0.0,) * 6, tip, sigmas, np.empty((3, 3)), np.empty((6, 6)))
