"""Work in parts on several threads, for kernels that release the interpreter.

Threads of their own for each call: unlike numba's pool they survive a fork and serve any number of callers, and a
kernel without `prange` compiles in a third of the time. Worth it above a millisecond of work.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from itertools import pairwise
from typing import Any

import numba
from numpy.typing import NDArray

PARTS_EACH = 4
"""Parts for each thread: the last one to end keeps the others waiting for less."""

_alone = ContextVar("alone", default=False)


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """What is called within keeps to the caller's thread: for workers of which there is one for each core."""
    before = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(before)


def in_parts(work: Callable[..., object], arrays: Sequence[NDArray[Any]], least: int) -> None:
    """Calls `work` on parts of arrays of one length, at least `least` rows, until all are done; raises what it raises.

    On as many threads as numba may use (NUMBA_NUM_THREADS), or on the caller's within `alone`.
    """
    n = len(arrays[0])
    threads = min(numba.config.NUMBA_NUM_THREADS, n // least)
    if threads < 2 or _alone.get():
        work(*arrays)
        return
    parts = min(PARTS_EACH * threads, n // least)
    edges = [n * k // parts for k in range(parts + 1)]
    slices = [slice(*pair) for pair in pairwise(edges)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, *([array[part] for part in slices] for array in arrays)))
