"""Contact sensing in closed form (eq. 7): from wrenches on a fingertip, one or many, to contacts and their covariances.

The object pushes with force F at p, and twists by a local torque along the normal. About the centre of the
ellipsoid pᵀA p = 1 the torque is M = p × F + k A p: four equations for p and k. Bicchi, Salisbury and Brock
(1993) solve them through a quartic in k whose answer is 0/0 where k vanishes. Here, instead:

* With W = √A, q = W p, f = W F, m = |W| W⁻¹ M, κ = |W| k, eq. 7 becomes that of the unit sphere,
  q × f + κ q = m, |q| = 1: W maps the ellipsoid to a sphere.
* c = q·f obeys c κ = f·m and c² - κ² = |f|² - |m|², that is (c + iκ)² = |f|² - |m|² + 2i f·m. One complex
  square root gives both, and the object can only push: Re(c + iκ) < 0. Nothing cancels, and κ = 0 is no
  special case.
* q = (c f + κ m + f × m) / (|f|² + κ²); for κ = 0 this is where the wrench's axis pierces the sphere.

Nothing under- or overflows: a contact's force is 1e-9 N or more, forces and torques are `MAX_LOAD` or less, semi-axes
are 1e-5 to 0.2 m and the sensor is within 1 km, so that |f|² is 1e-17 to 1e21 and |m|² at most 1e38. A wrench that is
none, being weaker, larger or not finite, leads to any numbers; only its reason is used.

No step branches, so that loops of many wrenches are vectorised: they are computed in blocks of `LANES`, column by
column of a flat workspace. Each step is a loop of its own, because the processor overlaps several rounds of a short
loop; one loop of all steps takes 1.4 times as long. A vector of six is a pair of vectors.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np

from handsight._compiled import so3, vec3
from handsight._compiled.jit import entry
from handsight._compiled.vec3 import Mat33, Vec3
from handsight.checks import MAX_LOAD

F = TypeVar("F", bound=Callable[..., Any])
Vec6 = tuple[Vec3, Vec3]

CONTACT = 0.0
FREE = 1.0
OFF_CAP = 2.0
BEYOND_FRICTION = 3.0
INVALID = 4.0
"""The numbers of `handsight.contact.Reason`."""


def lane(function: F) -> F:
    """Compiles a step of one wrench to be inlined into its caller; else the caller's loop would not be vectorised.

    Operations are rounded as written, so that one wrench and many have the same answer to the bit; this costs a
    twentieth of the speed.
    """
    plain = getattr(function, "py_func", function)
    return numba.njit(error_model="numpy", fastmath=False, forceinline=True)(plain)


vector, matrix, store = lane(vec3.vector), lane(vec3.matrix), lane(vec3.store)
add, sub, neg = lane(vec3.add), lane(vec3.sub), lane(vec3.neg)
scale = lane(vec3.scale)
times = lane(vec3.times)
mul = lane(vec3.mul)
tmul = lane(vec3.tmul)
dot = lane(vec3.dot)
cross = lane(vec3.cross)
norm = lane(vec3.norm)
about_normal = lane(so3.about_normal)


class Fingertip(NamedTuple):
    """The numbers of a record FINGERTIP, and constants computed from them."""

    semi_axes: Vec3
    W: Vec3  # reciprocals of the semi-axes: the diagonal of W
    by_moment: Vec3  # the diagonal of |W| W⁻¹, by which torques are multiplied
    volume: float  # 1 / |W|
    cap: float
    friction_squared: float
    min_force_squared: float
    R: Mat33  # rotation of the sensor in the surface's frame
    origin: Vec3  # position of the sensor in the surface's frame [m]


@lane
def unpack_fingertip(record: Any) -> Fingertip:
    """Returns the numbers of a record FINGERTIP in registers."""
    axes = vector(record.semi_axes)
    W = 1.0 / axes[0], 1.0 / axes[1], 1.0 / axes[2]
    product = W[0] * W[1] * W[2]
    by_moment = (product / W[0], product / W[1], product / W[2])
    R = matrix(record.R_surface_sensor)
    friction2, force2 = record.max_friction * record.max_friction, record.min_force * record.min_force
    origin = vector(record.origin_surface)
    return Fingertip(axes, W, by_moment, 1.0 / product, record.cap, friction2, force2, R, origin)


@lane
def _is_load(v: Vec3) -> bool:
    """Returns whether a tip can bear a force [N] or a torque [N m]; False for NaN."""
    return (abs(v[0]) <= MAX_LOAD) & (abs(v[1]) <= MAX_LOAD) & (abs(v[2]) <= MAX_LOAD)


@lane
def wrench_on_surface(force: Vec3, torque: Vec3, tip: Fingertip) -> tuple[float, Vec3, Vec3]:
    """Returns CONTACT, FREE or INVALID, and F and m in the surface's frame about its centre."""
    reason = CONTACT if dot(force, force) >= tip.min_force_squared else FREE
    reason = reason if _is_load(force) & _is_load(torque) else INVALID
    f = mul(tip.R, force)
    moment = add(mul(tip.R, torque), cross(tip.origin, f))
    return reason, f, times(moment, tip.by_moment)


