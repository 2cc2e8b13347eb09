"""Readings of a tactile surface to pressed and untouched taxels, and to patches of taxels that touch each other."""

import math
from typing import Any, NamedTuple

import numpy as np

from handsight._kernels.math.vec3 import add, cross, dot, matrix, mul, norm, scale, store, sub, vector
from handsight._kernels.runtime.compilation import entry, inner

NEAR, WIDE = 8, 24
"""Most neighbours of a taxel that touch it, and most of those up to two taxels away."""
TAXEL = np.dtype(
    [
        ("point", float, 3),  # in the link [m]
        ("axes", float, (3, 3)),  # columns: the taxel's x and y, and the outward normal
        (
            "edge",
            float,
            3,
        ),  # mean unit vector to its neighbours: 0 amid them, of length 1 where they are on one side
        ("bend", float, (3, 3)),  # change of the normal by that of the point [1/m]
        ("near", np.int64, NEAR),  # neighbours; -1 ends the list
        ("wide", np.int64, WIDE),  # those up to two taxels away; -1 ends the list
        ("beside", np.int64, 4),  # the neighbour towards -x, +x, -y, +y; -1: none
    ]
)
"""One taxel of a surface."""
SURFACE = np.dtype(
    [
        ("scale", float, 3),
        ("offset", float, 3),
        ("threshold", float),
        ("full_scale", float),  # infinite where unknown
        ("noise", float),  # relative
        ("cell", float),  # area of a taxel [m²]
        ("variance_point", float),
        ("variance_normal", float),
        ("variance_mount", float, 6),  # of the common error, shift [m²] and turn [rad²]
        ("flat", bool),  # whether all normals are parallel
    ]
)
"""What all taxels of a surface have in common; the names are those of `handsight.contact.TactileSurface`."""
PATCH = np.dtype(
    [
        ("point", float, 3),
        ("normal", float, 3),  # the direction in which the object pushes
        ("covariance", float, (6, 6)),  # of point and normal
        ("force", float, 3),  # of the object on the link, of three components only
        ("torque", float),  # about the normal
        ("total", float),  # sum of the readings along the normals
        ("count", np.int64),  # of touched taxels
        ("flat", bool),
        ("three", bool),  # whether the surface has three components
    ]
)
"""Taxels that touch each other, and the contact at their centre of pressure, in the link."""
WATCHED = np.dtype(
    [
        ("mean", float, 3),  # of the scaled readings while nothing was touched
        ("first", float, 3),  # the same, of the first readings
        ("last", float, 3),  # the last reading
        ("varied", bool),  # whether it has changed while nothing was touched
        ("still", np.int64),  # readings since its last change
        ("fault", np.int64),  # number in `FAULTS`
    ]
)
"""What one taxel has read over time."""
FAULTS = ("", "dead", "stuck", "at full scale", "drifting")
"""Why a taxel is left out; one that drifts by little is used, from where it is by now."""
NO_FAULT, DEAD, STUCK, FULL, DRIFTING = range(5)
UNKNOWN, PRESSED, RIM, UNTOUCHED, FAR = range(5)
"""What a taxel says. UNKNOWN: nothing. PRESSED: a contact. RIM: touched, perhaps at its rim only. UNTOUCHED: the object
is not here. FAR: untouched, but not beside a patch, where a curved surface is too far from the object to say more."""


class PatchOptions(NamedTuple):
    """`PatchOptions` are the constants of patches; the shares were fitted to simulated tips (`testbed/tips.py`)."""

    flat: float = math.cos(
        math.radians(3.0)
    )  # of the angle between the normals of a flat patch and their mean
    filled: float = 0.5  # sigma of the reading that a dead taxel is given, as a share of it
    steeper: float = 0.35
    """The reading of a dead taxel is above the mean of its neighbours by this share of what that is above the mean of
    those up to two taxels away."""
    sampled: float = 0.2  # sigma of the centre by the cells' size, in cells of a patch of one taxel
    beyond: float = 0.58  # sigma of a patch at the edge, beyond which nothing is measured, in cells
    wide: float = 0.24  # sigma by uneven skin, in cells, of a patch whose variance is that of a cell
    uneven: float = 0.07  # sigma of the normal by such a patch, as a share of the normals' spread
    conflict: float = 21.1  # χ² of three numbers, level 1e-4, above which a wrench contradicts a patch


