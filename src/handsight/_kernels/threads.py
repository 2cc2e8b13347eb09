"""Work in parts on several threads, for kernels that release the interpreter.

Threads of their own for each call: unlike numba's pool they survive a fork and serve any number of callers, and a
kernel without `prange` compiles in a third of the time. Worth it above a millisecond of work.
"""

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar

import numba

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


def in_parts(work: Callable[[int, int], object], n: int, least: int) -> None:
    """Calls `work(start, stop)` until all of range(n) is done, in parts of at least `least`; raises what it raises.

    On as many threads as numba may use (NUMBA_NUM_THREADS), or on the caller's within `alone`.
    """
    threads = min(numba.config.NUMBA_NUM_THREADS, n // least)
    if threads < 2 or _alone.get():
        work(0, n)
        return
    parts = min(PARTS_EACH * threads, n // least)
    edges = [n * k // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
