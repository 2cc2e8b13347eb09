"""What was measured of an object, kept on disk, so that the same file, mesh or cloud is built once.

Under `$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; each file is named by
the hash of what it was computed from. Losing the folder costs time, nothing else.
"""

import contextlib
import hashlib
import io
import os
import tempfile
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from handsight.cache_folder import cache_folder
from handsight.objects.fields import FieldError, GridField
from handsight.objects.geometry import Geometry, frozen
from handsight.objects.surface import Cloud, ObjectWarning, Triangles

VERSION = 6
"""Raise it whenever the same shape gives another geometry."""
KEPT = 200
"""Files; the oldest go first."""
_warned: set[str] = set()


def key(kind: str, *arrays: NDArray[Any]) -> str:
    """The name under which what is computed from these is kept."""
    digest = hashlib.sha256(f"{VERSION} {kind}".encode())
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def remembered(name: str, compute: Callable[[], Geometry]) -> Geometry:
    """The geometry kept under `name`, or computed now and kept.

    What is damaged, or is not what the name says, is computed again. Safe under several processes: a file
    appears complete or not at all. Where the folder cannot be written, one ObjectWarning, and no error.
    """
    path = cache_folder() / f"field-{name}.msgpack"
    with contextlib.suppress(OSError, ValueError, EOFError):
        return _loaded(path, name)
    geometry = compute()
    try:
        content = msgspec.msgpack.encode(geometry, enc_hook=_packed)
        _store(path, _checksum(name, content) + content)
    except OSError as error:
        if str(path.parent) not in _warned:
            _warned.add(str(path.parent))
            why = f"distance fields cannot be cached there ({error.strerror or error}); each run builds them"
            warnings.warn(f"{path.parent}: {why}", ObjectWarning, stacklevel=2)
    return geometry


def _packed(array: NDArray[Any]) -> msgspec.msgpack.Ext:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return msgspec.msgpack.Ext(0, stream.getvalue())


def _unpacked(_: int, data: memoryview) -> NDArray[Any]:
    return frozen(np.load(io.BytesIO(data), allow_pickle=False))


def _checksum(name: str, content: bytes | memoryview) -> bytes:
    return zlib.crc32(content, zlib.crc32(name.encode())).to_bytes(4, "little")


def _loaded(path: Path, name: str) -> Geometry:
    """Raises OSError where there is no such file, ValueError where it is not what was kept."""
    data = memoryview(path.read_bytes())
    if data[:4] != _checksum(name, data[4:]):
        raise ValueError("damaged, or another object")
    parts = msgspec.msgpack.decode(data[4:], ext_hook=_unpacked)
    kinds: dict[str, Callable[..., Any]] = {
        "coarse": GridField,
        "fine": GridField,
        "field_error": FieldError,
        "surface": Cloud if "areas" in parts["surface"] else Triangles,
    }
    for key, kind in kinds.items():
        parts[key] = kind(**parts[key])
    return Geometry(**{**parts, "remarks": tuple(parts["remarks"])})


def _store(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix="field-", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.replace(temporary, path)
    finally:  # still there only where that failed
        with contextlib.suppress(OSError):
            os.unlink(temporary)
    with contextlib.suppress(OSError):  # another process may remove the same files at the same time
        for old in sorted(path.parent.glob("field-*"), key=lambda kept: kept.stat().st_mtime)[:-KEPT]:
            old.unlink()