PATCHES = PatchOptions()


class WatchOptions(NamedTuple):
    """`WatchOptions` say how the readings of taxels are watched over time."""

    min_rest: int = 5  # fewest readings of an untouched surface whose mean is used as its baseline
    mean_rest: int = 50  # readings over which the mean is taken; after so many it follows
    still: int = 50  # readings for which a touched taxel that is stuck does not change, while others do
    drifted: float = 5.0  # a taxel that has drifted by so many thresholds is left out


WATCH = WatchOptions()


@entry
def sense_taxels(
    readings: Any, baseline: Any, surface: Any, taxels: Any, rise: Any, states: Any, patches: Any
) -> int:
    """Returns the number of patches, which are written to `patches` (p,), records PATCH.

    `readings` and `baseline` (n, c), c = 1 or 3, NaN: unknown. `rise` (n, c) gets the scaled readings over the
    baseline, `states` (2, n) what each taxel says and the number of its patch, or -1.
    """
    record, n = surface[0], len(taxels)
    last = readings.shape[1] - 1
    state, label = states[0], states[1]
    touched = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        known = True
        for k in range(last + 1):
            value = record.scale[k] * (readings[i, k] - record.offset[k])
            rise[i, k] = value - baseline[i, k]
            if k == last and value >= record.full_scale and not math.isnan(baseline[i, k]):
                rise[i, k] = record.full_scale
            known = known and math.isfinite(rise[i, k])
        state[i] = FAR if known else UNKNOWN
        touched[i] = known and rise[i, last] >= record.threshold
        if not known:
            rise[i] = 0.0
    _leave_out_isolated(taxels, touched, state)
    _classify(record, taxels, touched, rise[:, last], state)
    return _label(record, taxels, touched, rise, state, label, patches)


@inner
def _leave_out_isolated(taxels: Any, touched: Any, state: Any) -> None:
    """Marks taxels that are touched alone as unknown, while others are touched together: they are stuck."""
    isolated, together = np.zeros(len(taxels), dtype=np.bool_), False
    for i in range(len(taxels)):
        if touched[i]:
            isolated[i] = True
            for j in taxels[i].wide:
                if j >= 0 and touched[j]:
                    isolated[i] = False
            together = together or not isolated[i]
    if together:
        for i in range(len(taxels)):
            if isolated[i]:
                touched[i], state[i] = False, UNKNOWN


@inner
def _classify(record: Any, taxels: Any, touched: Any, rise: Any, state: Any) -> None:
    """Writes the state of each taxel.

    With less than half of its strongest neighbour's rise, a taxel may be touched at its rim only. Taxels between
    touched ones are covered too: they are dead, or lower than the others. On a curved surface the object is near only
    beside a patch.
    """
    for i in range(len(taxels)):
        if touched[i]:
            strongest = 0.0
            for j in taxels[i].near:
                if j >= 0:
                    strongest = max(strongest, rise[j])
            state[i] = PRESSED if rise[i] >= 0.5 * strongest else RIM
        elif state[i] == FAR:
            for axis in range(2):
                ends = 0
                for side in range(2):
                    j, steps = taxels[i].beside[2 * axis + side], 0
                    while j >= 0 and not touched[j] and steps < len(taxels):
                        j, steps = taxels[j].beside[2 * axis + side], steps + 1
                    ends += j >= 0 and touched[j]
                if ends == 2:
                    state[i] = UNKNOWN
            if state[i] == FAR:
                within = record.flat
                if not within:
                    for j in taxels[i].wide:
                        within = within or (j >= 0 and touched[j])
                    for j in taxels[i].near:
                        within = within and not (j >= 0 and touched[j])
                if within:
                    state[i] = UNTOUCHED