@lane
def solve_push(force: Vec3, m: Vec3, tip: Fingertip) -> tuple[float, float, bool]:
    """Returns c and κ of the push that has that F and m, and whether there is one."""
    f = times(force, tip.W)
    ff = dot(f, f)
    real = ff - dot(m, m)
    half = dot(f, m)
    # The complex root: its larger part by a sum, the other by their product, so nothing cancels.
    larger = np.sqrt(0.5 * (abs(real) + np.sqrt(real * real + 4.0 * half * half)))
    other = half / larger
    c = -larger if real >= 0.0 else -abs(other)
    kappa = -other if real >= 0.0 else (-larger if half >= 0.0 else larger)
    # With a cosine (on the sphere) below 1e-6 the wrench's axis misses the surface.
    return c, kappa, c * c > 1e-12 * ff


@lane
def point_on_sphere(force: Vec3, m: Vec3, c: float, kappa: float, tip: Fingertip) -> Vec3:
    """Returns q, the contact's point on the unit sphere."""
    f = times(force, tip.W)
    along = add(add(scale(f, c), scale(m, kappa)), cross(f, m))
    q = scale(along, 1.0 / (dot(f, f) + kappa * kappa))
    # Of length 1 but for rounding, which one step of Newton's method for 1/√ removes.
    return scale(q, 1.5 - 0.5 * dot(q, q))


@lane
def contact_loads(
    q: Vec3, force: Vec3, c: float, kappa: float, tip: Fingertip
) -> tuple[Vec3, float, float, float]:
    """Returns normal, normal force, local torque, and CONTACT, OFF_CAP or BEYOND_FRICTION."""
    outward = times(q, tip.W)
    steepness = norm(outward)
    inverse = 1.0 / steepness
    normal = scale(outward, -inverse)
    push = -c * inverse
    tangential = sub(force, scale(normal, push))
    beyond = dot(tangential, tangential) > tip.friction_squared * (push * push)
    reason = BEYOND_FRICTION if beyond else CONTACT
    reason = OFF_CAP if q[2] * tip.semi_axes[2] < tip.cap else reason
    return normal, push, -kappa * steepness * tip.volume, reason


@lane
def wrench_to_contact(
    force: Vec3, torque: Vec3, tip: Fingertip
) -> tuple[float, Vec3, Vec3, Vec3, float, float]:
    """Returns reason, point, normal, force, normal force and local torque; without a contact only the reason counts."""
    reason, f, m = wrench_on_surface(force, torque, tip)
    c, kappa, pushes = solve_push(f, m, tip)
    q = point_on_sphere(f, m, c, kappa, tip)
    normal, push, twist, contact_reason = contact_loads(q, f, c, kappa, tip)
    contact_reason = contact_reason if pushes else OFF_CAP
    reason = reason if reason > CONTACT else contact_reason
    return reason, times(q, tip.semi_axes), normal, f, push, twist


