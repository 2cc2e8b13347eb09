"""The steps from one wrench to a contact and its covariance (eq. 7), each for the callers' loops; no step branches.

The object pushes with force F at p, and twists by a local torque along the normal. About the centre of the
ellipsoid pᵀA p = 1 the torque is M = p × F + k A p: four equations for p and k. Bicchi, Salisbury and Brock
(1993) solve them through a quartic in k whose answer is 0/0 where k vanishes. Here, instead:

* With W = √A, q = W p, f = W F, m = |W| W⁻¹ M, κ = |W| k, eq. 7 becomes that of the unit sphere,
  q × f + κ q = m, |q| = 1: an ellipsoid is a sphere seen through W.
* c = q·f obeys c κ = f·m and c² - κ² = |f|² - |m|², that is (c + iκ)² = |f|² - |m|² + 2i f·m. One complex
  square root gives both, and the object can only push: Re(c + iκ) < 0. Nothing cancels, and κ = 0 is no
  special case.
* q = (c f + κ m + f × m) / (|f|² + κ²); for κ = 0 this is where the wrench's axis pierces the sphere.

`W`, |W| and the like are of `Fingertip`; a vector of six is a pair of vectors.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from handsight._kernels.math import vec3
from handsight._kernels.math.vec3 import Mat33, Vec3
from handsight.checks import MAX_LOAD

F = TypeVar("F", bound=Callable[..., Any])
Vec6 = tuple[Vec3, Vec3]

CONTACT, FREE, OFF_CAP, BEYOND_FRICTION, INVALID = 0.0, 1.0, 2.0, 3.0, 4.0
GRAZING_SQUARED = 1e-12
"""A push counts as one from this squared cosine (on the sphere) on; below, the wrench's axis misses the surface."""
VANISHING = 1e-150
"""A force this much smaller than its torque, in doubles, has no direction left."""
LARGEST = 1.7976931348623157e308
LARGEST_SCALE = 2.0**1022
"""The largest power of two whose reciprocal is a normal double."""


def lane(function: F) -> F:
    """A step of one wrench, put into its caller by force: only then is the caller's loop vectorised.

    Rounded as written, so that one wrench and many have the same answer to the bit, and huge ones one at all: another
    order of the factors would overflow. That costs a twentieth of the speed.
    """
    plain = getattr(function, "py_func", function)
    return numba.njit(error_model="numpy", fastmath=False, forceinline=True)(plain)


vector, matrix, store = lane(vec3.vector), lane(vec3.matrix), lane(vec3.store)
add, sub, neg, scale, times = (
    lane(vec3.add),
    lane(vec3.sub),
    lane(vec3.neg),
    lane(vec3.scale),
    lane(vec3.times),
)
dot, cross, norm, mul, tmul = (
    lane(vec3.dot),
    lane(vec3.cross),
    lane(vec3.norm),
    lane(vec3.mul),
    lane(vec3.tmul),
)


@intrinsic
def _power_of_two(context: Any, value: Any) -> Any:
    """The largest one not above a positive normal number: its exponent's bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.bitcast(arguments[0], ir.IntType(64))
        return builder.bitcast(builder.and_(bits, ir.Constant(ir.IntType(64), 0x7FF << 52)), ir.DoubleType())

    return types.float64(types.float64), generate


@intrinsic
def _reciprocal(context: Any, power: Any) -> Any:
    """Of a power of two up to LARGEST_SCALE."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.bitcast(arguments[0], ir.IntType(64))
        return builder.bitcast(builder.sub(ir.Constant(ir.IntType(64), 2046 << 52), bits), ir.DoubleType())

    return types.float64(types.float64), generate


@lane
def _size(value: float) -> float:
    """A power of two near a positive number, so that dividing by it is exact and leaves no extreme."""
    power = _power_of_two(value)
    return power if power < LARGEST_SCALE else LARGEST_SCALE


@lane
def _larger(a: float, b: float) -> float:
    return a if a > b else b


@lane
def _largest(v: Vec3) -> float:
    return _larger(_larger(abs(v[0]), abs(v[1])), abs(v[2]))


@lane
def _is_load(v: Vec3) -> bool:
    """Whether it is a force [N] or a torque [N m] that a fingertip can feel; NaN is none."""
    return (abs(v[0]) <= MAX_LOAD) & (abs(v[1]) <= MAX_LOAD) & (abs(v[2]) <= MAX_LOAD)


