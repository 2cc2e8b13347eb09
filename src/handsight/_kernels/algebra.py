"""Small linear algebra on flat arrays: 6 x 6, row by row.

Twins: `numpy.linalg.solve`, `inv`, `eigh`.
"""

from typing import Any

import numpy as np

from handsight._kernels.compiled import inner

TINY = 1e-300


@inner
def factor(matrix: Any, n: int, stride: int, ridge: float, out: Any) -> bool:
    """Cholesky's factor of the matrix, its lower triangle read, plus `ridge` on the diagonal; whether there is one.

    Rows of the matrix begin every `stride` numbers. The diagonal of `out` holds the factor's reciprocals.
    """
    for i in range(n):
        for j in range(i):
            value = matrix[stride * i + j]
            for k in range(j):
                value -= out[n * i + k] * out[n * j + k]
            out[n * i + j] = value * out[n * j + j]
        value = matrix[stride * i + i] + ridge
        for k in range(i):
            value -= out[n * i + k] * out[n * i + k]
        if not value > TINY:
            return False
        out[n * i + i] = 1.0 / np.sqrt(value)
    return True


@inner
def solved(factored: Any, n: int, right: Any, at: int, out: Any) -> None:
    """`out` (n): the solution for the right side that begins at `right[at]`."""
    for i in range(n):
        value = right[at + i]
        for k in range(i):
            value -= factored[n * i + k] * out[k]
        out[i] = value * factored[n * i + i]
    for i in range(n - 1, -1, -1):
        value = out[i]
        for k in range(i + 1, n):
            value -= factored[n * k + i] * out[k]
        out[i] = value * factored[n * i + i]


@inner
def inverted(factored: Any, n: int, out: Any, work: Any) -> None:
    """`out` (n, n): the inverse of a matrix given by its factor; `work` (2 n)."""
    unit, column = work[:n], work[n : 2 * n]
    for j in range(n):
        for i in range(n):
            unit[i] = 1.0 if i == j else 0.0
        solved(factored, n, unit, 0, column)
        for i in range(n):
            out[n * i + j] = column[i]


@inner
def eigen(matrix: Any, n: int, values: Any, vectors: Any) -> None:
    """Eigenvalues, not in order, and eigenvectors as columns of a symmetric matrix, which is used up (Jacobi)."""
    for i in range(n):
        for j in range(n):
            vectors[n * i + j] = 1.0 if i == j else 0.0
    for _ in range(40):
        clean = True
        for p in range(n - 1):
            for q in range(p + 1, n):
                entry = matrix[n * p + q]
                # Relative to the two it joins: eigenvalues of very different size keep their digits.
                if entry * entry > 1e-31 * abs(matrix[n * p + p] * matrix[n * q + q]):
                    clean = False
                    _rotate(matrix, n, p, q, vectors)
        if clean:
            break
    for i in range(n):
        values[i] = matrix[n * i + i]


@inner
def _rotate(matrix: Any, n: int, p: int, q: int, vectors: Any) -> None:
    """One rotation that clears entry (p, q)."""
    entry = matrix[n * p + q]
    theta = (matrix[n * q + q] - matrix[n * p + p]) / (2 * entry)
    t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    matrix[n * p + p] -= t * entry
    matrix[n * q + q] += t * entry
    matrix[n * p + q] = matrix[n * q + p] = 0.0
    for k in range(n):
        if k not in (p, q):
            a, b = matrix[n * k + p], matrix[n * k + q]
            matrix[n * k + p] = matrix[n * p + k] = c * a - s * b
            matrix[n * k + q] = matrix[n * q + k] = s * a + c * b
        a, b = vectors[n * k + p], vectors[n * k + q]
        vectors[n * k + p], vectors[n * k + q] = c * a - s * b, s * a + c * b