@inner
def _label(record: Any, taxels: Any, touched: Any, rise: Any, state: Any, label: Any, patches: Any) -> int:
    """Returns the number of patches: connected touched taxels, and dead ones between them."""
    n, count, last = len(taxels), 0, rise.shape[1] - 1
    queue, filled = np.empty(n, dtype=np.int64), np.zeros(n, dtype=np.bool_)
    label[:] = -1
    for i in range(n):  # a dead taxel reads about as its neighbours do
        if state[i] == UNKNOWN:
            around, known = 0, 0
            mean, farther = np.zeros(last + 1), 0.0
            for j in taxels[i].near:
                if j >= 0 and state[j] != UNKNOWN:
                    known, around = known + 1, around + touched[j]
                    for k in range(last + 1):
                        mean[k] += rise[j, k]
            wide = 0
            for j in taxels[i].wide:
                if j >= 0 and state[j] != UNKNOWN:
                    wide, farther = wide + 1, farther + rise[j, last]
            if around >= 2 and 2 * around >= known and mean[last] > 0.0:
                filled[i] = True
                inside = mean[last] / known
                outside = (farther - mean[last]) / max(wide - known, 1)
                more = 1.0 + PATCHES.steeper * max(inside - outside, 0.0) / inside
                for k in range(last + 1):
                    rise[i, k] = more * mean[k] / known
    for i in range(n):
        if not touched[i] or label[i] >= 0:
            continue
        if count == len(patches):
            break
        queue[0], size, done = i, 1, 0
        label[i] = count
        while done < size:
            at = queue[done]
            done += 1
            for j in taxels[at].near:
                if j >= 0 and label[j] < 0 and (touched[j] or (filled[j] and touched[at])):
                    label[j] = count
                    queue[size] = j
                    size += 1
        for at in range(size):  # what reads less than the threshold, too, bears a part of the force
            for j in taxels[queue[at]].near:
                if j >= 0 and label[j] < 0 and state[j] != UNKNOWN:
                    label[j] = n
                    queue[size] = j
                    size += 1
        for at in range(size):
            if label[queue[at]] == n:
                label[queue[at]] = -1
        _measure(record, taxels, queue[:size], rise, touched, filled, patches[count])
        count += 1
    return count


@inner
def _measure(
    record: Any, taxels: Any, members: Any, rise: Any, touched: Any, filled: Any, patch: Any
) -> None:
    """Writes a patch: its centre of pressure on the surface, the mean normal there, their covariance, and the force.

    The centre is a weighted mean of the taxels' points, raised from the chord to the surface: at a taxel the
    surface's slope against the mean normal is n_t / n_z, and half of that times the taxel's distance is its depth.
    """
    last = rise.shape[1] - 1
    total, square = 0.0, 0.0
    point, normal = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in members:
        w = max(rise[i, last], 0.0)
        total, square = total + w, square + w * w
        point = add(point, scale(vector(taxels[i].point), w))
        normal = add(normal, scale(vector(taxels[i].axes[:, 2]), w))
    point = scale(point, 1.0 / total)
    normal = scale(normal, 1.0 / max(norm(normal), 1e-12))
    raised, spread, closest, edge = 0.0, 0.0, 1.0, (0.0, 0.0, 0.0)
    bend, second = np.zeros((3, 3)), np.zeros((3, 3))
    for i in members:
        w = max(rise[i, last], 0.0) / total
        own, arm = vector(taxels[i].axes[:, 2]), sub(vector(taxels[i].point), point)
        along = dot(own, normal)
        sideways = sub(own, scale(normal, along))
        raised += 0.5 * w * dot(arm, sideways) / max(along, 0.3)
        spread += 0.5 * w * dot(sideways, sideways)
        edge = add(edge, scale(vector(taxels[i].edge), w))
        if touched[i]:
            closest = min(closest, along)
        across = sub(arm, scale(normal, dot(arm, normal)))
        for a in range(3):
            for b in range(3):
                bend[a, b] += w * taxels[i].bend[a, b]
                second[a, b] += w * across[a] * across[b]
    point = add(point, scale(normal, raised))
    patch.three = last == 2
    patch.flat, patch.total, patch.count = closest >= PATCHES.flat, total, 0
    store(point, patch.point)
    store(scale(normal, -1.0), patch.normal)

    # The covariance: of each reading, of the cells' size, of the surface's height, and of an uneven patch.
    C = patch.covariance
    C[:] = 0.0
    J = np.empty(6)
    force, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for i in members:
        w = max(rise[i, last], 0.0)
        own, arm = vector(taxels[i].axes[:, 2]), sub(vector(taxels[i].point), point)
        store(scale(sub(arm, scale(normal, dot(arm, normal))), 1.0 / total), J[:3])
        store(scale(sub(own, scale(normal, dot(own, normal))), -1.0 / total), J[3:])
        variance = (record.noise * w) ** 2 + (record.threshold / 3.0) ** 2
        if touched[i]:
            patch.count += 1
        elif filled[i]:
            variance += (PATCHES.filled * w) ** 2
        for a in range(6):
            for b in range(6):
                C[a, b] += variance * J[a] * J[b]
        if last == 2:
            shear = add(
                scale(vector(taxels[i].axes[:, 0]), rise[i, 0]),
                scale(vector(taxels[i].axes[:, 1]), rise[i, 1]),
            )
            pushed = sub(shear, scale(own, rise[i, 2]))
            force, moment = add(force, pushed), add(moment, cross(arm, pushed))
    store(force, patch.force)
    patch.torque = -dot(moment, normal)
    cells = total * total / max(square, 1e-300)
    turned = record.variance_normal + PATCHES.uneven**2 * spread
    K = matrix(bend)
    for k in range(
        7
    ):  # shifts of the centre along the surface, which the normal follows by the surface's bend
        a = k % 3
        unit = (1.0 if a == 0 else 0.0, 1.0 if a == 1 else 0.0, 1.0 if a == 2 else 0.0)
        if k < 3:
            shift = scale(unit, PATCHES.sampled * math.sqrt(record.cell) / cells)
        elif k < 6:
            shift = scale(vector(second[a]), PATCHES.wide / math.sqrt(record.cell))
        else:
            shift = scale(edge, PATCHES.beyond * math.sqrt(record.cell))
        shift = sub(shift, scale(normal, dot(shift, normal)))
        turn = mul(K, shift)
        store(shift, J[:3])
        store(sub(scale(normal, dot(turn, normal)), turn), J[3:])
        for b in range(6):
            for c in range(6):
                C[b, c] += J[b] * J[c]
    for a in range(3):
        for b in range(3):
            C[a, b] += record.variance_point * normal[a] * normal[b]
            C[3 + a, 3 + b] += turned * ((1.0 if a == b else 0.0) - normal[a] * normal[b])


