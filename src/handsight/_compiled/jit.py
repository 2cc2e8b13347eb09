"""How kernels are compiled, by numba: `inner` ones for other kernels, `entry` ones for Python, kept on disk.

Numba looks at the source of an entry alone, and would go on using one whose callee has changed in another file. So the
folder of kept kernels is named by a hash of all their sources. Numba also numbers a kernel's files by an index that is
not locked. So a process holds a lock of that kernel while it loads or compiles it.
"""

import contextlib
import functools
import gc
import hashlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np

from handsight import cache_folder, checks

with contextlib.suppress(ImportError):  # not on Windows: there, processes must not compile at the same time
    import fcntl

# Numba asks once whether SciPy's BLAS can be imported, which no kernel of handsight calls; loading it takes a third of
# the time to the first correction. An empty module takes its place during that check; later imports get SciPy's own.
if "numba.np.arraymath" not in sys.modules and "scipy.linalg.cython_blas" not in sys.modules:
    sys.modules["scipy.linalg.cython_blas"] = ModuleType("scipy.linalg.cython_blas")
    try:
        import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg.cython_blas"]

F = TypeVar("F", bound=Callable[..., Any])

FAST = {"contract", "nsz", "reassoc"}
"""What the compiler may do to floating point: sum in another order, ignore the sign of zero; NaN and infinity stay."""

KEPT_VERSIONS = 4
"""So many folders of kept kernels stay, of this version and of earlier ones; each has some ten megabytes."""

on_compile: list[Callable[[str], object]] = []
"""Functions that are called before a kernel is compiled for the first time on this machine, which takes a while, with
its name, and after that with an empty text."""


class KernelWarning(UserWarning):
    """Warns that compiled kernels cannot be kept on disk, which costs time and nothing else."""


def _stamp() -> str:
    """Returns a text that changes with Python, numba, any kernel (they are compiled into each other), the bounds in
    `checks` that kernels use, and the place of it all: numba finds no kernel that was compiled from another copy, and
    who uses one copy must not wait while another is compiled."""
    place = Path(__file__).parents[1]
    kernels = sorted([*place.glob("_compiled/*.py"), *place.glob("*/kernels/*.py")])
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {numba.__version__} {place}".encode())
    for path in (Path(checks.__file__), *kernels):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


STAMP = _stamp()


def _chosen_folder() -> Path:
    """Returns the folder of this version's kernels, in `$NUMBA_CACHE_DIR` if that is set, else in handsight's cache."""
    name = f"kernels-{STAMP}"
    configured = os.environ.get("NUMBA_CACHE_DIR")
    if configured:
        return cache_folder.private_folder(Path(configured), name)
    return cache_folder.cache_folder() / name


@contextlib.contextmanager
def _private_files() -> Iterator[None]:
    """Makes new files such that others can at most read them, whatever the umask: kept kernels are code."""
    before = os.umask(0o022)
    try:
        yield
    finally:
        os.umask(before)


def _made_folder() -> Path | None:
    """Returns the folder of this version's kernels, which is made; None where none can be written to.

    A new one replaces those of the oldest versions.
    """
    folder = _chosen_folder()
    try:
        with _private_files():
            is_new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _warn_once(str(folder.parent), error.strerror or str(error))
        return None
    if is_new:
        with contextlib.suppress(OSError):  # other processes may remove the same ones
            versions = sorted(folder.parent.glob("kernels-*"), key=lambda path: path.stat().st_mtime)
            for old in versions[:-KEPT_VERSIONS]:
                shutil.rmtree(old, ignore_errors=True)
    return folder


@functools.cache
def _warn_once(place: str, reason: str) -> None:
    message = (
        f"{place}: compiled kernels cannot be kept there ({reason}); each process compiles them again "
        "(name another folder in HANDSIGHT_CACHE or NUMBA_CACHE_DIR)"
    )
    warnings.warn(message, KernelWarning, stacklevel=2)


FOLDER = _made_folder()
"""Where this process keeps kernels; None: nowhere."""


PROCESS = os.urandom(6).hex()
"""Tells the functions that this process compiles from those of other ones."""


def inner(function: F) -> F:
    """Returns a function for other kernels: compiled into each of them, and not callable from Python.

    Numba names its machine code by the function and by numbers of record types that are others in another process. Two
    kernels that were compiled in different processes could therefore call one function, made for the records of one of
    them; so the function's name tells the process, too.
    """
    function.__qualname__ += f"_{PROCESS}"
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(F, numba.njit(error_model="numpy", fastmath=FAST, **options)(function))


def entry(function: F) -> F:
    """Returns a kernel that Python calls; its machine code is kept on disk, and it releases the interpreter.

    Other kernels cannot call it. It is compiled for each type of arguments, and for contiguous arrays that can be
    written to apart from other ones, so callers give it such arrays.
    """
    kernel = _kept(function)
    name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
    known = set()

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        kinds = tuple([(a.dtype, a.flags.carray) if type(a) is np.ndarray else type(a) for a in arguments])
        if kinds in known:
            return kernel(*arguments)
        result = _called_first(kernel, name, arguments)
        known.add(kinds)
        return result

    return cast(F, call)


def _kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """Returns the function compiled by numba, which keeps machine code in `FOLDER`.

    Numba looks for its folder when it decorates a function, and at no other time.
    """
    before = numba.config.CACHE_DIR
    if FOLDER is not None:
        numba.config.CACHE_DIR = str(FOLDER)
    try:
        with _private_files():
            options = {"nogil": True, "no_cfunc_wrapper": True, "cache": FOLDER is not None}
            return numba.njit(error_model="numpy", fastmath=FAST, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


def _called_first(kernel: Callable[..., Any], name: str, arguments: tuple[Any, ...]) -> Any:
    """Returns what a kernel answers that may have to be loaded or compiled, while no other process does that."""
    with _private_files(), _locked(name) as lock, _without_collecting():
        is_new = lock is None or lock.tell() == 0
        if is_new:
            _announce(name)
        try:
            result = kernel(*arguments)
        except OSError as error:  # it is compiled, but could not be kept
            _warn_once(str(FOLDER), error.strerror or str(error))
            result = kernel(*arguments)
        if is_new:
            _announce("")
            if lock is not None:
                lock.write("compiled\n")
        return result


def _announce(name: str) -> None:
    for announce in on_compile:
        announce(name)


@contextlib.contextmanager
def _locked(name: str) -> Iterator[Any]:
    """Yields the lock of a kernel while this process alone has it: a file that is empty until the kernel is compiled.

    Yields None where no kernels are kept.
    """
    with contextlib.ExitStack() as opened:
        lock = None
        if FOLDER is not None:
            with contextlib.suppress(OSError):
                lock = opened.enter_context((FOLDER / f"{name}.lock").open("a"))
        if lock is not None and "fcntl" in globals():
            fcntl.flock(lock, fcntl.LOCK_EX)
            lock.seek(0, os.SEEK_END)
        yield lock


@contextlib.contextmanager
def _without_collecting() -> Iterator[None]:
    """Lets the garbage collector rest, which would take a sixth of the time of compiling."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
