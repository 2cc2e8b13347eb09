"""Symmetric matrices of up to six unknowns: Cholesky factors, solutions and eigenvectors."""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner


@inner
def factor(matrix: Any, n: int, ridge: float, out: Any) -> bool:
    """Writes the Cholesky factor of a matrix (n, n) plus `ridge` times the identity.

    Returns False where that sum is not positive definite. Only the lower triangle of the matrix is read. The diagonal
    of `out` holds the reciprocals of the factor's.
    """
    for i in range(n):
        for j in range(i):
            value = matrix[i, j]
            for k in range(j):
                value -= out[i, k] * out[j, k]
            out[i, j] = value * out[j, j]
        value = matrix[i, i] + ridge
        for k in range(i):
            value -= out[i, k] * out[i, k]
        if not value > 1e-300:
            return False
        out[i, i] = 1.0 / np.sqrt(value)
    return True


@inner
def solve(factored: Any, n: int, right: Any, out: Any) -> None:
    """Writes to `out` (n) the solution x of M x = `right`, where M (n, n) was factored by `factor`."""
    for i in range(n):
        value = right[i]
        for k in range(i):
            value -= factored[i, k] * out[k]
        out[i] = value * factored[i, i]
    for i in range(n - 1, -1, -1):
        value = out[i]
        for k in range(i + 1, n):
            value -= factored[k, i] * out[k]
        out[i] = value * factored[i, i]


@inner
def eigen(matrix: Any, values: Any, vectors: Any) -> None:
    """Writes the eigenvalues (6), in no order, and the eigenvectors, as columns, of a symmetric matrix (6, 6).

    The matrix is overwritten (Jacobi's method).
    """
    for i in range(6):
        for j in range(6):
            vectors[i, j] = 1.0 if i == j else 0.0
    for _ in range(40):
        clean = True
        for p in range(5):
            for q in range(p + 1, 6):
                entry = matrix[p, q]
                # Relative to the two diagonal entries, so that eigenvalues of very different size keep their digits.
                if entry * entry > 1e-31 * abs(matrix[p, p] * matrix[q, q]):
                    clean = False
                    _rotate(matrix, p, q, vectors)
        if clean:
            break
    for i in range(6):
        values[i] = matrix[i, i]


@inner
def _rotate(matrix: Any, p: int, q: int, vectors: Any) -> None:
    """Applies the rotation that makes entry (p, q) of the matrix zero."""
    entry = matrix[p, q]
    theta = (matrix[q, q] - matrix[p, p]) / (2 * entry)
    t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    matrix[p, p] -= t * entry
    matrix[q, q] += t * entry
    matrix[p, q] = matrix[q, p] = 0.0
    for k in range(6):
        if k != p and k != q:
            a, b = matrix[k, p], matrix[k, q]
            matrix[k, p] = matrix[p, k] = c * a - s * b
            matrix[k, q] = matrix[q, k] = s * a + c * b
        a, b = vectors[k, p], vectors[k, q]
        vectors[k, p] = c * a - s * b
        vectors[k, q] = s * a + c * b


@inner
def scale_turns(matrix: Any, by: float, out: Any) -> None:
    """Fills `out` (6, 6) with a matrix by (δp, δθ), the rows and columns of δθ multiplied by a number."""
    for i in range(6):
        for j in range(6):
            out[i, j] = matrix[i, j] * ((1.0 if i < 3 else by) * (1.0 if j < 3 else by))


@inner
def in_metres(information: Any, radius: float, out: Any) -> None:
    """Fills `out` (6, 6) with an information by (δp, δθ) as one by (δp, radius δθ) [1/m²]."""
    scale_turns(information, 1 / radius, out)


@inner
def from_eigen(values: Any, vectors: Any, turn: float, out: Any) -> None:
    """Fills `out` (6, 6) with V diag(values) Vᵀ, the rows and columns of δθ multiplied by `turn`."""
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                total += vectors[i, k] * values[k] * vectors[j, k]
            out[i, j] = total * ((1.0 if i < 3 else turn) * (1.0 if j < 3 else turn))
