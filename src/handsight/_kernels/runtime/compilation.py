"""How a kernel is compiled, and where its machine code is kept.

Numba's own cache looks at the file of the function alone and would go on using a kernel whose callee in another
file has changed. Here one stamp over all kernels decides, and the folder is handsight's.
"""

import contextlib
import hashlib
import os
import pickle
import shutil
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numba
from numba.core import caching, serialize

# Numba asks once whether SciPy's BLAS can be imported, which no kernel of handsight calls; loading it takes a third of
# the time to the first correction. What asks is answered, and who needs it imports it as usual.
if "numba.np.arraymath" not in sys.modules and "scipy.linalg.cython_blas" not in sys.modules:
    sys.modules["scipy.linalg.cython_blas"] = ModuleType("scipy.linalg.cython_blas")
    try:
        import_module("numba.np.arraymath")
    finally:
        del sys.modules["scipy.linalg.cython_blas"]

from handsight import cache_folder, checks
from handsight._kernels.runtime.link_only import Linked

F = TypeVar("F", bound=Callable[..., Any])

FAST = {"contract", "nsz", "reassoc"}
"""What the compiler may do to floating point: sums in another order, no fear of -0; NaN and infinity stay."""
KEPT = 4
"""Folders of compiled kernels, of this version and earlier ones."""
_warned: set[str] = set()
on_compile: list[Callable[[], object]] = []
"""Called, once each, when the first kernel is about to be compiled because it was not kept: that takes a while."""


class KernelWarning(UserWarning):
    """Something about compiling that costs time and nothing else."""


def inner(function: F) -> F:
    """Returns a function for other kernels: compiled into each of them, and not callable from Python."""
    return numba.njit(
        error_model="numpy",
        fastmath=FAST,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=Linked,
    )(function)


def exact(function: F) -> F:
    """Compiles as `inner` does, every operation rounded as it stands: for code that counts on it."""
    return numba.njit(error_model="numpy", fastmath=False)(function)


def entry(function: F) -> F:
    """Returns a kernel that Python calls; its machine code is kept on disk, and the interpreter is released."""
    return _kept(numba.njit(error_model="numpy", fastmath=FAST, nogil=True)(function))


def _stamp() -> str:
    """Returns one for all kernels, and for the bounds that they know: they are compiled into each other."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in (Path(checks.__file__), *sorted(Path(__file__).parents[1].rglob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


STAMP = _stamp()


def folder() -> Path:
    """Returns where the machine code of this version is: in `$NUMBA_CACHE_DIR` where that is set, else handsight's
    cache."""
    name, named = f"kernels-{STAMP}", os.environ.get("NUMBA_CACHE_DIR")
    return cache_folder.private_folder(Path(named), name) if named else cache_folder.cache_folder() / name


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """A `_Locator` is numba's question where to keep a function, answered."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._line = function.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return ""  # `_Files` knows, each time anew

    def ensure_cache_path(self) -> None:
        """So does it."""

    def get_source_stamp(self) -> str:
        return STAMP

    def get_disambiguator(self) -> str:
        return str(self._line)

    @classmethod
    def from_function(cls, function: Callable[..., Any], _: str) -> "_Locator":
        return cls(function)


class _Impl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = [_Locator]  # noqa: RUF012 - numba's name and type


class _Files:
    """`_Files` are the files of one kernel, each the machine code for one signature and machine, named and sealed by
    what it is for.

    Numba's own are numbered, with an index beside them. Processes that save at the same time mix them up, and of what
    is damaged LLVM does not raise: it ends the process.
    """

    def __init__(self, kernel: str) -> None:
        self._kernel = kernel

    def load(self, key: Any) -> Any:
        """Returns what `save` was given. Raises OSError where there is nothing, ValueError where it is not that."""
        return pickle.loads(cache_folder.read_entry(*self._place(key)))

    def save(self, key: Any, compiled: Any) -> None:
        """Raises OSError."""
        cache_folder.write_entry(*self._place(key), serialize.dumps(compiled))

    def _place(self, key: Any) -> tuple[Path, str]:
        what = f"{STAMP} {self._kernel} {key!r}"
        return folder() / f"{self._kernel}.{hashlib.sha256(what.encode()).hexdigest()[:16]}.nbc", what


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """A `_Cache` is numba's cache, where a folder that cannot be read or written costs a warning."""

    _impl_class = _Impl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._cache_file = _Files(self._impl.filename_base)

    def load_overload(self, *args: Any) -> Any:
        kept = None
        with contextlib.suppress(Exception):  # none yet, damaged, of another build: compiled, and kept anew
            kept = super().load_overload(*args)
        while kept is None and on_compile:
            on_compile.pop()()
        return kept

    def save_overload(self, *args: Any) -> None:
        try:
            super().save_overload(*args)
        except OSError as error:
            _warn(error)
        else:
            _forget_oldest()


def _kept(dispatcher: Any) -> Any:
    dispatcher._cache = _Cache(dispatcher.py_func)
    return dispatcher


def _warn(error: OSError) -> None:
    if "folder" not in _warned:
        _warned.add("folder")
        message = (
            f"{folder().parent}: compiled kernels cannot be kept there ({error.strerror or error}); each process "
            "compiles them again (name another folder in HANDSIGHT_CACHE or NUMBA_CACHE_DIR)"
        )
        warnings.warn(message, KernelWarning, stacklevel=2)


def _forget_oldest() -> None:
    """Removes what is oldest. Other processes may do the same at the same time."""
    with contextlib.suppress(OSError):
        ages = sorted((path.stat().st_mtime, path) for path in folder().parent.glob("kernels-*"))
        for _, path in ages[:-KEPT]:
            if path != folder():
                shutil.rmtree(path, ignore_errors=True)
