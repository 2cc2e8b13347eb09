"""Rows of evidence to normal equations (7, 8): Hessian, gradient in row and column 6, and the cost where these meet.

A row has seven numbers: the six derivatives of a residual, and the residual. Rows are written out one by one, because a
loop would look up which row of a tuple is meant each time.
"""

from typing import Any

from handsight._compiled.jit import inner

Row = tuple[float, float, float, float, float, float, float]
Three = tuple[Row, Row, Row]


@inner
def add_row(weight: float, row: Row, equations: Any) -> None:
    """Adds a row with its weight."""
    _add_product(row, scaled(row, weight), equations)


@inner
def add_equal_rows(weight: float, rows: Three, equations: Any) -> None:
    """Adds three rows of one weight."""
    weighted = scaled(rows[0], weight), scaled(rows[1], weight), scaled(rows[2], weight)
    _add_products(rows, weighted, equations)


@inner
def add_three_rows(weight: Any, rows: Three, equations: Any) -> None:
    """Adds rows with the inverse of their covariance (3, 3)."""
    weighted = _mixed(weight[0], rows), _mixed(weight[1], rows), _mixed(weight[2], rows)
    _add_products(rows, weighted, equations)


@inner
def add_four_rows(weight: Any, first: Row, rest: Three, equations: Any) -> None:
    """Adds a row and three more with the inverse of their covariance (4, 4)."""
    weighted_first = _sum(scaled(first, weight[0, 0]), _mixed(weight[0, 1:], rest))
    weighted = (
        _sum(scaled(first, weight[1, 0]), _mixed(weight[1, 1:], rest)),
        _sum(scaled(first, weight[2, 0]), _mixed(weight[2, 1:], rest)),
        _sum(scaled(first, weight[3, 0]), _mixed(weight[3, 1:], rest)),
    )
    _add_product(first, weighted_first, equations)
    _add_products(rest, weighted, equations)


@inner
def add_six_rows(weight: Any, first: Three, last: Three, equations: Any) -> None:
    """Adds rows with the inverse of their covariance (6, 6)."""
    weighted_first = (
        _sum(_mixed(weight[0], first), _mixed(weight[0, 3:], last)),
        _sum(_mixed(weight[1], first), _mixed(weight[1, 3:], last)),
        _sum(_mixed(weight[2], first), _mixed(weight[2, 3:], last)),
    )
    weighted_last = (
        _sum(_mixed(weight[3], first), _mixed(weight[3, 3:], last)),
        _sum(_mixed(weight[4], first), _mixed(weight[4, 3:], last)),
        _sum(_mixed(weight[5], first), _mixed(weight[5, 3:], last)),
    )
    _add_products(first, weighted_first, equations)
    _add_products(last, weighted_last, equations)


@inner
def scaled(row: Row, by: float) -> Row:
    """Returns a row multiplied by a number."""
    return row[0] * by, row[1] * by, row[2] * by, row[3] * by, row[4] * by, row[5] * by, row[6] * by


@inner
def _sum(a: Row, b: Row) -> Row:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6]


@inner
def _mixed(weights: Any, rows: Three) -> Row:
    """Returns the sum of three rows, multiplied by the first three of an array of weights."""
    return _weighted_sum(weights[0], weights[1], weights[2], rows)


@inner
def _weighted_sum(a: float, b: float, c: float, rows: Three) -> Row:
    return _sum(_sum(scaled(rows[0], a), scaled(rows[1], b)), scaled(rows[2], c))


@inner
def _add_product(row: Row, weighted: Row, equations: Any) -> None:
    """Adds the product of a row, transposed, and a weighted row."""
    _add_to_line(equations[0], scaled(weighted, row[0]))
    _add_to_line(equations[1], scaled(weighted, row[1]))
    _add_to_line(equations[2], scaled(weighted, row[2]))
    _add_to_line(equations[3], scaled(weighted, row[3]))
    _add_to_line(equations[4], scaled(weighted, row[4]))
    _add_to_line(equations[5], scaled(weighted, row[5]))
    _add_to_line(equations[6], scaled(weighted, row[6]))


@inner
def _add_products(rows: Three, weighted: Three, equations: Any) -> None:
    """Adds the product of three rows, transposed, and three weighted rows."""
    a, b, c = rows
    _add_to_line(equations[0], _weighted_sum(a[0], b[0], c[0], weighted))
    _add_to_line(equations[1], _weighted_sum(a[1], b[1], c[1], weighted))
    _add_to_line(equations[2], _weighted_sum(a[2], b[2], c[2], weighted))
    _add_to_line(equations[3], _weighted_sum(a[3], b[3], c[3], weighted))
    _add_to_line(equations[4], _weighted_sum(a[4], b[4], c[4], weighted))
    _add_to_line(equations[5], _weighted_sum(a[5], b[5], c[5], weighted))
    _add_to_line(equations[6], _weighted_sum(a[6], b[6], c[6], weighted))


@inner
def _add_to_line(line: Any, row: Row) -> None:
    line[0] += row[0]
    line[1] += row[1]
    line[2] += row[2]
    line[3] += row[3]
    line[4] += row[4]
    line[5] += row[5]
    line[6] += row[6]
