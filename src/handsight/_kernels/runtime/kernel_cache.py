"""Where the machine code of kernels is kept on disk.

Numba's own cache numbers the files of a function, with an index beside them. It looks at the source of that function
alone, and would go on using a kernel whose callee in another file has changed; processes that save at the same time mix
the numbers up; and LLVM ends the process on damaged machine code instead of raising an error. So here the folder's name
is a hash of all kernels' sources (the stamp), and the name and the seal of a file contain the kernel's name, its
signature and the processor.
"""

import contextlib
import hashlib
import os
import pickle
import shutil
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import compiler, serialize
from numba.core.runtime import rtsys

from handsight import cache_folder, checks

on_compile: list[Callable[[str], object]] = []
"""Functions that are called before a kernel that is not on disk is compiled, which takes a while, with its name, and
after that with an empty text."""


class KernelWarning(UserWarning):
    """Warns that compiled kernels cannot be kept on disk, which costs time and nothing else."""


def _stamp() -> str:
    """Returns a text that changes with Python, numba, any kernel (they are compiled into each other), and the bounds
    in `checks` that kernels use."""
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {numba.__version__}".encode())
    for path in (Path(checks.__file__), *sorted(Path(__file__).parents[1].rglob("*.py"))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


STAMP = _stamp()


def folder() -> Path:
    """Returns the folder of this version's machine code, in `$NUMBA_CACHE_DIR` if that is set, else in handsight's
    cache."""
    name, configured = f"kernels-{STAMP}", os.environ.get("NUMBA_CACHE_DIR")
    if configured:
        return cache_folder.private_folder(Path(configured), name)
    return cache_folder.cache_folder() / name


class KernelCache:
    """A `KernelCache` keeps the machine code of one kernel, a file for each signature and kind of processor.

    Numba's dispatcher calls `load_overload` before it compiles, and `save_overload` after that.
    """

    cache_path = ""  # numba shows it in a kernel's `stats`; `folder` is asked each time

    def __init__(self, function: Callable[..., Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
        """The name in the file's name; kernels of other packages, which the stamp does not cover, extend it."""

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Returns the compiled kernel for a signature; None where there is no such file, or a damaged one."""
        # What machine code calls; numba's types and functions load when it compiles.
        rtsys.initialize(target_context)
        with contextlib.suppress(Exception):
            entry = cache_folder.read_entry(*self._file(signature, target_context.codegen()))
            return compiler.CompileResult._rebuild(target_context, *pickle.loads(entry))
        for announce in on_compile:
            announce(self.name)
        return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Writes a compiled kernel; warns once where that is not possible."""
        for announce in on_compile:
            announce("")
        if compiled.library.has_dynamic_globals:  # addresses of this process
            return
        try:
            cache_folder.write_entry(
                *self._file(signature, compiled.codegen), serialize.dumps(compiled._reduce())
            )
        except OSError as error:
            _warn_once(str(folder().parent), error.strerror or str(error))
        else:  # all but four folders of this and earlier versions go; other processes may do so at the same time
            with contextlib.suppress(OSError):
                ages = sorted((path.stat().st_mtime, path) for path in folder().parent.glob("kernels-*"))
                for _, path in ages[:-4]:
                    if path != folder():
                        shutil.rmtree(path, ignore_errors=True)

    def _file(self, signature: Any, codegen: Any) -> tuple[Path, str]:
        """Returns the file for a signature and this processor, and the text by which it is sealed."""
        seal = f"{STAMP} {self.name} {signature} {codegen.magic_tuple()}"
        return folder() / f"{self.name}.{hashlib.sha256(seal.encode()).hexdigest()[:16]}.nbc", seal


@cache
def _warn_once(place: str, reason: str) -> None:
    message = (
        f"{place}: compiled kernels cannot be kept there ({reason}); each process compiles them again "
        "(name another folder in HANDSIGHT_CACHE or NUMBA_CACHE_DIR)"
    )
    warnings.warn(message, KernelWarning, stacklevel=2)
