"""Indentations of a gel to the contacts of its patches: points on the object, with the object's normals."""

import math
from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.jit import entry, inner
from handsight._kernels.math.vec3 import add, cross, dot, matrix, mul, norm, scale, store, sub, vector
from handsight._kernels.touch.taxel_records import FAR, NEAR, PRESSED, RIM, UNKNOWN, WIDE


class GelOptions(NamedTuple):
    """`GelOptions` are the constants of a gel's contacts."""

    deep: float = 0.5
    """The gel lies on the object where it is deeper than this share of its deepest place: on an elastic half space
    under a sphere, the edge of the contact is half as deep as its middle (Hertz)."""
    most: int = 5  # contacts of a patch
    spread: float = 2.0  # least distance between two of them, in cells
    few: int = 5  # fewest places for a slope


GEL = GelOptions()


@entry
def sense_gel(
    readings: Any, baseline: Any, surface: Any, taxels: Any, rise: Any, states: Any, patches: Any
) -> int:
    """Returns the number of contacts, which are written to `patches`, records PATCH. The arguments are those of
    `sense_taxels`, the readings indentations [m]. Several contacts of one patch of touched places follow each other."""
    record, n, count, number = surface[0], len(taxels), 0, 0
    state, label, members = states[0], states[1], np.empty(n, dtype=np.int64)
    label[:], state[n], rise[n] = -1, UNKNOWN, 0.0
    for i in range(n):
        rise[i, 0] = record.scale[0] * (readings[i, 0] - record.offset[0]) - baseline[i, 0]
        state[i] = RIM if rise[i, 0] >= record.threshold else FAR
        if not math.isfinite(rise[i, 0]):
            state[i], rise[i, 0] = UNKNOWN, 0.0
    for i in range(n):
        if state[i] != RIM or label[i] >= 0 or count == len(patches):
            continue
        members[0], size, done, label[i] = i, 1, 0, number
        while done < size:
            at, done = members[done], done + 1
            for j in taxels[at].near:
                if j < n and label[j] < 0 and state[j] == RIM:
                    label[j], members[size], size = number, j, size + 1
        if size < GEL.few:  # noise
            label[members[:size]] = -1
            continue
        count += _add_contacts(record, taxels, members[:size], rise, state, patches[count:])
        number += 1
    for k in range(count):
        patches[k].contacts = count
    return count


@inner
def _add_contacts(record: Any, taxels: Any, members: Any, rise: Any, state: Any, patches: Any) -> int:
    """Returns the number of contacts of a patch, which are written to `patches`: amid its deep part, then those that
    are farthest from each other."""
    deepest, total, n = 0.0, 0.0, len(taxels)
    for i in members:  # of means of neighbours, as one place alone may be noise
        mean, known = rise[i, 0], 1
        for j in taxels[i].near:
            if j < n and state[j] != UNKNOWN:
                mean, known = mean + rise[j, 0], known + 1
        deepest, total = max(deepest, mean / known), total + rise[i, 0]
    middle, deep = (0.0, 0.0, 0.0), 0
    for i in members:
        if rise[i, 0] >= GEL.deep * deepest:
            state[i], deep, middle = PRESSED, deep + 1, add(middle, vector(taxels[i].point))
    middle = scale(middle, 1.0 / max(deep, 1))
    # At its edge the deep part may be at the object's edge, or hang already; so places are inside it if there are any.
    inside, distance = 0, np.full(len(members), -1.0)
    for reach in (WIDE, NEAR, 0):
        for k in range(len(members)):
            at, around = members[k], True
            for j in taxels[at].wide[:reach]:
                around = around and (j == n or state[j] == PRESSED or state[j] == UNKNOWN)
            if state[at] == PRESSED and around:
                distance[k] = 1.0 / (norm(sub(vector(taxels[at].point), middle)) + 1e-6)
                inside += 1
        if inside:
            break
    count = 0
    while count < min(GEL.most, len(patches)):
        best = distance.argmax()
        if distance[best] <= (GEL.spread * record.pitch if count else 0.0):
            break
        chosen = members[best]
        _measure(record, taxels, chosen, rise, state, patches[count])
        patches[count].total = total
        for k in range(len(members)):
            away = norm(sub(vector(taxels[members[k]].point), vector(taxels[chosen].point)))
            distance[k] = away if distance[k] > 0 and count == 0 else min(distance[k], away)
        count += 1
    return count


@inner
def _measure(record: Any, taxels: Any, at: int, rise: Any, state: Any, patch: Any) -> None:
    """Writes the contact at a deep place: a plane is fitted to the indentation there and at deep places around it."""
    n, taxel, sums = len(taxels), taxels[at], np.zeros((3, 3))
    sums[0, 0], products, square = 1.0, (rise[at, 0], 0.0, 0.0), rise[at, 0] ** 2
    for j in taxel.wide:
        if j < n and state[j] == PRESSED:
            arm = sub(vector(taxels[j].point), vector(taxel.point))
            row = 1.0, dot(arm, vector(taxel.axes[:, 0])), dot(arm, vector(taxel.axes[:, 1]))
            products, square = add(products, scale(row, rise[j, 0])), square + rise[j, 0] ** 2
            for a in range(3):
                for b in range(3):
                    sums[a, b] += row[a] * row[b]
    # A weak pull to no slope, for places that are along a line.
    weak, count = 0.01 * record.pitch**2, sums[0, 0]
    sums[1, 1], sums[2, 2] = sums[1, 1] + weak, sums[2, 2] + weak
    one, x, y = matrix(sums)  # symmetric; LAPACK would load SciPy's linear algebra
    cofactors = cross(x, y), cross(y, one), cross(one, x)
    determinant = dot(one, cofactors[0])
    plane = scale(mul(cofactors, products), 1.0 / determinant)
    depth, slope_x, slope_y = plane
    # What a plane leaves over is an edge, or a bend: point and normal are somewhere in it.
    misfit = max(square - dot(plane, products), 0.0) / count
    own = vector(taxel.axes[:, 2])
    turned = add(scale(vector(taxel.axes[:, 0]), slope_x), add(scale(vector(taxel.axes[:, 1]), slope_y), own))
    normal = scale(turned, 1.0 / norm(turned))
    store(sub(vector(taxel.point), scale(own, depth)), patch.point)
    store(scale(normal, -1.0), patch.normal)
    slope2 = slope_x * slope_x + slope_y * slope_y
    by_noise = record.variance_point * 0.5 * (cofactors[1][1] + cofactors[2][2]) / determinant
    few = 0.25 if count < GEL.few else 0.0  # then the slope is unknown
    sideways, variance = record.pitch**2 / 12.0, record.variance_point + (record.noise * depth) ** 2 + misfit
    turn = record.variance_normal + by_noise + record.noise**2 * slope2 + few
    turn += misfit * count / (0.5 * (sums[1, 1] + sums[2, 2]))
    for a in range(6):
        for b in range(6):
            of = sideways if a < 3 else turn
            patch.covariance[a, b] = of if a == b else 0.0
            if a < 3 and b < 3:
                patch.covariance[a, b] += (variance - sideways) * normal[a] * normal[b]
    patch.force[:], patch.wrench[:], patch.torque, patch.flat = math.nan, math.nan, math.nan, False