@lane
def rescaled(value: float, size: float) -> float:
    """Their product, kept finite where only it overflows."""
    product = value * size
    product = product if product < LARGEST else LARGEST
    return product if product > -LARGEST else -LARGEST


class Fingertip(NamedTuple):
    """A fingertip's numbers, and what follows from them."""

    semi_axes: Vec3
    W: Vec3
    """Their reciprocals."""
    by_moment: Vec3
    """|W| / W: what torques are multiplied by."""
    volume: float
    """1 / |W|."""
    cap: float
    friction_squared: float
    unit: float
    """A power of two: forces are compared squared, and their squares must neither under- nor overflow."""
    least_squared: float
    """(least force times that)²."""
    R: Mat33
    origin: Vec3
    """With R the pose of the sensor in the surface's frame."""


@lane
def fingertip(record: Any) -> Fingertip:
    """A record's numbers in registers."""
    axes = vector(record.semi_axes)
    W = 1.0 / axes[0], 1.0 / axes[1], 1.0 / axes[2]
    product = W[0] * W[1] * W[2]
    unit = _reciprocal(_size(record.min_force))
    return Fingertip(
        axes,
        W,
        (product / W[0], product / W[1], product / W[2]),
        1.0 / product,
        record.cap,
        record.max_friction * record.max_friction,
        unit,
        (record.min_force * unit) * (record.min_force * unit),
        matrix(record.R_surface_sensor),
        vector(record.origin_surface),
    )


@lane
def prepared(force: Vec3, torque: Vec3, tip: Fingertip) -> Any:
    """CONTACT or what speaks against one; the wrench's size; force and torque over it along the surface's axes, about
    its centre, the torque times |W| / W."""
    size = _size(_larger(_largest(force), _largest(torque)))
    compared = scale(force, tip.unit)
    reason = CONTACT if dot(compared, compared) >= tip.least_squared else FREE
    reason = reason if _is_load(force) & _is_load(torque) else INVALID
    shrink = _reciprocal(size)
    f = mul(tip.R, scale(force, shrink))
    moment = add(mul(tip.R, scale(torque, shrink)), cross(tip.origin, f))
    return reason, size, f, times(moment, tip.by_moment)


@lane
def root(force: Vec3, m: Vec3, tip: Fingertip) -> tuple[float, float, bool]:
    """c, κ and whether that is a push; of a `prepared` wrench."""
    f = times(force, tip.W)
    ff = dot(f, f)
    real = ff - dot(m, m)
    half = dot(f, m)
    # The complex root: its larger part by a sum, the other by their product, so nothing cancels.
    larger = np.sqrt(0.5 * (abs(real) + np.sqrt(real * real + 4.0 * half * half)))
    other = half / larger
    c = -larger if real >= 0.0 else -abs(other)
    kappa = -other if real >= 0.0 else (-larger if half >= 0.0 else larger)
    return c, kappa, (c < -VANISHING) & (c * c > GRAZING_SQUARED * ff)


@lane
def on_sphere(force: Vec3, m: Vec3, c: float, kappa: float, tip: Fingertip) -> Vec3:
    """q."""
    f = times(force, tip.W)
    along = add(add(scale(f, c), scale(m, kappa)), cross(f, m))
    q = scale(along, 1.0 / (dot(f, f) + kappa * kappa))
    # Of length 1 but for rounding: a step of Newton's towards 1/√ takes the rest away.
    return scale(q, 1.5 - 0.5 * dot(q, q))


@lane
def judged(q: Vec3, force: Vec3, c: float, kappa: float, tip: Fingertip) -> Any:
    """Normal, normal force and local torque over the wrench's size; CONTACT, or why the tip cannot have felt it."""
    outward = times(q, tip.W)
    steepness = norm(outward)
    flat = 1.0 / steepness
    normal, push = scale(outward, -flat), -c * flat
    tangential = sub(force, scale(normal, push))
    beyond = dot(tangential, tangential) > tip.friction_squared * (push * push)
    reason = BEYOND_FRICTION if beyond else CONTACT
    reason = OFF_CAP if q[2] * tip.semi_axes[2] < tip.cap else reason
    return normal, push, -kappa * steepness * tip.volume, reason