@entry
def watch_taxels(
    readings: Any,
    surface: Any,
    states: Any,
    rise: Any,
    untouched: bool,
    count: int,
    watched: Any,
    baseline: Any,
) -> int:
    """Returns the number of readings at rest so far, and updates `watched` (n,) and `baseline` (n, c).

    `readings` (n, c) and their `states` and `rise` are those of `sense_taxels`; `untouched`: whether no other sensor
    touches something. The hand is at rest where, besides, no two neighbouring taxels are touched. The baseline is NaN
    for taxels that are left out, 0 before there are enough readings.
    """
    record, n, last = surface[0], readings.shape[0], readings.shape[1] - 1
    rest, varied, touched, moving = untouched, 0, 0, 0
    for i in range(n):
        w = watched[i]
        changed = False
        for k in range(last + 1):
            value = record.scale[k] * (readings[i, k] - record.offset[k])
            changed = changed or (value != w.last[k] and not math.isnan(w.last[k]))
            w.last[k] = value
        w.still = 0 if changed else w.still + 1
        if states[1, i] >= 0 and rise[i, last] >= record.threshold:
            touched += 1
            moving += w.still < WATCH.min_rest
            for j in range(i):  # another one of the same patch
                if (
                    count >= WATCH.min_rest
                    and states[1, j] == states[1, i]
                    and rise[j, last] >= record.threshold
                ):
                    rest = False
                    break
    if rest:
        count += 1
    for i in range(n):
        w = watched[i]
        free = rest and (count <= WATCH.min_rest or not rise[i, last] >= record.threshold)
        for k in range(last + 1):
            if free and math.isfinite(w.last[k]):
                w.mean[k] += (w.last[k] - w.mean[k]) / min(count, WATCH.mean_rest)
                if count <= WATCH.mean_rest:
                    w.first[k] = w.mean[k]
        w.varied = w.varied or (rest and count > 1 and w.still == 0)
        varied += w.varied
    for i in range(n):
        w, enough = watched[i], count >= WATCH.min_rest
        away = abs(w.mean[last] - w.first[last])
        w.fault = NO_FAULT
        if enough and not w.varied and 2 * varied > n:
            w.fault = DEAD
        elif (enough and w.mean[last] >= record.full_scale) or (
            touched and rise[i, last] >= record.full_scale
        ):
            w.fault = FULL
        elif states[1, i] >= 0 and w.still >= WATCH.still and 2 * moving > touched:
            w.fault = STUCK
        elif away > record.threshold:
            w.fault = DRIFTING
        out = w.fault == DEAD or w.fault == STUCK or (w.fault == FULL and w.mean[last] >= record.full_scale)
        out = out or away > WATCH.drifted * record.threshold
        for k in range(last + 1):
            baseline[i, k] = math.nan if enough and out else w.mean[k] if enough else 0.0
    return count


