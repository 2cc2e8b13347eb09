"""Vector code and stack memory, which numba does not offer, as intrinsics that write LLVM's code.

`spline` (value and derivatives of a grid), `accumulate` (rows of evidence to normal equations) and `scan` (the nearest
of many samples) use LLVM's vectors; numba leaves loops over so few elements scalar, with which a correction takes twice
as long. Where a processor's vectors are shorter, the compiler splits these. `local` is a record on the stack: numba
makes arrays on the heap only, and frees one while a record of it is still in use.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_FAST = ("contract", "nsz", "reassoc")
_DOUBLE, _SINGLE, _INT32, _INT64 = ir.DoubleType(), ir.FloatType(), ir.IntType(32), ir.IntType(64)
_DOUBLES, _FOUR = ir.VectorType(_DOUBLE, 4), ir.VectorType(_SINGLE, 4)
_WIDE, _WIDE_INTS = ir.VectorType(_SINGLE, 16), ir.VectorType(_INT32, 16)

# Cubic B-spline weights of the four nodes (columns) as polynomials of f (rows: 1, f, f², f³), and their derivatives.
_VALUE = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
_SLOPE = _VALUE[1:] * [[1], [2], [3]]
_BEND = _SLOPE[1:] * [[1], [2]]

# Orders of derivative along x, y and z of the ten results: value, gradient, the Hessian's upper triangle.
_ORDERS = (
    (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1),
    (2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2),
)  # fmt: skip


@intrinsic
def spline(_: Any, values: Any, first: Any, step_x: Any, step_y: Any, past: Any) -> Any:
    """Returns value, gradient (x, y, z) and Hessian (xx, xy, xz, yy, yz, zz) of a cubic B-spline by grid coordinates.

    `values`: nodes, float32, z fastest. `first`: index of the first of the 4 x 4 x 4 nodes in use. `step_x`, `step_y`:
    from an index to its neighbour along x and y. `past`: distance past the second node along x, y and z, 0 to 1. The 16
    rows of 4 nodes are contracted along x and y, then along z.
    """
    f8, i8 = types.float64, types.int64
    return types.UniTuple(f8, 10)(values, i8, i8, i8, types.UniTuple(f8, 3)), _spline


def _spline(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    values, first, step_x, step_y, past = arguments
    nodes = _data(context, builder, signature.args[0], values)
    along_x, along_y, along_z = (_basis(builder, f) for f in cgutils.unpack_tuple(builder, past, 3))
    total: dict[tuple[int, int], Any] = {}
    for j in range(4):
        rows: list[Any] = [None] * 3
        for i in range(4):
            x, y = (builder.mul(ir.Constant(_INT64, k), step) for k, step in ((i, step_x), (j, step_y)))
            four = builder.fpext(
                _load(builder, nodes, builder.add(first, builder.add(x, y)), _FOUR), _DOUBLES
            )
            rows = [_add(builder, _splat(builder, along_x[o], i), four, rows[o]) for o in range(3)]
        for o in range(3):
            for m in range(3 - o):
                total[o, m] = _add(builder, _splat(builder, along_y[m], j), rows[o], total.get((o, m)))
    sums = [_sum(builder, builder.fmul(total[o, m], along_z[n], flags=_FAST)) for o, m, n in _ORDERS]
    return context.make_tuple(builder, signature.return_type, sums)


def _basis(builder: Any, f: Any) -> list[Any]:
    """Returns the weights of four nodes, and their first and second derivatives by f, as vectors."""
    four, found = _filled(builder, f, _DOUBLES), []
    for rows in (_VALUE, _SLOPE, _BEND):
        total = ir.Constant(_DOUBLES, rows[-1].tolist())
        for row in rows[-2::-1]:
            total = _add(builder, total, four, ir.Constant(_DOUBLES, row.tolist()))
        found.append(total)
    return found


@intrinsic
def accumulate(_: Any, weight: Any, rows: Any, equations: Any) -> Any:
    """Adds `JᵀWJ` to `equations` (7, 8): the Hessian, the gradient in row and column 6, and the cost where these meet.

    `rows`: J, a tuple of rows of 7: six derivatives and the residual. `weight`: W, a symmetric array, or the tuple of
    its diagonal.
    """
    return types.void(weight, rows, equations), _accumulate


def _accumulate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    equations = _data(context, builder, signature.args[2], arguments[2])
    n, zero = signature.args[1].count, ir.Constant(_DOUBLE, 0.0)
    unpacked = cgutils.unpack_tuple(builder, arguments[1], n)
    numbers = [cgutils.unpack_tuple(builder, row, 7) for row in unpacked]
    rows = [[_packed(builder, row[:4]), _packed(builder, [*row[4:], zero])] for row in numbers]
    weighted = _weighted(context, builder, signature.args[0], arguments[0], rows)
    for i in range(7):
        for half in range(2):
            place = ir.Constant(_INT64, 8 * i + 4 * half)
            total = _load(builder, equations, place, _DOUBLES)
            for r in range(n):
                left = _filled(builder, numbers[r][i], _DOUBLES)
                total = _add(builder, left, weighted[r][half], total)
            address = builder.bitcast(builder.gep(equations, [place]), _DOUBLES.as_pointer())
            builder.store(total, address, align=8)
    return context.get_dummy_value()


def _weighted(context: Any, builder: Any, kind: Any, weight: Any, rows: Any) -> list[list[Any]]:
    """Returns the rows of W J."""
    n = len(rows)
    if isinstance(kind, types.UniTuple):
        diagonal = [_filled(builder, w, _DOUBLES) for w in cgutils.unpack_tuple(builder, weight, n)]
        return [[_add(builder, w, half, None) for half in row] for w, row in zip(diagonal, rows, strict=True)]
    numbers = _data(context, builder, kind, weight)
    weighted: list[list[Any]] = []
    for r in range(n):
        sums: list[Any] = [None, None]
        for c in range(n):
            w = builder.load(builder.gep(numbers, [ir.Constant(_INT64, n * r + c)]))
            w = _filled(builder, w, _DOUBLES)
            sums = [_add(builder, w, rows[c][half], sums[half]) for half in range(2)]
        weighted.append(sums)
    return weighted


@intrinsic
def local(_: Any, dtype: Any) -> Any:
    """Returns a record of a type on the stack, not initialised; it is valid until the calling kernel returns."""
    return dtype.dtype(dtype), _local


def _local(context: Any, builder: Any, signature: Any, _: Any) -> Any:
    # One piece of memory for each call in the source, however often it runs.
    size = ir.Constant(_INT32, signature.return_type.size)
    with builder.goto_entry_block():
        place = builder.alloca(ir.IntType(8), size=size)
        place.align = 32
    return builder.bitcast(place, context.get_value_type(signature.return_type))


@intrinsic
def scan(_: Any, table: Any, query: Any) -> Any:
    """Returns the column of a table that has the least product with the query; of equal ones the first.

    `table`: (7, n) float32, n a multiple of 16, of fixed size. `query`: 7 float32.
    """
    return types.int64(table, types.UniTuple(types.float32, 7)), _scan


def _scan(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    table = _data(context, builder, signature.args[0], arguments[0])
    count = signature.args[0].shape[1]
    query = [_filled(builder, q, _WIDE) for q in cgutils.unpack_tuple(builder, arguments[1], 7)]
    least = cgutils.alloca_once_value(builder, ir.Constant(_WIDE, [np.inf] * 16))
    place = cgutils.alloca_once_value(builder, ir.Constant(_WIDE_INTS, [0] * 16))
    with cgutils.for_range(builder, ir.Constant(_INT64, count // 16)) as loop:
        begin = builder.mul(loop.index, ir.Constant(_INT64, 16))
        total = None
        for k in range(7):
            row = builder.add(begin, ir.Constant(_INT64, k * count))
            total = _add(builder, query[k], _load(builder, table, row, _WIDE), total)
        less = builder.fcmp_ordered("<", total, builder.load(least))
        here = _filled(builder, builder.trunc(begin, _INT32), _WIDE_INTS)
        builder.store(builder.select(less, total, builder.load(least)), least)
        builder.store(builder.select(less, here, builder.load(place)), place)
    lanes = ir.Constant(_WIDE_INTS, list(range(16)))
    best: Any = builder.load(least), builder.add(builder.load(place), lanes)
    for half in (8, 4, 2, 1):
        halves = [ir.Constant(ir.VectorType(_INT32, half), list(range(k, k + half))) for k in (0, half)]
        parts = [[builder.shuffle_vector(vector, vector, half) for vector in best] for half in halves]
        best = _lesser(builder, *parts)
    return builder.sext(builder.extract_element(best[1], ir.Constant(_INT32, 0)), _INT64)


def _lesser(builder: Any, first: Any, second: Any) -> Any:
    """Returns the lesser of two vectors of values, each with its columns; of equal values the first column."""
    (a, i), (b, j) = first, second
    tie = builder.and_(builder.fcmp_ordered("==", b, a), builder.icmp_signed("<", j, i))
    less = builder.or_(builder.fcmp_ordered("<", b, a), tie)
    return builder.select(less, b, a), builder.select(less, j, i)


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    return context.make_array(kind)(context, builder, array).data


def _load(builder: Any, pointer: Any, place: Any, kind: Any) -> Any:
    """Returns a vector that begins at `place`, wherever that is."""
    address = builder.bitcast(builder.gep(pointer, [place]), kind.as_pointer())
    return builder.load(address, align=4 if kind.element == _SINGLE else 8)


def _add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """Returns a b + c, or a b where c is None."""
    product = builder.fmul(a, b, flags=_FAST)
    return product if c is None else builder.fadd(product, c, flags=_FAST)


def _packed(builder: Any, numbers: Any) -> Any:
    vector = ir.Constant(_DOUBLES, ir.Undefined)
    for k, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(_INT32, k))
    return vector


def _filled(builder: Any, number: Any, kind: Any) -> Any:
    """Returns a vector with the same number in every place."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.Constant(_INT32, 0))
    return _splat(builder, first, 0)


def _splat(builder: Any, vector: Any, k: int) -> Any:
    """Returns a vector with the k-th element of another one in every place."""
    same = ir.Constant(ir.VectorType(_INT32, vector.type.count), [k] * vector.type.count)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), same)


def _sum(builder: Any, vector: Any) -> Any:
    pair, unused = ir.VectorType(_INT32, 2), ir.Constant(vector.type, ir.Undefined)
    low = builder.shuffle_vector(vector, unused, ir.Constant(pair, [0, 1]))
    high = builder.shuffle_vector(vector, unused, ir.Constant(pair, [2, 3]))
    two = builder.fadd(low, high, flags=_FAST)
    left, right = (builder.extract_element(two, ir.Constant(_INT32, k)) for k in (0, 1))
    return builder.fadd(left, right, flags=_FAST)
