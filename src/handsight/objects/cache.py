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

import numpy as np
from numpy.typing import NDArray

from handsight.cache_folder import cache_folder
from handsight.objects.fields.field import FieldError, GridField
from handsight.objects.geometry import Geometry, frozen
from handsight.objects.surface import Cloud, ObjectWarning, Surface, Triangles

VERSION = 5
"""Raise it whenever the same shape gives another geometry."""
KEPT = 200
"""Files; the oldest go first."""
_GRIDS = ("coarse", "fine", "field_error")
_ARRAYS = ("points_object", "normals_object", "bounds_object", "vertices", "faces")
_NUMBERS = ("area", "diameter", "sigma_point", "sigma_normal", "closed")
_KEPT = (*_GRIDS, *_ARRAYS, "grids", "numbers", "remarks", "areas", "normals")
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
    path = cache_folder() / f"field-{name}.npys"
    with contextlib.suppress(OSError, ValueError, EOFError):
        return _loaded(path, name)
    geometry = compute()
    try:
        _store(path, _sealed(name, _arrays(geometry)))
    except OSError as error:
        if str(path.parent) not in _warned:
            _warned.add(str(path.parent))
            detail = error.strerror or error
            message = (
                f"{path.parent}: distance fields cannot be cached there ({detail}); each run builds them"
            )
            warnings.warn(message, ObjectWarning, stacklevel=2)
    return geometry


def _arrays(geometry: Geometry) -> dict[str, NDArray[Any]]:
    grids: list[Any] = [getattr(geometry, k) for k in _GRIDS]
    surface: Any = geometry.surface
    cloud = not isinstance(surface, Triangles)
    return {
        **{k: grid.values for k, grid in zip(_GRIDS, grids, strict=True)},
        **{k: getattr(geometry, k) for k in _ARRAYS},
        "grids": np.stack([np.append(grid.origin, grid.cell) for grid in grids]),
        "numbers": np.array([float(getattr(geometry, k)) for k in _NUMBERS]),
        "remarks": np.array(geometry.remarks, dtype=np.str_),
        "areas": surface.areas if cloud else np.empty(0),
        "normals": surface.normals if cloud else np.empty((0, 3)),
    }


def _sealed(name: str, arrays: dict[str, NDArray[Any]]) -> bytes:
    """The arrays one after another, behind a checksum of these and the name."""
    stream = io.BytesIO()
    for k in _KEPT:
        np.save(stream, arrays[k], allow_pickle=False)
    return _checksum(name, stream.getvalue()) + stream.getvalue()


def _checksum(name: str, content: bytes | memoryview) -> bytes:
    return zlib.crc32(content, zlib.crc32(name.encode())).to_bytes(4, "little")


def _loaded(path: Path, name: str) -> Geometry:
    """Raises OSError where there is no such file, ValueError where it is not what was kept."""
    data = memoryview(path.read_bytes())
    if data[:4] != _checksum(name, data[4:]):
        raise ValueError("damaged, or another object")
    stream = io.BytesIO(data[4:])
    arrays = {k: np.load(stream, allow_pickle=False) for k in _KEPT}
    grids = [(at[:3], float(at[3]), arrays[k]) for k, at in zip(_GRIDS, arrays["grids"], strict=True)]
    area, diameter, sigma_point, sigma_normal, closed = arrays["numbers"].tolist()
    surface: Surface = Triangles(arrays["vertices"], arrays["faces"])
    if len(arrays["areas"]):
        surface = Cloud(arrays["vertices"], arrays["normals"], arrays["areas"])
    return Geometry(
        coarse=GridField(*grids[0]),
        fine=GridField(*grids[1]),
        field_error=FieldError(*grids[2]),
        **{k: frozen(arrays[k]) for k in _ARRAYS},
        area=area,
        diameter=diameter,
        sigma_point=sigma_point,
        sigma_normal=sigma_normal,
        closed=bool(closed),
        remarks=tuple(str(remark) for remark in arrays["remarks"]),
        surface=surface,
    )


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
    _forget_oldest(path.parent)


def _forget_oldest(kept: Path) -> None:
    """Another process may remove the same files at the same time."""
    ages = []
    for file in kept.glob("field-*"):
        with contextlib.suppress(OSError):
            ages.append((file.stat().st_mtime, file))
    for _, file in sorted(ages)[:-KEPT]:
        with contextlib.suppress(OSError):
            file.unlink()
