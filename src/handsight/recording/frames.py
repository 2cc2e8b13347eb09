"""Pictures in which an object is looked for: depth, colour and what is known of their pixels."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from handsight.camera import Camera, Depth
from handsight.checks import Mask
from handsight.errors import InvalidInput
from handsight.vision.pixels import Color

Box = tuple[int, int, int, int]
"""First column and row, last column and row [pixels]."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frame:
    """A `Frame` is one picture of a depth camera."""

    name: str
    """What messages and answers call it."""
    camera: Camera
    depth: Depth
    """(h, w) along the optical axis [m], NaN where there is none."""
    color: Color | None = None
    """(h, w, 3) red, green, blue of the same pixels."""
    wanted: Mask | None = None
    """(h, w) pixels that the object may be in; None: all."""
    hand: Mask | None = None
    """(h, w) pixels of the hand; None: nobody knows of one."""
    number: tuple[int, int] | None = None
    """BOP's of its scene and of itself."""


class Unread(NamedTuple):
    """An `Unread` is a picture that cannot be read."""

    name: str
    reason: str
    """Which file, what was expected, what came."""


class Frames(NamedTuple):
    """`Frames` are pictures one after the other, read as they are asked for."""

    total: int | None
    """How many; None: nobody knows beforehand."""
    each: Iterator[Frame | Unread]
    library: Path | None = None
    """Of the objects in them, where they are a data set's that has one."""


def within(frame: Frame, box: Box) -> Frame:
    """Returns the same, the object looked for in a box of its pixels; raises InvalidInput for one that is not in it."""
    left, top, right, bottom = box
    width, height = frame.camera.size
    if not (0 <= left <= right < width and 0 <= top <= bottom < height):
        expected = f"expected u0,v0,u1,v1 from 0,0 to {width - 1},{height - 1}"
        raise InvalidInput(f"box: {expected}, got {','.join(map(str, box))} ({frame.name})")
    inside = np.zeros((height, width), dtype=bool)
    inside[top : bottom + 1, left : right + 1] = True
    return replace(frame, wanted=inside if frame.wanted is None else inside & frame.wanted)
