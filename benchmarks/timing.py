"""Wall-clock times of calls, in turn and again and again (hot): medians, tails, ratios; and where they were taken."""

import contextlib
import gc
import importlib.metadata
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from testbed import report


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


def ratio_of_each(a: Sequence[float], b: Sequence[float]) -> dict[str, float]:
    """Geometric mean of a / b with its bootstrap interval (95 %), each of the same problem.

    Where problems are of several kinds, some ten times as long as others, medians are of one kind or the other.
    """
    return _interval(a, b, lambda a, b: np.exp(np.log(a / b).mean(axis=-1)))


def ratio(a: Sequence[float], b: Sequence[float]) -> dict[str, float]:
    """median(a) / median(b) with its bootstrap interval (95 %); pairs were taken in the same turn."""
    return _interval(a, b, lambda a, b: np.median(a, axis=-1) / np.median(b, axis=-1))


def _interval(
    a: Sequence[float], b: Sequence[float], of: Callable[..., Any], draws: int = 400
) -> dict[str, float]:
    n = min(len(a), len(b))
    first, second = np.asarray(a)[:n], np.asarray(b)[:n]
    rows = np.random.default_rng(0).integers(n, size=(draws, n))
    low, high = np.quantile(of(first[rows], second[rows]), [0.025, 0.975])
    return {"ratio": float(of(first, second)), "low": float(low), "high": float(high), "pairs": n}


PACKAGES = ("handsight", "numpy", "scipy", "numba", "trimesh", "open3d", "small_gicp")


def description() -> dict[str, Any]:
    """Returns processor, cores, load before the run, and versions."""
    return {
        "description": report.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(terse=True),
        "versions": {name: _version(name) for name in PACKAGES},
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