@lane
def _tangents(q: Vec3) -> tuple[Vec3, Vec3]:
    """Two unit vectors that make a right-handed frame with `q` (Duff et al. 2017)."""
    sign = -1.0 if q[2] < 0.0 else 1.0
    a = -1.0 / (sign + q[2])
    b = q[0] * q[1] * a
    return (1.0 + sign * q[0] * q[0] * a, sign * b, -sign * q[0]), (b, sign + q[1] * q[1] * a, -q[1])


@lane
def _by_noise(by_moment: Vec3, by_force: Vec3, tip: Fingertip, sigmas: Vec6) -> Vec6:
    """What one sigma of each number of a reading does to a step along a tangent."""
    m = times(by_moment, tip.by_moment)
    f = add(times(by_force, tip.W), cross(m, tip.origin))
    return times(tmul(tip.R, f), sigmas[0]), times(tmul(tip.R, m), sigmas[1])


@lane
def _dot6(a: Vec6, b: Vec6) -> float:
    return dot(a[0], b[0]) + dot(a[1], b[1])


@lane
def _triangle(a: Vec6, b: Vec6) -> tuple[float, float, float]:
    """The triangular factor of the products of two rows; by Gram and Schmidt, so nothing is squared twice."""
    first = np.sqrt(_dot6(a, a))
    inverse = 1.0 / first if first > 0.0 else 0.0
    across = _dot6(a, b) * inverse
    s = across * inverse
    rest = sub(b[0], scale(a[0], s)), sub(b[1], scale(a[1], s))
    return first, across, np.sqrt(_dot6(rest, rest))


@lane
def _step(t: Vec3, normal: Vec3, steepness: float, tip: Fingertip) -> Vec6:
    """How point and normal change as q moves along the tangent `t`."""
    outward = times(t, tip.W)
    flat = sub(outward, scale(normal, dot(outward, normal)))
    return times(t, tip.semi_axes), scale(flat, -1.0 / steepness)


@lane
def spread(contact: Vec3, push: float, twist: float, tip: Fingertip, sigmas: Vec6) -> Any:
    """Two columns (6) whose products with themselves sum to the covariance of point and normal.

    By the implicit function theorem: on the sphere δq is tangent and κ δq - c q × δq is the tangent part of
    r = δm - q × δf, so δq = (κ P + c [q]×) r / (κ² + c²), P = I - q qᵀ: in the tangent plane it turns and scales.
    """
    shrink = _reciprocal(_size(_larger(push, abs(twist))))
    q = times(contact, tip.W)
    outward = times(q, tip.W)
    steepness = norm(outward)
    normal = scale(outward, -1.0 / steepness)
    c, kappa = -push * shrink * steepness, -twist * shrink / (tip.volume * steepness)
    size = shrink / (c * c + kappa * kappa)
    c, kappa = c * size, kappa * size
    t, u = _tangents(q)
    v = sub(scale(t, kappa), scale(u, c))
    w = add(scale(u, kappa), scale(t, c))
    a, b, d = _triangle(_by_noise(v, w, tip, sigmas), _by_noise(w, neg(v), tip, sigmas))
    g, h = _step(t, normal, steepness, tip), _step(u, normal, steepness, tip)
    first = add(scale(g[0], a), scale(h[0], b)) + add(scale(g[1], a), scale(h[1], b))
    return first, scale(h[0], d) + scale(h[1], d)


@lane
def sum_of_products(a: float, b: float, c: float, d: float) -> float:
    """a b + c d."""
    return a * b + c * d


@lane
def wrench_to_contact(force: Vec3, torque: Vec3, tip: Fingertip) -> Any:
    """Reason, point, normal, force, normal force and local torque of one wrench; only the first where it is none."""
    reason, size, f, m = prepared(force, torque, tip)
    c, kappa, pushes = root(f, m, tip)
    q = on_sphere(f, m, c, kappa, tip)
    normal, push, twist, against = judged(q, f, c, kappa, tip)
    against = against if pushes else OFF_CAP
    reason = reason if reason > CONTACT else against
    pushing = rescaled(f[0], size), rescaled(f[1], size), rescaled(f[2], size)
    return reason, times(q, tip.semi_axes), normal, pushing, rescaled(push, size), rescaled(twist, size)
