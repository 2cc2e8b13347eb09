"""Wall-clock times: of calls taken in turn and again and again (hot); medians, tails, ratios."""

import contextlib
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Prevents garbage collection while timing."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextlib.contextmanager
def silent_stderr() -> Iterator[None]:
    """Discards what libraries write to stderr from C++: on a terminal it would take longer than their work."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept), os.close(nowhere)


def once(call: Callable[[], object]) -> tuple[object, float]:
    """Returns the result of a call, and its duration [s]."""
    begin = time.perf_counter()
    answer = call()
    return answer, time.perf_counter() - begin


def hot(call: Callable[[], object], seconds: float = 0.05, least: int = 5, most: int = 2000) -> np.ndarray:
    """Returns the durations of many repeats of one call [s], after two that do not count."""
    call(), call()
    times: list[float] = []
    end = time.perf_counter() + seconds
    with undisturbed():
        while len(times) < least or (len(times) < most and time.perf_counter() < end):
            times.append(once(call)[1])
    return np.array(times)


def in_turn(
    calls: Sequence[tuple[str, Callable[[], object]]], seconds: float, least: int = 5, most: int = 400
) -> dict[str, np.ndarray]:
    """Returns the durations of several calls in turn [s], after one round that does not count."""
    times: dict[str, list[float]] = {name: [] for name, _ in calls}
    for _, call in calls:
        call()
    rounds, end = 0, time.perf_counter() + seconds
    with undisturbed():
        while rounds < least or (rounds < most and time.perf_counter() < end):
            shift = rounds % len(calls)
            for name, call in [*calls[shift:], *calls[:shift]]:
                times[name].append(once(call)[1])
            rounds += 1
    return {name: np.array(found) for name, found in times.items()}


def summary(seconds: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Returns median, 99 % quantile and least duration [s], and their number."""
    array = np.asarray(seconds, dtype=np.float64)
    return {
        "median_s": float(np.median(array)),
        "p99_s": float(np.quantile(array, 0.99)),
        "min_s": float(array.min()),
        "repeats": len(array),
    }


def ratio_of_each(a: Sequence[float], b: Sequence[float], draws: int = 400) -> dict[str, float]:
    """Geometric mean of a / b with its bootstrap interval (95 %), each of the same problem.

    Where problems are of several kinds, some ten times as long as others, medians are of one kind or the other.
    """
    n = min(len(a), len(b))
    logs = np.log(np.asarray(a)[:n] / np.asarray(b)[:n])
    drawn = logs[np.random.default_rng(0).integers(n, size=(draws, n))].mean(axis=1)
    low, high = np.exp(np.quantile(drawn, [0.025, 0.975]))
    return {"ratio": float(np.exp(logs.mean())), "low": float(low), "high": float(high), "pairs": n}


def ratio(a: Sequence[float], b: Sequence[float], draws: int = 400) -> dict[str, float]:
    """median(a) / median(b) with its bootstrap interval (95 %); pairs were taken in the same turn."""
    first, second = np.asarray(a), np.asarray(b)
    n = min(len(first), len(second))
    first, second = first[:n], second[:n]
    rows = np.random.default_rng(0).integers(n, size=(draws, n))
    drawn = np.median(first[rows], axis=1) / np.median(second[rows], axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    middle = float(np.median(first) / np.median(second))
    return {"ratio": middle, "low": float(low), "high": float(high), "pairs": n}
