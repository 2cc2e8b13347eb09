"""Three-vectors as tuples and 3x3 matrices as tuples of three rows, so that kernels read like their formulas.

Tuples are kept in registers, and nothing is allocated. The functions of vectors call no other ones, so that
`touch.sensing` can compile them in its own way (rounded as written).
"""

from typing import TypeAlias

import numpy as np

from handsight._compiled.jit import inner

Vec3: TypeAlias = tuple[float, float, float]
Mat33: TypeAlias = tuple[Vec3, Vec3, Vec3]
Pose = tuple[Mat33, Vec3]
"""R and p of a pose, such as T_palm_object."""


@inner
def vector(x: np.ndarray) -> Vec3:
    """Returns the first three numbers of an array."""
    return x[0], x[1], x[2]


@inner
def matrix(x: np.ndarray) -> Mat33:
    """Returns the upper left 3x3 of an array, such as the rotation of a pose (4, 4)."""
    return (x[0, 0], x[0, 1], x[0, 2]), (x[1, 0], x[1, 1], x[1, 2]), (x[2, 0], x[2, 1], x[2, 2])


@inner
def block(x: np.ndarray, i: int, j: int) -> Mat33:
    """Returns the 3x3 of an array whose first entry is at row i and column j."""
    return (
        (x[i, j], x[i, j + 1], x[i, j + 2]),
        (x[i + 1, j], x[i + 1, j + 1], x[i + 1, j + 2]),
        (x[i + 2, j], x[i + 2, j + 1], x[i + 2, j + 2]),
    )


@inner
def store(v: Vec3, out: np.ndarray) -> None:
    """Writes a vector to the first three numbers of an array."""
    out[0], out[1], out[2] = v


@inner
def store33(M: Mat33, out: np.ndarray) -> None:
    """Writes a matrix to the upper left of an array."""
    out[0, 0], out[0, 1], out[0, 2] = M[0]
    out[1, 0], out[1, 1], out[1, 2] = M[1]
    out[2, 0], out[2, 1], out[2, 2] = M[2]


@inner
def add(a: Vec3, b: Vec3) -> Vec3:
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def sub(a: Vec3, b: Vec3) -> Vec3:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def neg(a: Vec3) -> Vec3:
    """-a."""
    return -a[0], -a[1], -a[2]


@inner
def scale(a: Vec3, s: float) -> Vec3:
    """a s."""
    return a[0] * s, a[1] * s, a[2] * s


@inner
def times(a: Vec3, b: Vec3) -> Vec3:
    """diag(a) b."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inner
def dot(a: Vec3, b: Vec3) -> float:
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def cross(a: Vec3, b: Vec3) -> Vec3:
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def skew(a: Vec3) -> Mat33:
    """[a]x, with [a]x b = a x b."""
    return (0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)


@inner
def norm(a: Vec3) -> float:
    """|a|."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@inner
def outer(a: Vec3, b: Vec3) -> Mat33:
    """a bᵀ."""
    return scale(b, a[0]), scale(b, a[1]), scale(b, a[2])


@inner
def mul(M: Mat33, v: Vec3) -> Vec3:
    """M v."""
    return (
        M[0][0] * v[0] + M[0][1] * v[1] + M[0][2] * v[2],
        M[1][0] * v[0] + M[1][1] * v[1] + M[1][2] * v[2],
        M[2][0] * v[0] + M[2][1] * v[1] + M[2][2] * v[2],
    )


@inner
def tmul(M: Mat33, v: Vec3) -> Vec3:
    """Mᵀ v."""
    return (
        M[0][0] * v[0] + M[1][0] * v[1] + M[2][0] * v[2],
        M[0][1] * v[0] + M[1][1] * v[1] + M[2][1] * v[2],
        M[0][2] * v[0] + M[1][2] * v[1] + M[2][2] * v[2],
    )


@inner
def apply(pose: tuple[Mat33, Vec3], v: Vec3) -> Vec3:
    """R v + p, of a pose (R, p)."""
    return add(mul(pose[0], v), pose[1])


@inner
def apply_inverse(pose: tuple[Mat33, Vec3], v: Vec3) -> Vec3:
    """Rᵀ (v - p), of a pose (R, p)."""
    return tmul(pose[0], sub(v, pose[1]))


@inner
def transpose(M: Mat33) -> Mat33:
    """Mᵀ."""
    return (M[0][0], M[1][0], M[2][0]), (M[0][1], M[1][1], M[2][1]), (M[0][2], M[1][2], M[2][2])


@inner
def matmul(A: Mat33, B: Mat33) -> Mat33:
    """A B."""
    return tmul(B, A[0]), tmul(B, A[1]), tmul(B, A[2])


@inner
def add33(A: Mat33, B: Mat33) -> Mat33:
    """A + B."""
    return add(A[0], B[0]), add(A[1], B[1]), add(A[2], B[2])


@inner
def sub33(A: Mat33, B: Mat33) -> Mat33:
    """A - B."""
    return sub(A[0], B[0]), sub(A[1], B[1]), sub(A[2], B[2])


@inner
def scale33(A: Mat33, s: float) -> Mat33:
    """A s."""
    return scale(A[0], s), scale(A[1], s), scale(A[2], s)
