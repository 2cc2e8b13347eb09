"""What was measured of an object, kept on disk, so that the same file, mesh or cloud is built once.

Under `$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; each file is named by
the hash of what it was computed from. Losing the folder costs time, nothing else.
"""

import contextlib
import hashlib
import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from handsight.cache_folder import cache_folder, read_entry, write_entry
from handsight.objects.fields import FieldError, GridField
from handsight.objects.geometry import GEOMETRY, Geometry, frozen
from handsight.objects.surface import SURFACE, Cloud, ObjectWarning, Triangles

VERSION = 10
"""Raise it whenever the same shape gives another geometry."""
KEPT = 200
"""Files; the oldest go first."""
MOST = 10 * SURFACE.max_size**2
"""No number of an object is as large, in metres, square metres or radians."""
APPEARANCES = "what objects look like"
_warned: set[str] = set()
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class _Kind(Generic[T]):
    """A `_Kind` is what files of one kind are called, hold, and are made of."""

    prefix: str
    what: str
    load: Callable[[memoryview], T]
    """Raises something where a file is not what was kept."""
    content: Callable[[T], bytes]
    suffix: str = ""


def key(kind: str, *arrays: NDArray[np.generic]) -> str:
    """Returns the name under which what is computed from these is kept."""
    digest = hashlib.sha256(f"{VERSION} {kind}".encode())
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def remembered(name: str, compute: Callable[[], Geometry]) -> Geometry:
    """Returns the geometry kept under `name`, or computed now and kept.

    What is damaged, or is not what the name says, is computed again. Safe under several processes: a file
    appears complete or not at all. Where the folder cannot be written, one ObjectWarning, and no error.
    """
    kind = _Kind(
        "field",
        "distance fields",
        _loaded,
        lambda built: msgspec.msgpack.encode(built, enc_hook=_packed),
        ".msgpack",
    )
    return _remembered(kind, name, compute)


