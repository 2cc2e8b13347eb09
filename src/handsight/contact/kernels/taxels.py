"""Readings of a tactile surface to pressed and untouched taxels, and to patches of taxels that touch each other."""

import math
from typing import Any, NamedTuple

import numpy as np

from handsight._compiled.jit import entry, inner
from handsight._compiled.vec3 import add, cross, dot, matrix, mul, norm, scale, store, sub, vector
from handsight.contact.kernels.taxel_records import (
    DEAD,
    DRIFTING,
    FAR,
    FULL,
    LOW,
    PRESSED,
    RIM,
    STUCK,
    UNKNOWN,
    UNTOUCHED,
)


class TaxelOptions(NamedTuple):
    """`TaxelOptions` are constants of patches, fitted to simulated tips (`testbed/skin_scenes.py`), and of faults."""

    flat: float = math.cos(math.radians(3.0))  # of the angle of a flat patch's normals with their mean
    filled: float = 0.5  # sigma of the reading that a dead taxel is given, as a share of it
    steeper: float = 0.35
    """The reading of a dead taxel is above the mean of its neighbours by this share of what that is above the mean of
    those up to two taxels away."""
    sampled: float = 0.19  # sigma of the centre by the cells' size, in cells of a patch of one taxel
    beyond: float = 0.5  # sigma of a patch at the edge, beyond which nothing is measured, in cells
    half_width: float = 5e-3
    """Half the width of a contact [m]: (4 R F / (pi k))^(1/4) of a round body on a bed of springs, 5 mm for R = 9 mm
    (of body and tip together), F = 1.5 N, k = 2.5e7 N/m^3. The root makes little of them: 3 to 10 mm of tips."""
    hidden: float = 0.58
    """Sigma of the shift to a contact's middle beyond the edge, as a share of it: it may be anywhere from none to twice
    as far, 1 / sqrt(3). The surface's fall and turn out there, of which nothing is known, are as uncertain."""
    wide: float = 0.125  # sigma by uneven skin, in cells, of a patch whose variance is that of a cell
    uneven: float = 0.06  # sigma of the normal by such a patch, as a share of the normals' spread
    deep: float = 0.5
    """Indentations count that are deeper than this share of a patch's deepest: on an elastic half space under a sphere,
    the edge of the contact is half as deep as its middle (Hertz). Farther out a gel hangs beside the object."""
    min_rest: int = 5  # fewest readings of an untouched surface whose mean is used as its baseline
    mean_rest: int = 50  # readings over which the mean is taken; after so many it follows
    alive: float = 0.75
    """Share of the taxels that must change at rest for one that does not to be dead: in a dead band many do not."""
    still: int = 50  # readings for which a touched taxel that is stuck does not change, while others do
    drifted: float = 5.0  # a taxel that has drifted by so many thresholds is left out


TAXELS = TaxelOptions()


@entry
def sense_taxels(
    readings: Any, baseline: Any, surface: Any, taxels: Any, rise: Any, states: Any, patches: Any
) -> int:
    """Returns the number of patches, which are written to `patches` (p,), records PATCH.

    `readings` and `baseline` (n, c), c = 1 or 3, NaN: unknown. `rise` (n + 1, c) gets the scaled readings over the
    baseline, 0 in its last row, `states` (2, n + 1) what each taxel says and the number of its patch, or -1.
    """
    record = surface[0]
    n = len(taxels)
    last = readings.shape[1] - 1
    state = states[0]
    touched = np.zeros(n + 1, dtype=np.bool_)
    isolated = np.zeros(n + 1, dtype=np.bool_)
    state[n] = UNKNOWN
    rise[n] = 0.0
    for i in range(n):
        for k in range(last + 1):
            value = record.scale[k] * (readings[i, k] - record.offset[k])
            rise[i, k] = value - baseline[i, k]
            if k == last and value >= record.full_scale and not math.isnan(baseline[i, k]):
                rise[i, k] = record.full_scale
        state[i] = FAR
        if not math.isfinite(rise[i].sum()):
            state[i] = UNKNOWN
            rise[i] = 0.0
        touched[i] = rise[i, last] >= record.threshold
    for i in range(n):
        isolated[i] = touched[i] and not _sum(touched, taxels[i].wide)
    if touched.sum() > isolated.sum():  # while others are touched together, an isolated one is stuck
        for i in range(n):
            if isolated[i]:
                touched[i] = False
                state[i] = UNKNOWN
    if not touched.any():
        states[1] = -1
        for i in range(n):
            state[i] = UNTOUCHED if record.flat and state[i] == FAR else state[i]
        return 0
    for i in range(n):
        near = taxels[i].near
        if touched[i]:  # with less than half of its strongest neighbour's rise, perhaps at its rim only
            strongest = 0.0
            for j in near:
                strongest = max(strongest, rise[j, last])
            state[i] = PRESSED if rise[i, last] >= 0.5 * strongest else RIM
        elif state[i] == FAR:
            # Taxels between touched ones are covered too.
            for axis in range(2):
                ends = 0
                for side in (2 * axis, 2 * axis + 1):
                    j = taxels[i].beside[side]
                    steps = 0
                    while j < n and not touched[j] and steps < n:
                        j = taxels[j].beside[side]
                        steps += 1
                    ends += touched[j]
                state[i] = LOW if ends == 2 else state[i]
            beside = record.flat or (_sum(touched, taxels[i].wide) > 0 and not _sum(touched, near))
            state[i] = UNTOUCHED if state[i] == FAR and beside else state[i]
    return _find_patches(record, taxels, touched, rise, states, patches)


