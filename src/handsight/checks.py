"""Checks at the public door: the clean array comes back, or an InvalidInput that names the argument."""

import difflib
from collections.abc import Iterable
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight.errors import InvalidInput, without_addresses

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]

MAX_DISTANCE = 1e3
"""No position on or near a robot is farther from any frame's origin [m]; beyond it numbers are not measurements."""
MAX_REACH = 5.0
"""Nothing that a hand touches or holds is farther from its palm [m]: beyond it the unit is another."""
MAX_LOAD = 1e5
"""No fingertip reads a larger force [N] or torque [N m]."""
MIN_SIGMA = 1e-9
"""Nothing is known more finely [m, rad]; squares of less than it drown in rounding."""
MAX_NAME_LENGTH, MAX_COMPARED = 100, 200
"""Characters of a name that may be a slip of another's, and names it is compared with: it takes time with both."""


def finite(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`value` as float64 of that shape (None: any length), all finite; raises InvalidInput otherwise."""
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        array = np.array("")
    # Neither numbers in strings nor truth values nor integers beyond 64 bits pass for numbers.
    if array.size and (array.dtype.kind not in "iuf" or _contains_bool(value)):
        raise InvalidInput(f"{name}: expected {describe_shape(shape)}, got {brief(value)}")
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        came = brief(value) if array.size <= 8 else f"shape {array.shape}"
        raise InvalidInput(f"{name}: expected {describe_shape(shape)}, got {came}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        came = brief(value) if array.size <= 8 else "NaN or infinity"
        raise InvalidInput(f"{name}: expected {describe_shape(shape)}, got {came}")
    return array


def _contains_bool(value: ArrayLike) -> bool:
    """Whether a list of numbers has a truth value among them, which NumPy would read as 0 or 1."""
    if isinstance(value, list | tuple):
        return any(_contains_bool(item) for item in value)
    return isinstance(value, bool)


def positive(value: ArrayLike, name: str) -> float:
    """`value` as a float above zero; raises InvalidInput otherwise."""
    number = float(finite(value, name, ()))
    if not number > 0:
        raise InvalidInput(f"{name}: expected a number above 0, got {brief(value)}")
    return number


def integer(value: object, name: str, most: int) -> int:
    """`value` as a whole number from 0 to `most`; raises InvalidInput otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value <= most:
        raise InvalidInput(f"{name}: expected a whole number from 0 to {most}, got {brief(value)}")
    return int(value)


def position(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`value` [m] as `finite` takes it, each number within `MAX_DISTANCE`; raises InvalidInput otherwise."""
    return _within(finite(value, name, shape), name, MAX_DISTANCE, "metres")


def load(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`value` [N, N m] as `finite` takes it, each number within `MAX_LOAD`; raises InvalidInput otherwise."""
    return _within(finite(value, name, shape), name, MAX_LOAD, "newtons and newton metres")


def _within(array: Array, name: str, limit: float, unit: str) -> Array:
    beyond = np.abs(array) > limit
    if beyond.any():
        raise InvalidInput(f"{name}: expected {unit} within {limit:g}, got {array[beyond][0]:g}")
    return array


def metres_text(length: float | list[float], most: float) -> str:
    """A length or position [m] beyond `most`, for a message: with what it is if it was meant in millimetres."""
    lengths = np.atleast_1d(np.asarray(length, dtype=np.float64))
    texts = [f"[{', '.join(f'{value:g}' for value in row)}]" for row in (lengths, 1e-3 * lengths)]
    came, meant = (text.strip("[]") if np.ndim(length) == 0 else text for text in texts)
    return (
        f"{came} (millimetres? {meant} m)"
        if np.abs(lengths).max() <= 1e3 * most
        else f"{came} (millimetres?)"
    )


def in_reach(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`value` [m] in the palm's frame as `finite` takes it, each number within `MAX_REACH`; raises InvalidInput."""
    array = finite(value, name, shape)
    if (np.abs(array) > MAX_REACH).any():
        came = metres_text(array.tolist(), MAX_REACH) if array.ndim < 2 else "more (millimetres?)"
        raise InvalidInput(f"{name}: expected metres within {MAX_REACH:g}, got {came}")
    return array


def sigma(value: ArrayLike, name: str) -> float:
    """`value` as a standard deviation [m or rad] from `MIN_SIGMA` to `MAX_DISTANCE`; raises InvalidInput otherwise."""
    number = positive(value, name)
    if not MIN_SIGMA <= number <= MAX_DISTANCE:
        raise InvalidInput(
            f"{name}: expected a number from {MIN_SIGMA:g} to {MAX_DISTANCE:g}, got {number:g}"
        )
    return number


def sigma_point(value: ArrayLike, name: str) -> float:
    """As `sigma`, of where a contact is [m]: within `MAX_REACH`."""
    number = sigma(value, name)
    if number > MAX_REACH:
        raise InvalidInput(
            f"{name}: expected metres within {MAX_REACH:g}, got {metres_text(number, MAX_REACH)}"
        )
    return number


def sigma_normal(value: ArrayLike, name: str) -> float:
    """As `sigma`, of a direction [rad]: within half a turn."""
    number = sigma(value, name)
    if number > np.pi:
        came = f"{number:g} (degrees? {np.deg2rad(number):.4g} rad)"
        raise InvalidInput(f"{name}: expected radians within {np.pi:.4g}, got {came}")
    return number


def unit(vectors: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`vectors` scaled to length 1 along the last axis; a zero vector raises InvalidInput."""
    array = finite(vectors, name, shape)
    # Dividing by the largest entry first keeps 1e-200 and 1e200 from under- and overflowing.
    largest = np.abs(array).max(axis=-1, keepdims=True) if array.size else np.ones_like(array)
    if (largest == 0).any():
        raise InvalidInput(f"{name}: expected a direction, got a zero vector")
    array = array / largest
    return np.asarray(array / np.linalg.norm(array, axis=-1, keepdims=True), dtype=np.float64)


def covariance(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Array:
    """`value` if symmetric and positive semidefinite (to rounding), made exactly symmetric; of pose or contact.

    The largest deviation of each three numbers is zero (known exactly) or as `sigma` takes it.
    """
    array = finite(value, name, shape)
    variances = np.diagonal(array, axis1=-2, axis2=-1)
    # A singular covariance has rounding's variance where it has none, so the largest of three is looked at.
    widest = np.sqrt(
        np.abs(variances.reshape(*variances.shape[:-1], variances.shape[-1] // 3, 3)).max(axis=-1)
    )
    strange = (widest > MAX_DISTANCE * (1 + 1e-9)) | ((widest > 0) & (widest < MIN_SIGMA * (1 - 1e-9)))
    if strange.any():
        expected = f"expected standard deviations from {MIN_SIGMA:g} to {MAX_DISTANCE:g}"
        raise InvalidInput(f"{name}: {expected}, got {widest[strange][0]:g}")
    if (np.abs(array) > 2 * MAX_DISTANCE**2).any():  # none is larger than the largest variance
        raise InvalidInput(f"{name}: expected a positive semidefinite covariance, got a negative eigenvalue")
    transposed = np.swapaxes(array, -1, -2)
    # Entries differ in unit (m², m rad, rad²): compare each with what its own variances allow.
    deviation = np.sqrt(np.abs(np.diagonal(array, axis1=-2, axis2=-1)))
    scale = deviation[..., :, None] * deviation[..., None, :]
    if (np.abs(array - transposed) > 1e-6 * scale + 1e-300).any():
        raise InvalidInput(f"{name}: expected a symmetric covariance, got one that is not")
    array = (array + transposed) / 2
    normalised = array / np.where(scale > 0, scale, 1.0)
    if array.size and np.linalg.eigvalsh(normalised).min() < -1e-9:
        raise InvalidInput(f"{name}: expected a positive semidefinite covariance, got a negative eigenvalue")
    return array


def ndim(value: object) -> int:
    """How many axes `value` has; one where its rows differ in length and numpy refuses to count."""
    try:
        return np.ndim(value)  # type: ignore[arg-type]
    except ValueError:
        return 1


def describe_shape(shape: tuple[int | None, ...]) -> str:
    """What an array of that shape is called in a message."""
    if shape == ():
        return "a finite number"
    if len(shape) == 1 and shape[0] is not None:
        return f"{shape[0]} finite numbers"
    return f"finite numbers of shape ({', '.join('n' if s is None else str(s) for s in shape)})"


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """The one that a name may be a slip of, whatever its letters' case; None where none is alike."""
    lower = {one.lower(): one for one in islice(known, MAX_COMPARED) if len(one) <= MAX_NAME_LENGTH}
    like = name.lower() if len(name) <= MAX_NAME_LENGTH else ""
    alike = difflib.get_close_matches(like, lower, n=1, cutoff=0.5)
    return lower[alike[0]] if alike else None


def suggestion(name: str, valid: Iterable[str]) -> str:
    """`; the nearest valid one is 'x'`, or, where none is alike, the first few of them: for the end of a message."""
    known = sorted(valid)
    if (alike := nearest_name(name, known)) is not None:
        return f"; the nearest valid one is {alike!r}"
    listed = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; valid: {listed}" if known else ""


def brief(value: object) -> str:
    """`value` in at most 80 characters, in JSON's list form."""
    try:
        text = str(value.tolist() if isinstance(value, np.ndarray) else value)
    except ValueError:  # Python does not write whole numbers of thousands of digits
        text = "a whole number of thousands of digits"
    except RecursionError:
        text = "values in values, too deep"
    text = without_addresses(text)
    return text if len(text) <= 80 else text[:77] + "..."
