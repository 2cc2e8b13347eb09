"""Work on arrays, shared among several threads by parts; for kernels, which release the interpreter.

The caller works too and takes the parts that no other thread has taken, so that threads that are slow to wake cost next
to nothing. Unlike numba's pool, these threads serve any number of callers and a forked child, and a kernel without
`prange` compiles in a third of the time. Work of less than a millisecond is not worth sharing.
"""

import contextlib
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from functools import cache
from itertools import pairwise
from typing import Any

import numba
from numpy.typing import NDArray

_alone = ContextVar("alone", default=False)


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Makes `in_parts` use the caller's thread only, within the context; for worker processes, one on each core."""
    before = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(before)


def in_parts(work: Callable[..., object], arrays: Sequence[NDArray[Any]], least: int) -> None:
    """Calls `work` with the same rows of all `arrays`, `least` rows or more at a time, until all rows are done.

    The arrays have one length. It runs on as many threads as numba may use (NUMBA_NUM_THREADS), or on the caller's
    within `alone`. An error that `work` raises is raised here, once all threads have stopped.
    """
    n = len(arrays[0])
    threads = min(numba.config.NUMBA_NUM_THREADS, n // least)
    if threads < 2 or _alone.get():
        work(*arrays)
        return
    parts = min(4 * threads, n // least)  # with small parts, no thread waits long for the last one
    edges = [n * k // parts for k in range(parts + 1)]
    left = deque(pairwise(edges))

    def take() -> None:
        try:
            while True:
                try:
                    part = slice(*left.popleft())
                except IndexError:
                    return
                work(*(array[part] for array in arrays))
        finally:
            left.clear()  # after an error the rest is of no use

    helping = [_helpers().submit(take) for _ in range(threads - 1)]
    try:
        take()
    finally:
        started = [helper for helper in helping if not helper.cancel()]
        errors = [helper.exception() for helper in started]
    for error in errors:
        if error is not None:
            raise error


@cache
def _helpers() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(numba.config.NUMBA_NUM_THREADS - 1, 1), "handsight")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        after_in_child=_helpers.cache_clear
    )  # a forked child has none of its parent's threads