@inner
def _sum(values: Any, numbers: Any) -> float:
    """Returns the sum of the values with these numbers."""
    total = 0.0
    for j in numbers:
        total += values[j]
    return total


@inner
def _find_patches(record: Any, taxels: Any, touched: Any, rise: Any, states: Any, patches: Any) -> int:
    """Returns the number of patches: connected touched taxels, dead ones between them, and all around them. What reads
    less than the threshold bears a part of the force, too. A dead taxel reads about as its neighbours do."""
    n = len(taxels)
    count = 0
    last = rise.shape[1] - 1
    state = states[0]
    label = states[1]
    filled = np.zeros(n + 1, dtype=np.bool_)
    members = np.empty(n, dtype=np.int64)
    known = state > LOW
    for i in range(n):
        near, wide = taxels[i].near, taxels[i].wide
        if not known[i] and _sum(touched, near) >= max(2.0, 0.5 * _sum(known, near)):
            inside, around = _sum(rise[:, last], near), _sum(rise[:, last], wide)
            mean = inside / _sum(known, near)
            farther = (around - inside) / max(_sum(known, wide) - _sum(known, near), 1.0)
            more = (1.0 + TAXELS.steeper * max(mean - farther, 0.0) / mean) / _sum(known, near)
            filled[i] = True
            for k in range(last + 1):
                rise[i, k] = more * _sum(rise[:, k], near)
    label[:] = -1
    for i in range(n):
        if not touched[i] or label[i] >= 0 or count == len(patches):
            continue
        members[0] = i
        size = 1
        done = 0
        label[i] = count
        while done < size:
            at = members[done]
            done += 1
            for j in taxels[at].near:
                if j < n and label[j] < 0 and (touched[j] or (filled[j] and touched[at])):
                    label[j] = count
                    members[size] = j
                    size += 1
        for at in members[:done]:
            for j in taxels[at].near:
                if label[j] < 0 and known[j]:
                    label[j] = count
                    members[size] = j
                    size += 1
        _measure(record, taxels, members[:size], rise, filled, touched, patches[count])
        label[members[done:size]] = -1
        count += 1
    return count


