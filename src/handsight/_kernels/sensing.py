"""Contact sensing: wrenches on a fingertip to contacts (eq. 7).

Twin: `handsight.contact._sensing_plain.sense`, where the method is explained.

Many wrenches go through in blocks, column by column of a flat workspace, without a branch: the compiler does four at
a time. The steps are loops of their own because a short loop has several rounds under way at once; one loop of all
steps takes 1.4 times as long.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import entry, inner
from handsight._kernels.sensing_steps import (
    AXES,
    CONTACT,
    OFF_CAP,
    TIP,
    foot,
    landed,
    lane,
    prepared,
    rescaled,
    root,
    spread,
    sum_of_products,
)

LANES = 32
# Columns of the workspace, LANES numbers each. Torques are about the centre times |W| / W.
REASON, SCALE, Q, NORMAL, FORCE, MOMENT, C, KAPPA, READING = 0, 1, 2, 5, 8, 11, 14, 15, 16
COLUMNS = 22


@lane
def _three(w: Any, column: int, j: int) -> Any:
    return w[column * LANES + j], w[(column + 1) * LANES + j], w[(column + 2) * LANES + j]


@lane
def _put(w: Any, column: int, j: int, value: Any) -> None:
    for i in range(3):
        w[(column + i) * LANES + j] = value[i]


@lane
def _solved(w: Any, tip: Any) -> None:
    """From the columns READING to the others; forces, c and κ over the scale."""
    for j in range(LANES):
        reason, scale, force, moment = prepared(_three(w, READING, j), _three(w, READING + 3, j), tip)
        w[REASON * LANES + j], w[SCALE * LANES + j] = reason, scale
        _put(w, FORCE, j, force)
        _put(w, MOMENT, j, moment)
    for j in range(LANES):
        c, kappa, pushes = root(_three(w, FORCE, j), _three(w, MOMENT, j), tip)
        w[C * LANES + j], w[KAPPA * LANES + j] = c, kappa
        reason = w[REASON * LANES + j]
        w[REASON * LANES + j] = reason if reason > CONTACT else (CONTACT if pushes else OFF_CAP)
    for j in range(LANES):
        c, kappa = w[C * LANES + j], w[KAPPA * LANES + j]
        _put(w, Q, j, foot(_three(w, FORCE, j), _three(w, MOMENT, j), c, kappa, tip))


@lane
def _landed(w: Any, tip: Any) -> None:
    """The answers in the columns: points for q, normal forces and local torques for c and κ, and the scale undone."""
    for j in range(LANES):
        q, force, scale = _three(w, Q, j), _three(w, FORCE, j), w[SCALE * LANES + j]
        normal, push, twist, against = landed(q, force, w[C * LANES + j], w[KAPPA * LANES + j], tip)
        reason = w[REASON * LANES + j]
        w[REASON * LANES + j] = reason if reason > CONTACT else against
        w[C * LANES + j], w[KAPPA * LANES + j] = rescaled(push, scale), rescaled(twist, scale)
        _put(w, Q, j, (q[0] * tip[AXES], q[1] * tip[AXES + 1], q[2] * tip[AXES + 2]))
        _put(w, NORMAL, j, normal)
        _put(w, FORCE, j, (rescaled(force[0], scale), rescaled(force[1], scale), rescaled(force[2], scale)))


@lane
def _read(w: Any, forces: Any, torques: Any, start: int, count: int) -> None:
    """`count` readings from number `start` on."""
    for j in range(count):
        i = 3 * (start + j)
        _put(w, READING, j, (forces[i], forces[i + 1], forces[i + 2]))
        _put(w, READING + 3, j, (torques[i], torques[i + 1], torques[i + 2]))


@lane
def _copied(w: Any, column: int, j: int, out: Any, k: int) -> None:
    for i in range(3):
        out[3 * k + i] = w[(column + i) * LANES + j]


@entry
def sense(
    forces: Any,
    torques: Any,
    tip: Any,
    reasons: Any,
    rows: Any,
    vectors: Any,
    sizes: Any,
) -> int:
    """How many contacts n wrenches hold; their answers, in the order of the wrenches, from the arrays' start.

    Every array is flat: `forces`, `torques` (3 n); `reasons` (n) int8, all of them; `rows` (n) int64; `vectors`, three
    of (3 n): points, normals, forces; `sizes`, two of (n): normal forces, local torques.
    """
    points, normals, pushes = vectors
    sizes_push, sizes_twist = sizes
    w = np.zeros(COLUMNS * LANES)
    n, k = len(reasons), 0
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        if count == LANES:
            _read(w, forces, torques, start, LANES)
        else:
            _read(w, forces, torques, start, count)
        _solved(w, tip)
        _landed(w, tip)
        for j in range(count):
            # Written in any case and passed by only where it is a contact: the branch could not be foreseen.
            reasons[start + j] = np.int8(w[REASON * LANES + j])
            rows[k] = start + j
            _copied(w, Q, j, points, k)
            _copied(w, NORMAL, j, normals, k)
            _copied(w, FORCE, j, pushes, k)
            sizes_push[k], sizes_twist[k] = w[C * LANES + j], w[KAPPA * LANES + j]
            k += 1 if w[REASON * LANES + j] == CONTACT else 0
    return k


@entry
def covariances(points: Any, pushes: Any, twists: Any, tip: Any, sigmas: Any, out: Any) -> None:
    """`out` (36 k): of the point and normal of k contacts; `points` (3 k), `pushes`, `twists` (k), `sigmas` (6)."""
    n, w = len(pushes), np.ones(17 * LANES)
    for start in range(0, n, LANES):
        count = min(LANES, n - start)
        for j in range(count):
            i = 3 * (start + j)
            _put(w, 12, j, (points[i], points[i + 1], points[i + 2]))
            w[15 * LANES + j], w[16 * LANES + j] = pushes[start + j], twists[start + j]
        for j in range(LANES):
            first, second = spread(_three(w, 12, j), w[15 * LANES + j], w[16 * LANES + j], tip, sigmas)
            for i in range(6):
                w[i * LANES + j], w[(6 + i) * LANES + j] = first[i], second[i]
        for j in range(count):
            for row in range(6):
                a, b = w[row * LANES + j], w[(6 + row) * LANES + j]
                for i in range(6):
                    c, d = w[i * LANES + j], w[(6 + i) * LANES + j]
                    out[36 * (start + j) + 6 * row + i] = sum_of_products(a, c, b, d)


@inner
def _sensed(reading: Any, tip: Any, sigmas: Any, vectors: Any, covariance: Any) -> Any:
    """Reason, normal force and local torque of one wrench, six numbers; the rest is written."""
    reason, scale, force, moment = prepared(reading[:3], reading[3:], tip)
    if reason != CONTACT:
        return int(reason), 0.0, 0.0
    c, kappa, pushes = root(force, moment, tip)
    if not pushes:
        return int(OFF_CAP), 0.0, 0.0
    q = foot(force, moment, c, kappa, tip)
    normal, push, twist, reason = landed(q, force, c, kappa, tip)
    if reason != CONTACT:
        return int(reason), 0.0, 0.0
    push, twist = rescaled(push, scale), rescaled(twist, scale)
    point = (q[0] * tip[AXES], q[1] * tip[AXES + 1], q[2] * tip[AXES + 2])
    first, second = spread(point, push, twist, tip, sigmas)
    for i in range(3):
        vectors[0, i], vectors[1, i], vectors[2, i] = point[i], normal[i], rescaled(force[i], scale)
    for i in range(6):
        for j in range(6):
            covariance[i, j] = sum_of_products(first[i], first[j], second[i], second[j])
    return int(CONTACT), push, twist


@entry
def sense_one(
    fx: float,
    fy: float,
    fz: float,
    mx: float,
    my: float,
    mz: float,
    tip: Any,
    sigmas: Any,
    vectors: Any,
    covariance: Any,
) -> Any:
    """Reason, normal force and local torque of one wrench; `vectors` (3, 3): point, normal, force; its covariance.

    Six numbers, because an array costs ten times what a number costs on the way in.
    """
    return _sensed((fx, fy, fz, mx, my, mz), tip, sigmas, vectors, covariance)


@entry
def sense_each(loads: Any, tips: Any, sigmas: Any, reasons: Any, vectors: Any, covariances: Any) -> None:
    """One wrench on each of n tips: `loads` (n, 6), `tips` (n, TIP), `sigmas` (n, 6).

    Written: `reasons` (n) int8, and where that is CONTACT, `vectors` (n, 3, 3) and `covariances` (n, 6, 6).
    """
    for i in range(len(reasons)):
        w = loads[i]
        reading = (w[0], w[1], w[2], w[3], w[4], w[5])
        reason, _, _ = _sensed(reading, tips[i], sigmas[i], vectors[i], covariances[i])
        reasons[i] = np.int8(reason)


def warm() -> None:
    """Compiles every kernel, or loads it."""
    tip, none, sigmas = np.ones(TIP), np.empty(0), np.ones(6)
    sense(none, none, tip, np.empty(0, np.int8), np.empty(0, np.int64), (none,) * 3, (none,) * 2)
    covariances(none, none, none, tip, sigmas, none)
    sense_one(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, tip, sigmas, np.empty((3, 3)), np.empty((6, 6)))
    sense_each(
        np.zeros((1, 6)),
        tip[None],
        sigmas[None],
        np.empty(1, np.int8),
        np.empty((1, 3, 3)),
        np.empty((1, 6, 6)),
    )
