"""What is wrong with the readings of fingertips and tactile surfaces in a recording, for a person who writes a rig."""

from dataclasses import dataclass, field

import numpy as np

from handsight.checks import Array
from handsight.contact import TactileSurface
from handsight.messages.report import shortened
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.rig.units import MAX_FORCE

SOME = 256
FEW = 5
"""Readings of a sensor that are kept, spread over the recording; with fewer than `FEW` nothing is judged."""
MOST_COUNTS = 4095
MIN_VALUES = 8
"""Readings of 12 bits whose bytes are swapped are below 4096 once they are swapped again; values that say so."""
AT_REST = 0.05
"""Share of a taxel's readings that may be below what it reads at rest: noise, and stray readings."""
MANY = 0.5
SELDOM = 0.1
"""An inverted sensor has at least this share of its readings within a tenth of their range below the largest, as at
rest, and less than this within a tenth above the least."""


@dataclass(slots=True, eq=False)
class Readings:
    """What one sensor has read so far."""

    low: Array
    high: Array
    count: int = 0
    some: list[Array] = field(default_factory=list)  # readings at equal steps of their number
    step: int = 1

    def put(self, values: Array) -> None:
        """Adds a reading."""
        self.low, self.high = np.fmin(self.low, values), np.fmax(self.high, values)
        if self.count % self.step == 0:
            self.some.append(values)
        self.count += 1
        if len(self.some) > SOME:
            self.some = self.some[::2]
            self.step = 2 * self.step

    @property
    def constant(self) -> str:
        """That the readings never change, for a person; empty: they do, or are too few."""
        if self.count < FEW or (self.high > self.low).any():
            return ""
        return f"all {self.count} readings are {'the same' if self.high.any() else 'zero'}: is the sensor on, and "


class SensorFaults:
    """What makes a rig's sensors useless: zeros, no change, a wrong scale, swapped bytes."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._wrenches, self._skin = dict[str, Readings](), dict[str, Readings]()

    def put(self, observation: Observation) -> None:
        """Adds an observation's wrenches and taxels."""
        for read, given in ((self._wrenches, observation.wrenches), (self._skin, observation.skin)):
            for name, values in given.items():
                start = np.array(values, dtype=float)
                read.setdefault(name, Readings(start, start)).put(start)

    def sentences(self) -> list[str]:
        """Returns a sentence for each sensor whose readings cannot be used: which, why, and what to change."""
        topics = self._rig.topics
        found = list[str]()
        for name, read in self._wrenches.items():
            if constant := read.constant:
                flag = "does its driver read it (DG-5F: fingertip_sensor:=true beside ft_broadcaster:=true)?"
                found.append(f"finger {name}: {topics.wrenches.get(name, 'its topic')}: {constant}{flag}")
        for name, read in self._skin.items():
            if what := self._of_surface(name, read):
                path = f"{topics.skin_fields[name]} on " if name in topics.skin_fields else ""
                found.append(f"skin {name}: {path}{topics.skin[name]}: {what}")
        return found

    def _of_surface(self, name: str, read: Readings) -> str:
        """Returns what is wrong with a surface's readings; empty: nothing."""
        if read.constant:
            return f"{read.constant}is this the field that its driver fills?"
        surface = self._rig.skin[name]
        given = np.array([each for each in read.some if np.any(each)])
        if not len(given):
            return ""
        numbers = given[np.isfinite(given)]
        if most := swapped(numbers):
            as_they_are = f"{np.abs(numbers).max():.0f} as they are"
            said = f"at most {most} with their two bytes swapped, {as_they_are}"
            return f"its whole numbers are {said}: have its driver swap them (big-endian?)"
        normal = normals_of(surface, given)
        scale = scale_of(surface)
        pressed = scale * normal
        rest = float(np.nanmedian(normal))
        low = np.nanmin(pressed)
        high = np.nanmax(pressed)
        near = 0.1 * (high - low)
        at_rest = np.nanmean(abs(pressed - high) < near)
        at_most = np.nanmean(abs(pressed - low) < near)
        was_touched = high - low > 2 * surface.threshold
        if was_touched and at_rest >= MANY and at_most < SELDOM:
            reads = f"reads {rest:g} at rest and {low / scale:g} where it is touched, which is inverted"
            return f"{reads}: set skin.{name}.offset: {rest:g} and scale: {-scale:g} in place of {scale:g}"
        in_newtons = surface.components == 3 or (
            scale == 1 and surface.threshold < 1 and not surface.indentation
        )
        rise = rise_of(surface, read)
        if in_newtons and rise > MAX_FORCE:
            more = f"rises by up to {rise:.4g} where at most {MAX_FORCE:g} N on a taxel are expected"
            return f"{more} (counts?): set skin.{name}.scale: newtons a count"
        return ""

    def remarks(self) -> list[str]:
        """Returns a sentence for each surface that was never touched, or has taxels that never change."""
        found = []
        for name, read in self._skin.items():
            surface = self._rig.skin[name]
            if read.count < FEW or not (read.high > read.low).any():
                continue
            if name not in self.touched:
                rises = f"a touched taxel rises by {surface.threshold:g}, and the largest rise was"
                most = f"{rise_of(surface, read):.3g} (threshold, scale?)"
                found.append(f"skin {name}: never touched; {rises} {most}")
            low, high = normals_of(surface, np.array([read.low, read.high]))
            for marked, why in (
                (low == high, "never change: dead?"),
                (np.isnan(low), "never have a number (NaN)"),
            ):
                if 0 < marked.mean() < 0.5:
                    numbers = shortened(map(str, np.flatnonzero(marked)))
                    found.append(f"skin {name}: taxel {', '.join(numbers)} of {len(marked)} {why}")
        return found

    @property
    def touched(self) -> set[str]:
        """The surfaces of which a taxel has risen above its threshold."""
        skin = self._rig.skin
        return {name for name, read in self._skin.items() if rise_of(skin[name], read) > skin[name].threshold}


def scale_of(surface: TactileSurface) -> float:
    """Returns the factor of the readings along the taxels' normals."""
    return float(surface.record["scale"][0, surface.components - 1])


def rise_of(surface: TactileSurface, read: Readings) -> float:
    """Returns by how much a taxel reads more along its normal than at rest, scaled.

    Rest is what it reads least, but for one reading in twenty: an object may be held for most of a recording.
    """
    scale = scale_of(surface)
    (end,) = normals_of(surface, (read.high if scale > 0 else read.low)[None])
    pressed = scale * normals_of(surface, np.array(read.some))
    known = np.isfinite(pressed).any(axis=0)
    rest = np.nanquantile(pressed[:, known], AT_REST, axis=0)
    rises = scale * end[known] - rest
    return float(rises.max(initial=0.0))


def normals_of(surface: TactileSurface, given: Array) -> Array:
    """Returns the unscaled readings along the taxels' normals (m, n) of m readings."""
    return given.reshape(len(given), -1, surface.components)[:, :, -1]


def swapped(values: Array) -> int:
    """Returns the largest of numbers with their two bytes swapped, where these seem to have been swapped; else 0."""
    whole = (values == values.round()).all()
    if not whole or values.min() < -(2**15) or values.max() >= 2**16:
        return 0
    words = np.unique(values.astype(np.int64)).astype(np.uint16)
    most = int(words.byteswap().max())
    small = most <= MOST_COUNTS < np.abs(values).max()
    return most if small and len(words) > MIN_VALUES else 0