@inner
def _measure(
    record: Any, taxels: Any, members: Any, rise: Any, filled: Any, touched: Any, patch: Any
) -> None:
    """Writes a patch: its centre of pressure on the surface, the mean normal there, their covariance, and the force.

    The centre is a weighted mean of the taxels' points, raised from the chord to the surface: at a taxel the
    surface's slope against the mean normal is n_t / n_z, and half of that times the taxel's distance is its depth.
    Weights are the forces along the mean normal. Along the taxels' own, those that face a shear would bear more: a load
    at the limit of friction μ would turn the normal towards itself by μ r² / (2 R²), with r the patch's radius (root
    mean square) and R the tip's, and seem within its cone.

    Of indentations, the contact may be anywhere in the patch, with the normal there: its covariance is the patch's
    second moment.
    """
    m = len(members)
    last = rise.shape[1] - 1
    cell = record.pitch
    share = np.empty(m)
    zero = (0.0, 0.0, 0.0)
    for k in range(m):
        share[k] = max(rise[members[k], last], 0.0)
    patch.total = share.sum()
    patch.flat = True
    deepest = share.max()
    if record.indentation:
        for k in range(m):
            share[k] = share[k] if share[k] >= TAXELS.deep * deepest else 0.0
    if last == 2:
        mean = zero
        for k in range(m):
            mean = add(mean, scale(vector(taxels[members[k]].axes[:, 2]), share[k]))
        mean = scale(mean, 1.0 / max(norm(mean), 1e-12))
        for k in range(m):
            share[k] = max(-dot(_force(taxels[members[k]].axes, rise[members[k]]), mean), 0.0)
    share /= max(share.sum(), 1e-12)
    point = zero
    normal = zero
    edge = zero
    bend = np.zeros((3, 3))
    for k in range(m):
        taxel = taxels[members[k]]
        w = share[k]
        point = add(point, scale(vector(taxel.point), w))
        normal = add(normal, scale(vector(taxel.axes[:, 2]), w))
        edge = add(edge, scale(vector(taxel.edge), w))
        for a in range(9):
            bend[a // 3, a % 3] += w * taxel.bend[a // 3, a % 3]
    normal = scale(normal, 1.0 / max(norm(normal), 1e-12))
    raised = 0.0
    spread = 0.0
    for k in range(m):
        own = vector(taxels[members[k]].axes[:, 2])
        along, sideways = dot(own, normal), _across(own, normal)
        arm = sub(vector(taxels[members[k]].point), point)
        raised += 0.5 * share[k] * dot(arm, sideways) / max(along, 0.3)
        spread += 0.5 * share[k] * dot(sideways, sideways)
        patch.flat = patch.flat and (along >= TAXELS.flat or not touched[members[k]])
    point = add(point, scale(normal, raised))
    # Of a contact across the layout's edge only the near part is felt. With all of that on taxels at the edge, whose
    # neighbours are on one half, 2 / pi on average, the contact's middle is half its width farther.
    near_part = point
    edge = _across(edge, normal)
    shift = scale(edge, -TAXELS.half_width * (math.pi / 2) ** 2 * norm(edge))
    turn = mul(matrix(bend), shift)
    sag = 0.5 * dot(turn, shift)
    point = add(point, sub(shift, scale(normal, sag)))
    normal = add(normal, turn)
    normal = scale(normal, 1.0 / norm(normal))

    # Each row is the change of point and normal by one sigma of an independent error: first of each reading.
    rows = np.zeros((m + 14, 6))
    force = zero
    moment = zero
    second = np.zeros((3, 3))
    measured = last == 2
    for k in range(m):
        i = members[k]
        w = share[k] * patch.total
        axes = taxels[members[k]].axes
        arm = sub(vector(taxels[i].point), near_part)
        own = vector(axes[:, 2])
        relative = record.noise**2 + (TAXELS.filled**2 if filled[i] else 0.0)
        sigma = math.sqrt(relative * w * w + (record.threshold / 3.0) ** 2) / patch.total
        if record.indentation:
            sigma = math.sqrt(share[k])
        store(scale(_across(arm, normal), sigma), rows[k, :3])
        store(scale(_across(own, normal), -sigma), rows[k, 3:])
        for a in range(9):
            second[a // 3, a % 3] += share[k] * arm[a // 3] * arm[a % 3]
        if last == 2:
            pushed = _force(axes, rise[i])
            force = add(force, pushed)
            moment = add(moment, cross(arm, pushed))
            measured = measured and rise[i, 2] < record.full_scale
    # Then shifts of the centre, which the normal follows by the surface's bend: by the cells' size, by uneven skin, and
    # at the edge. Last the normal's own error, and the height's, which is the only one out of the surface.
    sampled = TAXELS.sampled if len(taxels) > 1 else math.sqrt(1 / 12)  # anywhere on a single taxel
    wide = 0.0 if record.indentation else TAXELS.wide
    turned = record.variance_normal + TAXELS.uneven**2 * spread + TAXELS.hidden**2 * dot(turn, turn)
    store(scale(edge, TAXELS.beyond * cell), rows[m + 6, :3])
    for a in range(3):
        rows[m + a, a] = sampled * cell * (share**2).sum()
        rows[m + 3 + a, :3] = wide / cell * second[a]
        rows[m + 7 + a, 3 + a] = math.sqrt(turned)
        rows[m + 10 + a, a] = TAXELS.hidden * norm(shift)
    for k in range(m, m + 13):
        shift = _across(vector(rows[k, :3]), normal)
        store(shift, rows[k, :3])
        store(_across(sub(vector(rows[k, 3:]), mul(matrix(bend), shift)), normal), rows[k, 3:])
    height = record.variance_point * (share**2).sum() + (TAXELS.hidden * sag) ** 2
    if record.indentation:
        height += (record.noise * deepest) ** 2
    store(scale(normal, math.sqrt(height)), rows[m + 13, :3])
    for a in range(6):
        for b in range(6):
            patch.covariance[a, b] = (rows[:, a] * rows[:, b]).sum()
    store(point, patch.point)
    store(scale(normal, -1.0), patch.normal)
    if not measured:
        force, moment = (math.nan, math.nan, math.nan), (math.nan, math.nan, math.nan)
    store(force, patch.force)
    store(force, patch.wrench[:3])
    store(add(moment, cross(near_part, force)), patch.wrench[3:])
    patch.torque = -dot(moment, normal)  # about the middle of what is felt, as nothing else was measured


@inner
def _force(axes: Any, rise: Any) -> Any:
    """Returns the force on a taxel of three components in its link."""
    shear = add(scale(vector(axes[:, 0]), rise[0]), scale(vector(axes[:, 1]), rise[1]))
    return sub(shear, scale(vector(axes[:, 2]), rise[2]))


@inner
def _across(v: Any, normal: Any) -> Any:
    """Returns the part of a vector across a unit normal."""
    return sub(v, scale(normal, dot(v, normal)))


@entry
def watch_taxels(
    readings: Any, surface: Any, states: Any, rise: Any, rest: bool, count: int, watched: Any, baseline: Any
) -> int:
    """Returns the number of readings at rest so far, and updates `watched` (n,) and `baseline` (n, c).

    `readings` (n, c) and their `states` and `rise` are those of `sense_taxels`; `rest`: whether no other sensor
    touches something. The surface is at rest where, besides, no two taxels of a patch are touched, nor all. The
    baseline is NaN for taxels that are left out, 0 before there are enough readings.
    """
    record = surface[0]
    n = readings.shape[0]
    last = readings.shape[1] - 1
    moving = 0
    touched = (states[1, :n] >= 0) & (rise[:n, last] >= record.threshold)
    few = touched.sum() <= 1 + states[1].max() and touched.sum() < n
    rest = rest and (count < TAXELS.min_rest or few)
    count += rest
    varied = 0
    for i in range(n):
        w = watched[i]
        changed = False
        for k in range(last + 1):
            value = record.scale[k] * (readings[i, k] - record.offset[k])
            changed = changed or (value != w.last[k] and not math.isnan(w.last[k]))
            w.last[k] = value
            if rest and math.isfinite(value):
                w.mean[k] += (value - w.mean[k]) / min(count, TAXELS.mean_rest)
                w.first[k] = w.mean[k] if count <= TAXELS.mean_rest else w.first[k]
        w.still = 0 if changed else w.still + 1
        w.varied = w.varied or (rest and changed)
        varied += w.varied
        moving += touched[i] and w.still < TAXELS.min_rest
    enough = count >= TAXELS.min_rest
    for i in range(n):
        w = watched[i]
        drift = abs(w.mean[last] - w.first[last]) / record.threshold
        always_full = enough and w.mean[last] >= record.full_scale
        w.fault = DRIFTING if drift > 1.0 else 0
        if always_full or (touched[i] and rise[i, last] >= record.full_scale):
            w.fault = FULL
        elif enough and not w.varied and w.still >= count and varied > TAXELS.alive * n:
            w.fault = DEAD
        elif touched[i] and w.still >= TAXELS.still and 2 * moving > touched.sum():
            w.fault = STUCK
        out = w.fault == DEAD or w.fault == STUCK or always_full or drift > TAXELS.drifted
        for k in range(last + 1):
            baseline[i, k] = math.nan if out else w.mean[k] if enough else 0.0
    return count