@entry
def put_patches(
    numbers: Any,
    patches: Any,
    mounts: Any,
    Ts_palm_tip: Any,
    by_error: Any,
    moved: Any,
    contacts: Any,
    conflicts: Any,
) -> None:
    """Writes patches (k,) to the `contacts` (n) PALM_CONTACT of the tips `numbers` (k,) that they are on.

    `mounts` (k, 6): variance of each surface's common error; `by_error` (n, 6, j): motion of the tips by the joints'
    errors, which is that of a contact's point and normal in `moved` (n, 6, j), where patches' are written. A contact by
    the tip's wrench keeps its load. `conflicts` (k, 2) get the distance between both [m] and its square in standard
    deviations; 0 where there is one measurement. Patches and wrench that contradict each other are as uncertain as
    they are far apart.
    """
    for k in range(len(numbers)):
        patch, contact, T = patches[k], contacts[numbers[k]], Ts_palm_tip[numbers[k]]
        J, before = by_error[numbers[k]], moved[numbers[k]]
        R, C, old = matrix(T), np.zeros((6, 6)), contact.covariance
        arm = mul(R, vector(patch.point))
        point, normal = add(arm, vector(T[:3, 3])), mul(R, vector(patch.normal))
        for i in range(6):
            own = mul(R, vector(patch.covariance[i, :3])), mul(R, vector(patch.covariance[i, 3:]))
            store(own[0], C[i, :3])
            store(own[1], C[i, 3:])
        for j in range(6):
            column = mul(R, (C[0, j], C[1, j], C[2, j])), mul(R, (C[3, j], C[4, j], C[5, j]))
            for i in range(3):
                C[i, j], C[3 + i, j] = column[0][i], column[1][i]
        for i in range(3):
            C[i, i] += mounts[k, i]
            for j in range(3):
                C[3 + i, 3 + j] += mounts[k, 3] * ((1.0 if i == j else 0.0) - normal[i] * normal[j])
        conflicts[k] = 0.0
        measured = contact.reason == 0
        apart = sub(vector(contact.point), point)
        if measured:
            S = np.empty((3, 3))
            for i in range(3):
                for j in range(3):
                    S[i, j] = C[i, j] + old[i, j]
                    for e in range(before.shape[1]):
                        S[i, j] -= before[i, e] * before[j, e]
            conflicts[k, 0] = norm(apart)
            conflicts[k, 1] = _squared(S, apart)
            if conflicts[k, 1] > PATCHES.conflict:
                for i in range(3):
                    for j in range(3):
                        C[i, j] += apart[i] * apart[j]
        for e in range(J.shape[1]):
            turn = (J[3, e], J[4, e], J[5, e])
            shifted = add((J[0, e], J[1, e], J[2, e]), cross(turn, arm))
            turned = cross(turn, normal)
            for i in range(3):
                before[i, e], before[3 + i, e] = shifted[i], turned[i]
        for i in range(6):
            for j in range(6):
                for e in range(J.shape[1]):
                    C[i, j] += before[i, e] * before[j, e]
                contact.covariance[i, j] = C[i, j]
        store(point, contact.point)
        store(normal, contact.normal)
        force = mul(R, vector(patch.force))
        along = dot(force, normal)
        if not measured:
            contact.load[:] = math.nan
            if patch.three:
                store(sub(force, scale(normal, along)), contact.load[:3])
                contact.load[3], contact.load[4] = along, patch.torque
        contact.reason = 0


@inner
def _squared(S: Any, v: Any) -> float:
    """Returns v S⁻¹ v of a 3x3 covariance S and a vector v."""
    a, b, c = vector(S[0]), vector(S[1]), vector(S[2])
    first = cross(b, c)
    determinant = dot(a, first)
    return dot(v, (dot(first, v), dot(cross(c, a), v), dot(cross(a, b), v))) / max(determinant, 1e-300)
