"""Gels: soft skins whose indentation is measured at many places, as a depth or height image of a camera below them.

Where a gel is pressed deepest it lies on the object, so that each place there is a point of the object with the
object's normal, which the slope of the indentation gives. The rest of a patch hangs between object and gel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.contact.taxels import TactileSurface
from handsight.errors import InvalidInput

MOST_CELLS = 2048  # cells of a gel at most; a larger image is averaged over blocks of pixels


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Gel(TactileSurface):
    """Tactile surface whose readings are indentations [m], after `scale` and `offset`.

    Its `points` are places of the surface while nothing touches it, its `threshold` is in metres, and its `sigma_point`
    is the noise of the indentation at one of them.
    """

    kind: ClassVar[str] = "gel"

    image: tuple[int, int] | None = None
    """Rows and columns of a reading's pixels, which are averaged over square blocks, one for each point, row by row;
    None: one number for each point."""
    noise: float = 0.1  # standard deviation of the indentation's scale, as a share of it
    sigma_point: float = 5e-5
    sigma_normal: float | None = math.radians(3)
    """Standard deviation of a contact's normal [rad], in addition to that by noise."""

    def __post_init__(self) -> None:
        TactileSurface.__post_init__(self)
        if self.components != 1:
            raise InvalidInput(f"components: expected 1, the indentation, got {self.components}")
        if self.image is not None:
            image = checks.finite(self.image, "image", (2,)).astype(np.int64)
            object.__setattr__(self, "image", (int(image[0]), int(image[1])))
            if (image < 1).any() or math.prod(image // max(self.block, 1)) != len(self.points):
                n = len(self.points)
                came = " x ".join(map(str, self.image))
                raise InvalidInput(f"image: expected rows and columns of {n} square blocks, got {came}")

    @property
    def block(self) -> int:
        """Pixels along the side of a block."""
        return 1 if self.image is None else math.isqrt(math.prod(self.image) // len(self.points))

    @classmethod
    def grid(
        cls, *, frame: str, T_frame_grid: ArrayLike, rows: int, columns: int, pitch: float, **fields: Any
    ) -> Self:
        """Returns a flat gel under an image of `rows` by `columns` pixels, `pitch` apart [m]; raises InvalidInput."""
        block = block_of(rows, columns)
        fields |= {"frame": frame, "T_frame_grid": T_frame_grid, "image": (rows, columns)}
        size: Any = {"rows": rows // block, "columns": columns // block, "pitch": pitch * block}
        return super(Gel, cls).grid(**size, **fields)  # by name, as slots make another class of this one

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a reading."""
        return self.image or self.places

    def cells(self, values: Array) -> Array:
        """Returns a checked reading as (n, 1): means over blocks, NaN where less than half of a block is known.

        The pixels that are left over at the edges are not used.
        """
        if self.image is None:
            return values.reshape(-1, 1)
        b = self.block
        rows, columns = (size // b for size in self.image)
        top, left = (size % b // 2 for size in self.image)
        values = values[top : top + rows * b, left : left + columns * b].reshape(rows, b, columns, b)
        known = np.isfinite(values)
        count = known.sum(axis=(1, 3))
        total = np.where(known, values, 0.0).sum(axis=(1, 3))
        return np.where(2 * count >= b * b, total / count.clip(min=1), np.nan).reshape(-1, 1)

    @staticmethod
    def _kernel() -> Callable[..., int]:
        from handsight._kernels.touch.gels import sense_gel

        return sense_gel


def block_of(rows: Any, columns: Any) -> int:
    """Returns the pixels along a block's side, for an image of at most `MOST_CELLS` blocks; raises InvalidInput."""
    for name, value in (("rows", rows), ("columns", columns)):
        checks.integer(value, name, 10_000, 1)
    return math.ceil(math.sqrt(rows * columns / MOST_CELLS))
