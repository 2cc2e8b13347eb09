"""Equivalent poses of a symmetric object. Twins: `handsight.objects.symmetry.nearest`, `correction.modes.apart`."""

from typing import Any

import numpy as np

from handsight._kernels.compiled import inner
from handsight._kernels.layout import AXES, AXIS, CENTER, NONE, RADIUS, ROTATION_COUNT, ROTATIONS, SYMMETRY
from handsight._kernels.sight import rotation_log


@inner
def _times(a: Any, b: Any, at: int, out: Any) -> None:
    """The transform `a` after the one that begins at `b[at]`."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = (
                a[3 * i] * b[at + j] + a[3 * i + 1] * b[at + 3 + j] + a[3 * i + 2] * b[at + 6 + j]
            )
        out[9 + i] = a[9 + i] + a[3 * i] * b[at + 9] + a[3 * i + 1] * b[at + 10] + a[3 * i + 2] * b[at + 11]


@inner
def _between(reference: Any, pose: Any, out: Any) -> None:
    """The rotation from the reference to the pose, along the outer axes."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = (
                pose[3 * i] * reference[3 * j]
                + pose[3 * i + 1] * reference[3 * j + 1]
                + pose[3 * i + 2] * reference[3 * j + 2]
            )


@inner
def _spun(model: Any, reference: Any, pose: Any, work: Any) -> None:
    """Turns `pose` about its own axis, which goes through the origin, to be nearest to the reference."""
    ax, ay, az = model[AXES], model[AXES + 1], model[AXES + 2]
    Q = work
    for i in range(3):
        for j in range(3):
            Q[3 * i + j] = (
                reference[i] * pose[j] + reference[3 + i] * pose[3 + j] + reference[6 + i] * pose[6 + j]
            )
    # The trace of Q exp(φ a) is c cos φ - s sin φ and what does not depend on φ.
    s = ax * (Q[7] - Q[5]) + ay * (Q[2] - Q[6]) + az * (Q[3] - Q[1])
    aQa = (
        ax * (Q[0] * ax + Q[1] * ay + Q[2] * az)
        + ay * (Q[3] * ax + Q[4] * ay + Q[5] * az)
        + az * (Q[6] * ax + Q[7] * ay + Q[8] * az)
    )
    c = Q[0] + Q[4] + Q[8] - aQa
    length = np.sqrt(c * c + s * s)
    if not length > 1e-12:
        return
    c, s = c / length, -s / length
    v = 1 - c
    Q[0], Q[1], Q[2] = c + v * ax * ax, v * ax * ay - s * az, v * ax * az + s * ay
    Q[3], Q[4], Q[5] = v * ax * ay + s * az, c + v * ay * ay, v * ay * az - s * ax
    Q[6], Q[7], Q[8] = v * ax * az - s * ay, v * ay * az + s * ax, c + v * az * az
    for i in range(3):
        p, q, r = pose[3 * i], pose[3 * i + 1], pose[3 * i + 2]
        for j in range(3):
            pose[3 * i + j] = p * Q[j] + q * Q[3 + j] + r * Q[6 + j]


@inner
def nearest(model: Any, pose: Any, reference: Any, out: Any, work: Any) -> None:
    """`out`: the equivalent of `pose` nearest to the reference; of equals the first. `work` (24 + 121)."""
    out[:] = pose
    kind = int(model[SYMMETRY])
    if kind == NONE:
        return
    candidate, Q, turn, costs = work[:12], work[12:21], work[21:24], work[24:]
    count, begin, radius = int(model[ROTATION_COUNT]), int(model[ROTATIONS]), model[RADIUS]
    least = np.inf
    for k in range(count):
        _times(pose, model, begin + 12 * k, candidate)
        if kind == AXIS:
            _spun(model, reference, candidate, Q)
        _between(reference, candidate, Q)
        rotation_log(Q, turn)
        cost = 0.0
        for i in range(3):
            shift = candidate[9 + i] - reference[9 + i]
            cost += shift * shift + radius * radius * turn[i] * turn[i]
        costs[k] = cost
        least = min(least, cost)
    for k in range(count):
        # A tie to rounding goes to the earlier element, so that the answer does not flicker.
        if costs[k] <= least * (1 + 1e-9) + 1e-18:
            _times(pose, model, begin + 12 * k, out)
            if kind == AXIS:
                _spun(model, reference, out, Q)
            return


@inner
def are_apart(model: Any, a: Any, b: Any, shift: float, turn: float, work: Any) -> bool:
    """Whether two poses differ by more than a shift of the object's middle [m] or a turn [rad]; `work` (160)."""
    other, Q, vector, rest = work[:12], work[12:21], work[21:24], work[24:]
    nearest(model, a, b, other, rest)
    far = 0.0
    for i in range(3):
        gap = other[9 + i] - b[9 + i]
        for k in range(3):
            gap += (other[3 * i + k] - b[3 * i + k]) * model[CENTER + k]
        far += gap * gap
    if far > shift * shift:
        return True
    _between(b, other, Q)
    rotation_log(Q, vector)
    return vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2] > turn * turn
