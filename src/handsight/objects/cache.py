"""The cache on disk of geometries and appearances, so that the same file, mesh or cloud is processed once.

The files are in `cache_folder()`, each named by the hash of the input of its computation. Losing the folder costs time,
nothing else. A damaged file is computed again; one that somebody forged is not noticed (SECURITY.md).
"""

import contextlib
import functools
import hashlib
import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from handsight.cache_folder import cache_folder, read_entry, write_entry
from handsight.objects.fields import FieldError, GridField
from handsight.objects.geometry import Geometry, frozen
from handsight.objects.surface import Cloud, ObjectWarning, Triangles

VERSION = 12
"""Part of every key; raise it whenever the same shape gives another geometry."""
KEPT = 200
"""Files of each kind that are kept; the oldest are removed."""
T = TypeVar("T")
Number = TypeVar("Number", bound=np.generic)


def key(kind: str, *arrays: NDArray[np.generic]) -> str:
    """Returns the key of a result that is computed from these arrays; `kind` names the computation."""
    digest = hashlib.sha256(f"{VERSION} {kind}".encode())
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def remembered(name: str, compute: Callable[[], Geometry]) -> Geometry:
    """Returns the geometry kept under the key `name`, or computes and keeps it.

    A damaged file, or one that was written under another key, is computed again. Several processes may do this at
    once: a file appears complete or not at all. A folder that cannot be written causes one ObjectWarning and no error.
    """
    return _remembered(cache_folder() / f"field-{name}.msgpack", name, _geometry, geometry_bytes, compute)


def remembered_numbers(
    kind: str, name: str, dtype: type[Number], compute: Callable[[], NDArray[Number]]
) -> NDArray[Number]:
    """Returns the numbers (n,) of a `kind` kept under the key `name`, or computes and keeps them, as `remembered`."""

    def load(data: memoryview) -> NDArray[Number]:
        return np.frombuffer(data, dtype=dtype).copy()

    return _remembered(cache_folder() / f"{kind}-{name}", name, load, np.ndarray.tobytes, compute)


def _remembered(
    path: Path,
    name: str,
    load: Callable[[memoryview], T],
    to_bytes: Callable[[T], bytes],
    compute: Callable[[], T],
) -> T:
    """Returns what `load` makes of the file's content; else what `compute` returns, and writes that to the file."""
    with contextlib.suppress(Exception):  # whatever is wrong with the file, its content can be computed again
        return load(read_entry(path, name))
    built = compute()
    folder = path.parent
    try:
        write_entry(path, name, to_bytes(built))
        with contextlib.suppress(OSError):  # other processes may remove files at the same time
            files = folder.glob(f"{path.name.partition('-')[0]}-*")
            for old in sorted(files, key=lambda file: file.stat().st_mtime)[:-KEPT]:
                old.unlink()
    except OSError as error:
        _warn_once(f"{folder}: fields and appearances cannot be kept there ({error.strerror or error})")
    return built


@functools.cache
def _warn_once(message: str) -> None:
    warnings.warn(f"{message}; each run builds them", ObjectWarning, stacklevel=4)


def geometry_bytes(geometry: Geometry) -> bytes:
    """Returns a geometry as MessagePack, its arrays in NumPy's own format."""

    def packed(array: NDArray[np.generic]) -> msgspec.msgpack.Ext:
        stream = io.BytesIO()
        np.save(stream, array, allow_pickle=False)
        return msgspec.msgpack.Ext(0, stream.getvalue())

    return msgspec.msgpack.encode(geometry, enc_hook=packed)


def _geometry(data: memoryview) -> Geometry:
    """Returns the geometry that `geometry_bytes` wrote; raises an exception for other content."""

    def unpacked(_: int, array: memoryview) -> NDArray[np.generic]:
        return frozen(np.load(io.BytesIO(array), allow_pickle=False))

    parts = msgspec.msgpack.decode(data, ext_hook=unpacked)
    kinds: dict[str, Callable[..., Any]] = {
        "coarse": GridField,
        "fine": GridField,
        "field_error": FieldError,
        "surface": Cloud if "areas" in parts["surface"] else Triangles,
    }
    for key, kind in kinds.items():
        parts[key] = kind(**parts[key])
    return Geometry(**{**parts, "remarks": tuple(parts["remarks"])})
