"""Checks of arguments: each returns a clean value or raises an InvalidInput that names the argument."""

import difflib
from collections.abc import Iterable
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight.errors import InvalidInput, without_addresses

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

MAX_DISTANCE = 1e3
"""Largest coordinate of a position on or near a robot, in any frame [m]; a larger one is no measurement."""
MAX_REACH = 5.0
"""Largest coordinate of what a hand touches or holds, in the palm frame [m]; a larger one has another unit."""
MAX_LOAD = 1e5
"""Largest component of a force [N] or torque [N m] that a fingertip can bear."""
MIN_SIGMA = 1e-9
"""Smallest standard deviation [m, rad]; the square of a smaller one is lost in rounding."""
MAX_NAME_LENGTH = 100
"""Characters of a name that may be a misspelling of another one."""


def finite(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns a finite float64 copy of `value` of that shape (None: any length); raises InvalidInput otherwise."""
    try:
        array = unmasked(value, name)
    except InvalidInput:
        raise
    except ValueError:  # rows of different length
        array = np.array("")
    # Numbers in strings, truth values and integers beyond 64 bits are not numbers here.
    numeric = not array.size or (array.dtype.kind in "iuf" and not _contains_bool(value))
    fits = array.ndim == len(shape) and all(n in (None, m) for m, n in zip(array.shape, shape, strict=True))
    if numeric and fits:
        array = array.astype(np.float64)
        if np.isfinite(array).all():
            return array
    came = brief(value)
    if numeric and array.size > 8:
        came = "NaN or infinity" if fits else f"shape {array.shape}"
    raise InvalidInput(f"{name}: expected {describe_shape(shape)}, got {came}")


def unmasked(value: ArrayLike, name: str) -> NDArray[Any]:
    """Returns `value` as an array; raises InvalidInput where some of its entries are masked: NumPy would use them."""
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise InvalidInput(f"{name}: expected numbers, got a masked array (NaN is for unknown numbers)")
    return np.asarray(value)


def _contains_bool(value: ArrayLike) -> bool:
    """Returns whether a list of numbers has a truth value in it, which NumPy would read as 0 or 1."""
    if isinstance(value, list | tuple):
        return any(_contains_bool(item) for item in value)
    return isinstance(value, bool)


def positive(value: ArrayLike, name: str) -> float:
    """Returns `value` as a float above zero; raises InvalidInput otherwise."""
    number = float(finite(value, name, ()))
    if not number > 0:
        raise InvalidInput(f"{name}: expected a number above 0, got {brief(value)}")
    return number


def integer(value: object, name: str, most: int, least: int = 0) -> int:
    """Returns `value` as an integer from `least` to `most`; raises InvalidInput otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= most:
        raise InvalidInput(f"{name}: expected a whole number from {least} to {most}, got {brief(value)}")
    return int(value)


def position(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns `value` [m] as `finite` does, each number within `MAX_DISTANCE`; raises InvalidInput otherwise."""
    return within(finite(value, name, shape), name, MAX_DISTANCE, "metres")


def load(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns `value` [N, N m] as `finite` does, each number within `MAX_LOAD`; raises InvalidInput otherwise."""
    return within(finite(value, name, shape), name, MAX_LOAD, "newtons and newton metres")


def within(array: Array, name: str, limit: float, unit: str) -> Array:
    """Returns the array if no entry's size is above the limit; raises InvalidInput otherwise. `unit`: its unit."""
    beyond = np.abs(array) > limit
    if beyond.any():
        raise InvalidInput(f"{name}: expected {unit} within {limit:g}, got {array[beyond][0]:g}")
    return array


def in_reach(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns `value` [m] in the palm frame as `finite` does, each number within `MAX_REACH`; raises InvalidInput."""
    array = finite(value, name, shape)
    if (np.abs(array) > MAX_REACH).any():
        came = metres_text(array.tolist(), MAX_REACH) if array.ndim < 2 else "more (millimetres?)"
        raise InvalidInput(f"{name}: expected metres within {MAX_REACH:g}, got {came}")
    return array


def metres_text(length: float | list[float], most: float) -> str:
    """Returns the text of a length or position [m] beyond `most`, with what it would be if millimetres were meant."""
    lengths = np.atleast_1d(np.asarray(length, dtype=np.float64))
    came, meant = (", ".join(f"{value:g}" for value in row) for row in (lengths, 1e-3 * lengths))
    if np.ndim(length):
        came, meant = f"[{came}]", f"[{meant}]"
    return f"{came} (millimetres?{f' {meant} m' if np.abs(lengths).max() <= 1e3 * most else ''})"


def sigma(value: ArrayLike, name: str) -> float:
    """Returns `value` as a standard deviation [m or rad] from `MIN_SIGMA` to `MAX_DISTANCE`; raises InvalidInput."""
    number = positive(value, name)
    if not MIN_SIGMA <= number <= MAX_DISTANCE:
        expected = f"expected a number from {MIN_SIGMA:g} to {MAX_DISTANCE:g}"
        raise InvalidInput(f"{name}: {expected}, got {number:g}")
    return number


def sigma_point(value: ArrayLike, name: str) -> float:
    """Returns the standard deviation of a contact's position [m] as `sigma` does, within `MAX_REACH`."""
    number = sigma(value, name)
    if number > MAX_REACH:
        came = metres_text(number, MAX_REACH)
        raise InvalidInput(f"{name}: expected metres within {MAX_REACH:g}, got {came}")
    return number


def sigma_angle(value: ArrayLike, name: str) -> float:
    """Returns the standard deviation of a direction or a rotation [rad] as `sigma` does, within half a turn."""
    number = sigma(value, name)
    if number > np.pi:
        came = f"{number:g} (degrees? {np.deg2rad(number):.4g} rad)"
        raise InvalidInput(f"{name}: expected radians within {np.pi:.4g}, got {came}")
    return number


def unit(vectors: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns `vectors` scaled to length 1 along the last axis; raises InvalidInput for a zero vector."""
    array = finite(vectors, name, shape)
    # Dividing by the largest entry first keeps 1e-200 and 1e200 from under- and overflowing.
    largest = np.abs(array).max(axis=-1, keepdims=True) if array.size else np.ones_like(array)
    if (largest == 0).any():
        raise InvalidInput(f"{name}: expected a direction, got a zero vector")
    array = array / largest
    return np.asarray(array / np.linalg.norm(array, axis=-1, keepdims=True), dtype=np.float64)


def covariance(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """Returns a pose's or a contact's covariance (..., 6, 6), exactly symmetric; raises InvalidInput otherwise.

    It must be symmetric and positive semidefinite to rounding. The largest standard deviation of each three numbers
    (position, rotation or normal) is zero, that is exactly known, or as `sigma` takes it.
    """
    array = finite(value, name, shape)
    variances = np.diagonal(array, axis1=-2, axis2=-1)
    # A singular covariance has the variance of rounding where it has none, so only the largest of three is tested.
    grouped = np.abs(variances.reshape(*variances.shape[:-1], variances.shape[-1] // 3, 3))
    largest = np.sqrt(grouped.max(axis=-1))
    wrong = (largest > MAX_DISTANCE * (1 + 1e-9)) | ((largest > 0) & (largest < MIN_SIGMA * (1 - 1e-9)))
    if wrong.any():
        expected = f"expected standard deviations from {MIN_SIGMA:g} to {MAX_DISTANCE:g}"
        raise InvalidInput(f"{name}: {expected}, got {largest[wrong][0]:g}")
    if (np.abs(array) > 2 * MAX_DISTANCE**2).any():  # no entry is larger than the largest variance
        raise InvalidInput(f"{name}: expected a positive semidefinite covariance, got a negative eigenvalue")
    transposed = np.swapaxes(array, -1, -2)
    # Entries differ in unit (m², m rad, rad²): each is compared with what its own variances allow.
    deviation = np.sqrt(np.abs(variances))
    scale = deviation[..., :, None] * deviation[..., None, :]
    if (np.abs(array - transposed) > 1e-6 * scale + 1e-300).any():
        raise InvalidInput(f"{name}: expected a symmetric covariance, got one that is not")
    array = (array + transposed) / 2
    correlation = array / np.where(scale > 0, scale, 1.0)
    if array.size and np.linalg.eigvalsh(correlation).min() < -1e-9:
        raise InvalidInput(f"{name}: expected a positive semidefinite covariance, got a negative eigenvalue")
    return array


def ndim(value: object) -> int:
    """Returns the number of axes of `value`; 1 where its rows differ in length, which NumPy refuses."""
    try:
        return np.ndim(value)  # type: ignore[arg-type]
    except ValueError:
        return 1


def describe_shape(shape: tuple[int | None, ...]) -> str:
    """Returns the words for an array of that shape in a message."""
    if shape == ():
        return "a finite number"
    if len(shape) == 1 and shape[0] is not None:
        return f"{shape[0]} finite numbers"
    return f"finite numbers of shape ({', '.join('n' if s is None else str(s) for s in shape)})"


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """Returns the most similar of the first 200 known names, ignoring case; None where none is similar."""
    if len(name) > MAX_NAME_LENGTH:  # comparing takes time with the length and with the number of names
        return None
    lower = {other.lower(): other for other in islice(known, 200) if len(other) <= MAX_NAME_LENGTH}
    similar = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.5)
    return lower[similar[0]] if similar else None


def suggestion(name: str, valid: Iterable[str]) -> str:
    """Returns the end of a message: `; the nearest valid one is 'x'`, or the first valid names if none is similar."""
    known = sorted(valid)
    if (similar := nearest_name(name, known)) is not None:
        return f"; the nearest valid one is {similar!r}"
    listed = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; valid: {listed}" if known else ""


def brief(value: object) -> str:
    """Returns the text of `value` in at most 80 characters, arrays as lists."""
    try:
        text = str(value.tolist() if isinstance(value, np.ndarray) else value)
    except ValueError:  # Python does not write integers of thousands of digits
        text = "a whole number of thousands of digits"
    except RecursionError:
        text = "values in values, too deep"
    text = without_addresses(text)
    return text if len(text) <= 80 else text[:77] + "..."
