"""A kernel is compiled once, however the arrays lie that it is called with."""

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from handsight._kernels.runtime.compilation import entry, inner


@entry
def doubled_into(values, out):
    for i in range(len(values)):
        for j in range(len(values[i])):
            out[i, j] = 2 * values[i, j]
    return len(values)


def laid_out(values, layout):
    """The same numbers (n, m) in an array of another layout."""
    array = {"C": np.array, "F": np.asfortranarray, "strided": lambda v: np.repeat(v, 2, axis=1)[:, ::2]}[
        layout
    ](values)
    assert np.array_equal(array, values)
    return array


@pytest.mark.parametrize("layout", ["C", "F", "strided"])
@pytest.mark.parametrize("read_only", [False, True])
def test_arrays_of_any_layout_are_read_and_written_without_another_compilation(layout, read_only):
    values, out = laid_out(np.arange(12.0).reshape(3, 4), layout), laid_out(np.zeros((3, 4)), layout)
    values.flags.writeable = not read_only
    assert doubled_into(values, out) == 3
    assert np.array_equal(out, 2 * values)
    assert len([kinds for kinds in doubled_into.signatures if kinds[0].dtype == numba.float64]) == 1


def test_numbers_of_another_type_are_compiled_for():
    before, out = len(doubled_into.signatures), np.zeros((1, 2), dtype=np.int64)
    doubled_into(np.array([[1, 2]]), out)
    assert out.tolist() == [[2, 4]]
    assert len(doubled_into.signatures) == before + 1


@inner
def reversed_copy(values):
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = values[-1 - i]
    return out


@inner
def first_row_copied(values):
    for i in range(1, len(values)):
        values[i] = values[i - 1]


@entry
def sum_of_first(values):
    total = 0.0
    first_row_copied(values)
    for i in range(len(values)):
        total += reversed_copy(values[i])[0]
    return total


def test_arrays_that_inner_functions_make_live_until_they_are_read_and_are_then_freed():
    values = np.arange(12.0).reshape(3, 4)
    _nrt_python.memsys_enable_stats()
    try:
        sum_of_first(values.copy())
        before = rtsys.get_allocation_stats()
        assert sum_of_first(values) == 9.0
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert after.alloc - before.alloc == after.free - before.free >= 3