def remembered_bits(
    name: str, shape: tuple[int, int], compute: Callable[[], NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Returns what `remembered`, of a mask of that shape."""

    def load(data: memoryview) -> NDArray[np.bool_]:
        packed = np.frombuffer(data, dtype=np.uint8)
        if len(packed) != -(-shape[0] * shape[1] // 8):
            raise ValueError("not as many bits")
        return np.unpackbits(packed, count=shape[0] * shape[1]).reshape(shape).astype(np.bool_)

    kind = _Kind("bits", APPEARANCES, load, lambda bits: np.packbits(bits).tobytes())
    return _remembered(kind, name, compute)


def remembered_numbers(
    name: str, fits: Callable[[NDArray[np.int32]], bool], compute: Callable[[], NDArray[np.int32]]
) -> NDArray[np.int32]:
    """Returns what `remembered`, of whole numbers in a row; what does not fit is not what was kept."""

    def load(data: memoryview) -> NDArray[np.int32]:
        """Returns the value of the file's content; raises ValueError for other numbers."""
        numbers = np.frombuffer(data, dtype=np.int32)
        if not fits(numbers):
            raise ValueError("not such numbers")
        return numbers.copy()

    return _remembered(_Kind("numbers", APPEARANCES, load, lambda numbers: numbers.tobytes()), name, compute)


def _remembered(kind: "_Kind[T]", name: str, compute: Callable[[], T]) -> T:
    path = cache_folder() / f"{kind.prefix}-{name}{kind.suffix}"
    with contextlib.suppress(Exception):  # whatever is wrong with a file, it can be made again
        return kind.load(read_entry(path, name))
    built = compute()
    try:
        write_entry(path, name, kind.content(built))
        _forget_oldest(path.parent, f"{kind.prefix}-*")
    except OSError as error:
        _tell(path.parent, f"{kind.what} cannot be cached there ({error.strerror or error})")
    return built


def _tell(folder: Path, why: str) -> None:
    if str(folder) not in _warned:
        _warned.add(str(folder))
        warnings.warn(f"{folder}: {why}; each run builds them", ObjectWarning, stacklevel=3)


def _packed(array: NDArray[np.generic]) -> msgspec.msgpack.Ext:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=False)
    return msgspec.msgpack.Ext(0, stream.getvalue())


def _unpacked(_: int, data: memoryview) -> NDArray[np.generic]:
    return frozen(np.load(io.BytesIO(data), allow_pickle=False))


def _loaded(data: memoryview) -> Geometry:
    """Raises something where it is not what was kept."""
    parts = msgspec.msgpack.decode(data, ext_hook=_unpacked)
    kinds: dict[str, Callable[..., Any]] = {
        "coarse": GridField,
        "fine": GridField,
        "field_error": FieldError,
        "surface": Cloud if "areas" in parts["surface"] else Triangles,
    }
    for key, kind in kinds.items():
        parts[key] = kind(**parts[key])
    geometry = Geometry(**{**parts, "remarks": tuple(parts["remarks"])})
    if not all(_fits(*one) for one in _arrays(geometry)) or not _numbers_fit(geometry):
        raise ValueError("not an object's geometry")
    return geometry


def _arrays(geometry: Geometry) -> Iterator[tuple[NDArray[np.generic], type, tuple[int | None, ...]]]:
    """Yields each array with its type and its shape, None for any length: a kernel reads as far as these say."""
    yield geometry.points_object, np.float64, (GEOMETRY.samples, 3)
    yield geometry.normals_object, np.float64, (GEOMETRY.samples, 3)
    yield geometry.bounds_object, np.float64, (2, 3)
    coarse, fine, error = _grids(geometry)
    for grid in (coarse, fine, error):
        yield grid.origin, np.float64, (3,)
    yield coarse.values, np.float32, (None, None, None)
    yield fine.values, np.float32, (None, None, None)
    yield error.values, np.float64, (None, None, None, 4)
    surface = geometry.surface
    yield surface.vertices, np.float64, (None, 3)
    if isinstance(surface, Cloud):
        yield surface.normals, np.float64, surface.vertices.shape
        yield surface.areas, np.float64, surface.vertices.shape[:1]
    else:
        yield surface.faces, np.int64, (None, 3)


def _grids(geometry: Geometry) -> tuple[Any, ...]:
    """Returns all three: what is kept has them."""
    return geometry.coarse, geometry.fine, geometry.field_error


def _fits(array: NDArray[np.generic], dtype: type, shape: tuple[int | None, ...]) -> bool:
    """Returns whether an array is of that type and shape, not empty, and of numbers that an object can have."""
    return (
        array.dtype == dtype
        and len(array.shape) == len(shape)
        and all(n > 0 and wanted in (n, None) for n, wanted in zip(array.shape, shape, strict=True))
        and bool((np.abs(array) < MOST).all())
    )


def _numbers_fit(geometry: Geometry) -> bool:
    """Returns whether lengths, errors and indices are such."""
    lengths = [geometry.diameter, geometry.area, *(grid.cell for grid in _grids(geometry))]
    blurs, faces = (grid.blur for grid in _grids(geometry)[:2]), geometry.surface.faces
    return (
        all(isinstance(x, float) and 1 / MOST < x < MOST for x in lengths)
        and all(
            isinstance(x, float) and 0 <= x < MOST
            for x in (geometry.sigma_point, geometry.sigma_normal, *blurs)
        )
        and all(
            isinstance(flag, bool)
            for flag in (geometry.closed, *(grid.sheet for grid in _grids(geometry)[:2]))
        )
        and all(isinstance(remark, str) for remark in geometry.remarks)
        and _grids(geometry)[2].values.min() >= 0
        and (isinstance(geometry.surface, Cloud) or 0 <= faces.min() <= faces.max() < len(geometry.vertices))
    )


def _forget_oldest(folder: Path, kind: str) -> None:
    """Removes what is oldest. Other processes may do the same at the same time."""
    with contextlib.suppress(OSError):
        for old in sorted(folder.glob(kind), key=lambda kept: kept.stat().st_mtime)[:-KEPT]:
            old.unlink()
