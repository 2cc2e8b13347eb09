"""The steps from one wrench to a contact and its covariance (eq. 7), each for the callers' loops.

Twin: `handsight.contact._sensing_plain`, where the method is explained. In short, q is the point on the unit sphere
that the tip is seen as, f and m the force and torque there, c = q·f, κ the local torque there. No step branches.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

F = TypeVar("F", bound=Callable[..., Any])

# A fingertip, as `handsight.contact.fingertip` packs it.
INVERSE, AXES, MOMENTS, VOLUME = 0, 3, 6, 9  # W = 1/a, a, |W| a, 1/|W|
CAP, FRICTION = 10, 11  # least z [m]; largest (tangential / normal)²
FORCE_UNIT, LEAST_FORCE = 12, 13  # a power of two; (least force times that)²
ROTATION, ORIGIN = 14, 23  # of the sensor in the surface's frame
TIP = 26

CONTACT, FREE, OFF_CAP, BEYOND_FRICTION, INVALID = 0.0, 1.0, 2.0, 3.0, 4.0
GRAZING_SQUARED = 1e-12
VANISHING = 1e-150
LARGEST = 1.7976931348623157e308
LARGEST_SCALE = 2.0**1022
"""The largest power of two whose reciprocal is a normal double."""


def lane(function: F) -> F:
    """A step of one wrench, put into its caller by force: only then is the caller's loop vectorised.

    Rounded as written, so that one wrench and many have the same answer to the bit, and huge ones one at all: another
    order of the factors would overflow. That costs a twentieth of the speed.
    """
    return numba.njit(error_model="numpy", fastmath=False, forceinline=True)(function)


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
def _more(a: float, b: float) -> float:
    return a if a > b else b


@lane
def rescaled(value: float, scale: float) -> float:
    """Their product, kept finite where only it overflows."""
    product = value * scale
    product = product if product < LARGEST else LARGEST
    return product if product > -LARGEST else -LARGEST


@lane
def prepared(F: Any, M: Any, tip: Any) -> Any:
    """Whether the wrench is worth a look; its scale; force and torque over it along the surface's axes, about its
    centre, the torque times |W| / W."""
    largest = _more(
        _more(_more(abs(F[0]), abs(F[1])), _more(abs(F[2]), abs(M[0]))), _more(abs(M[1]), abs(M[2]))
    )
    scale = _power_of_two(largest)
    scale = scale if scale < LARGEST_SCALE else LARGEST_SCALE
    valid = (abs(F[0]) <= LARGEST) & (abs(F[1]) <= LARGEST) & (abs(F[2]) <= LARGEST)
    valid &= (abs(M[0]) <= LARGEST) & (abs(M[1]) <= LARGEST) & (abs(M[2]) <= LARGEST)
    unit = tip[FORCE_UNIT]
    x, y, z = F[0] * unit, F[1] * unit, F[2] * unit
    reason = CONTACT if x * x + y * y + z * z >= tip[LEAST_FORCE] else FREE
    reason = reason if valid else INVALID
    shrink = _reciprocal(scale)
    x, y, z = F[0] * shrink, F[1] * shrink, F[2] * shrink
    R = ROTATION
    fx = tip[R] * x + tip[R + 1] * y + tip[R + 2] * z
    fy = tip[R + 3] * x + tip[R + 4] * y + tip[R + 5] * z
    fz = tip[R + 6] * x + tip[R + 7] * y + tip[R + 8] * z
    x, y, z = M[0] * shrink, M[1] * shrink, M[2] * shrink
    px, py, pz = tip[ORIGIN], tip[ORIGIN + 1], tip[ORIGIN + 2]
    mx = tip[R] * x + tip[R + 1] * y + tip[R + 2] * z + (py * fz - pz * fy)
    my = tip[R + 3] * x + tip[R + 4] * y + tip[R + 5] * z + (pz * fx - px * fz)
    mz = tip[R + 6] * x + tip[R + 7] * y + tip[R + 8] * z + (px * fy - py * fx)
    return reason, scale, (fx, fy, fz), (mx * tip[MOMENTS], my * tip[MOMENTS + 1], mz * tip[MOMENTS + 2])


@lane
def root(f: Any, m: Any, tip: Any) -> Any:
    """c, κ and whether that is a push; `f` (3) is not yet times W."""
    fx, fy, fz = f[0] * tip[INVERSE], f[1] * tip[INVERSE + 1], f[2] * tip[INVERSE + 2]
    ff = fx * fx + fy * fy + fz * fz
    real = ff - (m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    half = fx * m[0] + fy * m[1] + fz * m[2]
    # The complex root: its larger part by a sum, the other by their product, so nothing cancels.
    larger = np.sqrt(0.5 * (abs(real) + np.sqrt(real * real + 4.0 * half * half)))
    other = half / larger
    c = -larger if real >= 0.0 else -abs(other)
    kappa = -other if real >= 0.0 else (-larger if half >= 0.0 else larger)
    return c, kappa, (c < -VANISHING) & (c * c > GRAZING_SQUARED * ff)


@lane
def foot(f: Any, m: Any, c: float, kappa: float, tip: Any) -> Any:
    """q."""
    fx, fy, fz = f[0] * tip[INVERSE], f[1] * tip[INVERSE + 1], f[2] * tip[INVERSE + 2]
    size = 1.0 / (fx * fx + fy * fy + fz * fz + kappa * kappa)
    x = (c * fx + kappa * m[0] + (fy * m[2] - fz * m[1])) * size
    y = (c * fy + kappa * m[1] + (fz * m[0] - fx * m[2])) * size
    z = (c * fz + kappa * m[2] + (fx * m[1] - fy * m[0])) * size
    # Of length 1 but for rounding: a step of Newton's towards 1/√ takes the rest away.
    mend = 1.5 - 0.5 * (x * x + y * y + z * z)
    return x * mend, y * mend, z * mend


@lane
def landed(q: Any, f: Any, c: float, kappa: float, tip: Any) -> Any:
    """Normal, normal force and local torque, over the scale; a reason against it or CONTACT."""
    x, y, z = q[0] * tip[INVERSE], q[1] * tip[INVERSE + 1], q[2] * tip[INVERSE + 2]
    steepness = np.sqrt(x * x + y * y + z * z)
    flat = 1.0 / steepness
    x, y, z, push = -x * flat, -y * flat, -z * flat, -c * flat
    sx, sy, sz = f[0] - push * x, f[1] - push * y, f[2] - push * z
    reason = BEYOND_FRICTION if sx * sx + sy * sy + sz * sz > tip[FRICTION] * (push * push) else CONTACT
    reason = OFF_CAP if q[2] * tip[AXES + 2] < tip[CAP] else reason
    return (x, y, z), push, -kappa * steepness * tip[VOLUME], reason


@lane
def _tangents(q: Any) -> Any:
    """Two unit vectors that make a right-handed frame with `q` (Duff et al. 2017)."""
    sign = -1.0 if q[2] < 0.0 else 1.0
    a = -1.0 / (sign + q[2])
    b = q[0] * q[1] * a
    return (1.0 + sign * q[0] * q[0] * a, sign * b, -sign * q[0]), (b, sign + q[1] * q[1] * a, -q[1])


@lane
def _gain(by_moment: Any, by_force: Any, tip: Any, sigmas: Any) -> Any:
    """(6) what one sigma of each reading does to a step along a tangent."""
    R = ROTATION
    mx, my, mz = by_moment[0] * tip[MOMENTS], by_moment[1] * tip[MOMENTS + 1], by_moment[2] * tip[MOMENTS + 2]
    px, py, pz = tip[ORIGIN], tip[ORIGIN + 1], tip[ORIGIN + 2]
    fx = by_force[0] * tip[INVERSE] + (my * pz - mz * py)
    fy = by_force[1] * tip[INVERSE + 1] + (mz * px - mx * pz)
    fz = by_force[2] * tip[INVERSE + 2] + (mx * py - my * px)
    return (
        (fx * tip[R] + fy * tip[R + 3] + fz * tip[R + 6]) * sigmas[0],
        (fx * tip[R + 1] + fy * tip[R + 4] + fz * tip[R + 7]) * sigmas[1],
        (fx * tip[R + 2] + fy * tip[R + 5] + fz * tip[R + 8]) * sigmas[2],
        (mx * tip[R] + my * tip[R + 3] + mz * tip[R + 6]) * sigmas[3],
        (mx * tip[R + 1] + my * tip[R + 4] + mz * tip[R + 7]) * sigmas[4],
        (mx * tip[R + 2] + my * tip[R + 5] + mz * tip[R + 8]) * sigmas[5],
    )


@lane
def _dot(a: Any, b: Any) -> Any:
    return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]) + (a[4] * b[4] + a[5] * b[5])


@lane
def _triangle(a: Any, b: Any) -> Any:
    """The triangular factor of the products of two rows (6); by Gram and Schmidt, so nothing is squared twice."""
    first = np.sqrt(_dot(a, a))
    inverse = 1.0 / first if first > 0.0 else 0.0
    across = _dot(a, b) * inverse
    s = across * inverse
    rest = (
        b[0] - s * a[0],
        b[1] - s * a[1],
        b[2] - s * a[2],
        b[3] - s * a[3],
        b[4] - s * a[4],
        b[5] - s * a[5],
    )
    return first, across, np.sqrt(_dot(rest, rest))


@lane
def _step(t: Any, normal: Any, steepness: float, tip: Any) -> Any:
    """(6) how point and normal change as q moves along the tangent `t`."""
    x, y, z = t[0] * tip[INVERSE], t[1] * tip[INVERSE + 1], t[2] * tip[INVERSE + 2]
    along = x * normal[0] + y * normal[1] + z * normal[2]
    s = -1.0 / steepness
    return (
        t[0] * tip[AXES],
        t[1] * tip[AXES + 1],
        t[2] * tip[AXES + 2],
        (x - along * normal[0]) * s,
        (y - along * normal[1]) * s,
        (z - along * normal[2]) * s,
    )


@lane
def spread(point: Any, push: float, twist: float, tip: Any, sigmas: Any) -> Any:
    """Two columns (6) whose products with themselves sum to the covariance.

    In the tangent plane of the sphere, δq = V (δm - q × δf) with a V that turns and scales, and so does V q×.
    """
    scale = _power_of_two(_more(push, abs(twist)))
    shrink = _reciprocal(scale if scale < LARGEST_SCALE else LARGEST_SCALE)
    q = (point[0] * tip[INVERSE], point[1] * tip[INVERSE + 1], point[2] * tip[INVERSE + 2])
    x, y, z = q[0] * tip[INVERSE], q[1] * tip[INVERSE + 1], q[2] * tip[INVERSE + 2]
    steepness = np.sqrt(x * x + y * y + z * z)
    normal = (-x / steepness, -y / steepness, -z / steepness)
    c, kappa = -push * shrink * steepness, -twist * shrink / (tip[VOLUME] * steepness)
    size = shrink / (c * c + kappa * kappa)
    c, kappa = c * size, kappa * size
    t, u = _tangents(q)
    v = (kappa * t[0] - c * u[0], kappa * t[1] - c * u[1], kappa * t[2] - c * u[2])
    w = (kappa * u[0] + c * t[0], kappa * u[1] + c * t[1], kappa * u[2] + c * t[2])
    a, b, d = _triangle(_gain(v, w, tip, sigmas), _gain(w, (-v[0], -v[1], -v[2]), tip, sigmas))
    g, h = _step(t, normal, steepness, tip), _step(u, normal, steepness, tip)
    first = (a * g[0] + b * h[0], a * g[1] + b * h[1], a * g[2] + b * h[2],
             a * g[3] + b * h[3], a * g[4] + b * h[4], a * g[5] + b * h[5])  # fmt: skip
    return first, (d * h[0], d * h[1], d * h[2], d * h[3], d * h[4], d * h[5])


@lane
def sum_of_products(a: float, b: float, c: float, d: float) -> float:
    return a * b + c * d
