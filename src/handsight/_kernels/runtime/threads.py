"""Work in parts on several threads, for kernels that release the interpreter.

The caller works too and takes what the others leave, so that threads that are slow to wake cost next to nothing.
Threads of our own: unlike numba's pool they serve any number of callers and a forked child, and a kernel without
`prange` compiles in a third of the time. Worth it above a millisecond of work.
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
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # a child has none of its parent's threads