@lane
def _tangent_noise(by_moment: Vec3, by_force: Vec3, tip: Fingertip, sigmas: Vec6) -> Vec6:
    """Returns the motion of q along a tangent by one sigma of each number of a reading."""
    m = times(by_moment, tip.by_moment)
    f = add(times(by_force, tip.W), cross(m, tip.origin))
    return times(tmul(tip.R, f), sigmas[0]), times(tmul(tip.R, m), sigmas[1])


@lane
def _dot6(a: Vec6, b: Vec6) -> float:
    return dot(a[0], b[0]) + dot(a[1], b[1])


@lane
def _tangent_step(t: Vec3, normal: Vec3, steepness: float, tip: Fingertip) -> Vec6:
    """Returns the change of point and normal as q moves along the tangent `t`."""
    outward = times(t, tip.W)
    tangential = sub(outward, scale(normal, dot(outward, normal)))
    return times(t, tip.semi_axes), scale(tangential, -1.0 / steepness)


@lane
def covariance_factor(contact: Vec3, push: float, twist: float, tip: Fingertip, sigmas: Vec6) -> Any:
    """Returns two columns (6) whose outer products sum to the covariance of point and normal.

    By the implicit function theorem: on the sphere δq is tangent and κ δq - c q × δq is the tangent part of
    r = δm - q × δf, so δq = (κ P + c [q]×) r / (κ² + c²), P = I - q qᵀ: in the tangent plane it turns and scales.
    """
    q = times(contact, tip.W)
    outward = times(q, tip.W)
    steepness = norm(outward)
    normal = scale(outward, -1.0 / steepness)
    c = -push * steepness
    kappa = -twist / (tip.volume * steepness)
    inverse = 1.0 / (c * c + kappa * kappa)
    c, kappa = c * inverse, kappa * inverse
    _, t, u = about_normal(q)
    v = sub(scale(t, kappa), scale(u, c))
    w = add(scale(u, kappa), scale(t, c))
    # The triangular factor (a, b; 0, d) of the rows' products, by Gram and Schmidt, so that nothing is squared twice.
    row = _tangent_noise(v, w, tip, sigmas)
    other = _tangent_noise(w, neg(v), tip, sigmas)
    a = np.sqrt(_dot6(row, row))
    inverse = 1.0 / a if a > 0.0 else 0.0
    b = _dot6(row, other) * inverse
    s = b * inverse
    rest = sub(other[0], scale(row[0], s)), sub(other[1], scale(row[1], s))
    d = np.sqrt(_dot6(rest, rest))
    g, h = _tangent_step(t, normal, steepness, tip), _tangent_step(u, normal, steepness, tip)
    first = add(scale(g[0], a), scale(h[0], b)) + add(scale(g[1], a), scale(h[1], b))
    return first, scale(h[0], d) + scale(h[1], d)


@lane
def sum_of_products(a: float, b: float, c: float, d: float) -> float:
    """Returns a b + c d, rounded as written whichever kernel calls it."""
    return a * b + c * d


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
        q = _get3(w, AT.q, j)
        c = w[AT.c * LANES + j]
        kappa = w[AT.kappa * LANES + j]
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
    fingertip = unpack_fingertip(tip[0])
    w = np.zeros(AT.total * LANES)
    forces, torques = forces.reshape(-1), torques.reshape(-1)
    n = len(reasons)
    k = 0
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
    fingertip = unpack_fingertip(tip[0])
    noise = _pair(sigmas)
    out = out.reshape(-1)
    n = len(contacts)
    w = np.ones(17 * LANES)
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
                a = w[row * LANES + j]
                b = w[(6 + row) * LANES + j]
                for i in range(6):
                    c = w[i * LANES + j]
                    d = w[(6 + i) * LANES + j]
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
