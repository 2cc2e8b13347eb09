"""Distance fields kept on disk, so that an object is built once.

Under `$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; each file is named by
the hash of what it was computed from. Losing the folder costs time, nothing else.
"""

import contextlib
import hashlib
import os
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handsight.cache_folder import cache_folder
from handsight.objects.geometry import ObjectWarning

VERSION = 3
"""Raise it whenever the same geometry gives other fields."""
KEPT = 200
"""Files; the oldest go first."""
Arrays = dict[str, NDArray[Any]]
_warned: set[str] = set()


def key(kind: str, parameters: str, *arrays: NDArray[Any]) -> str:
    """The name under which what is computed from these is kept."""
    digest = hashlib.sha256(f"{VERSION} {kind} {parameters}".encode())
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def remembered(name: str, names: set[str], compute: Callable[[], Arrays]) -> Arrays:
    """The arrays kept under `name`, or computed now and kept.

    A file that is cut short, or lacks one of `names`, is computed again. Safe under several processes: a file
    appears whole or not at all. Where the folder cannot be written, one ObjectWarning, and no error.
    """
    path = cache_folder() / f"field-{name}.npz"
    found = _load(path, names)
    if found is not None:
        return found
    arrays = compute()
    try:
        _store(path, arrays)
    except OSError as error:
        if str(path.parent) not in _warned:
            _warned.add(str(path.parent))
            detail = error.strerror or error
            message = (
                f"{path.parent}: distance fields cannot be cached there ({detail}); each run builds them"
            )
            warnings.warn(message, ObjectWarning, stacklevel=2)
    return arrays


def _load(path: Path, names: set[str]) -> Arrays | None:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {k: file[k] for k in file.files}
    except (OSError, ValueError, TypeError, AttributeError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return arrays if set(arrays) == names else None


def _store(path: Path, arrays: Arrays) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix="field-", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        os.replace(temporary, path)
    finally:  # still there only where that failed
        with contextlib.suppress(OSError):
            os.unlink(temporary)
    _forget_oldest(path.parent)


def _forget_oldest(kept: Path) -> None:
    """Another process may remove the same files at the same time."""
    ages = []
    for file in kept.glob("field-*.npz"):
        with contextlib.suppress(OSError):
            ages.append((file.stat().st_mtime, file))
    for _, file in sorted(ages)[:-KEPT]:
        with contextlib.suppress(OSError):
            file.unlink()
