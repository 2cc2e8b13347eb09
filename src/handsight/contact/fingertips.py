"""Shapes of fingertips: a closed convex surface, the part of it that is sensed, and the pose of its sensor.

The frame `surface` (the tip's frame) has its origin at the surface's centre, its axes along the semi-axes,
and the tip points along +z. A pull at one point of a closed surface has the wrench of a push at the opposite point.
A `cap` (least z that is sensed) and a `max_friction` decide between the two.
"""

import re
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact.kernels.sensing_records import FINGERTIP
from handsight.errors import InvalidInput
from handsight.representation import short_repr

MIN_FORCE = 0.1  # least force of a contact where none is given [N]
SMALLEST, LARGEST = 1e-5, 0.2  # range of a fingertip's semi-axes [m]; a length outside of it has another unit


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Ellipsoid:
    """Ellipsoidal fingertip (Bicchi, Salisbury and Brock 1993)."""

    semi_axes: Array
    """(3,) semi-axes along x, y, z of the surface frame [m]."""
    cap: float | None
    """Least z of a sensed point [m], within ± semi_axes[2]; None: the whole closed surface is sensed."""
    max_friction: float | None
    """Largest |tangential force| / normal force; None: no limit."""
    min_force: float
    """Least force of a contact [N]."""
    T_surface_sensor: Array | None
    """(4, 4) pose of the sensor's frame in the surface's; None: wrenches are in the surface's frame."""
    record: NDArray[np.void] = field(repr=False)
    """(1,) the same values as a record for the kernels; must not be written to."""

    __repr__ = short_repr

    def __init__(
        self,
        semi_axes: ArrayLike,
        cap: float | None = None,
        max_friction: float | None = None,
        min_force: float = MIN_FORCE,
        T_surface_sensor: ArrayLike | None = None,
    ) -> None:
        """Lengths in metres; raises InvalidInput (InvalidTransform for the pose) naming the field."""
        axes = checks.finite(semi_axes, "semi_axes", (3,))
        for i, length in enumerate(axes):
            _check_length(length, f"semi_axes[{i}]")
        top = float(axes[2])
        if cap is not None:
            cap = float(checks.finite(cap, "cap", ()))
            if not -top < cap < top:
                came = checks.metres_text(cap, top) if abs(cap) > 1 else f"{cap:g}"
                raise InvalidInput(f"cap: expected metres within the tip's ends ±{top:g}, got {came}")
        if max_friction is not None:
            max_friction = checks.positive(max_friction, "max_friction")
            if max_friction > 1000:  # no two materials have more
                raise InvalidInput(
                    f"max_friction: expected at most 1000, or None for no limit, got {max_friction:g}"
                )
        min_force = float(checks.load(min_force, "min_force", ()))
        if min_force < 1e-9:
            raise InvalidInput(f"min_force: expected newtons, at least 1e-09, got {min_force:g}")
        T = None if T_surface_sensor is None else se3.check(T_surface_sensor, "T_surface_sensor")
        pose = np.eye(4) if T is None else T
        lowest = -np.inf if cap is None else cap
        limit = np.inf if max_friction is None else max_friction
        record = np.array([(axes, lowest, limit, min_force, pose[:3, :3], pose[:3, 3])], FINGERTIP)
        axes.flags.writeable = pose.flags.writeable = False
        values = (axes, cap, max_friction, min_force, T, record)
        for name, value in zip(Ellipsoid.__slots__, values, strict=True):
            object.__setattr__(self, name, value)

    def larger(self, by: float) -> "Ellipsoid":
        """Returns this tip with semi-axes longer by so much [m], negative for a smaller one; raises InvalidInput."""
        axes = self.semi_axes + by
        T = self.T_surface_sensor
        return Ellipsoid(axes, self.cap, self.max_friction, self.min_force, T)

    def with_sensor(self, T_surface_sensor: ArrayLike) -> "Ellipsoid":
        """Returns this tip with its sensor at another pose (4, 4); raises InvalidInput."""
        return Ellipsoid(self.semi_axes, self.cap, self.max_friction, self.min_force, T_surface_sensor)


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Sphere(Ellipsoid):
    """Spherical fingertip: an ellipsoid with equal axes."""

    radius: float
    """Radius [m]."""

    __repr__ = short_repr

    def __init__(
        self,
        radius: float,
        cap: float | None = None,
        max_friction: float | None = None,
        min_force: float = MIN_FORCE,
        T_surface_sensor: ArrayLike | None = None,
    ) -> None:
        """Lengths in metres; raises InvalidInput (InvalidTransform for the pose) naming the field."""
        length = checks.positive(radius, "radius")
        _check_length(length, "radius")
        Ellipsoid.__init__(self, (length,) * 3, cap, max_friction, min_force, T_surface_sensor)
        object.__setattr__(self, "radius", length)


Fingertip = Ellipsoid  # the type of every fingertip; all shapes are ellipsoids so far


def unambiguous_cap(fingertip: Fingertip) -> float:
    """Returns the least cap [m] above which no pull has the wrench of a push, whatever the local torque.

    Above that height every force within the friction cone of an inward normal points down the tip (-z), so the
    reverse force lies in no such cone. With a lower cap some pulls near its rim have the wrench of a push from the
    other side, and no sensor can distinguish them. Raises InvalidInput without a `max_friction`: then no cap suffices.
    """
    if fingertip.max_friction is None:
        raise InvalidInput("fingertip: expected a max_friction to find an unambiguous cap with, got None")
    narrowest = float(min(fingertip.semi_axes[:2]))
    height = float(fingertip.semi_axes[2])
    # At the rim z = s c the normal leans from z by at most atan(√(1 - s²) c / (s a)); friction adds atan μ.
    return height / float(np.hypot(1.0, narrowest / (fingertip.max_friction * height)))


def _check_length(length: float, name: str) -> None:
    if length > LARGEST:
        came = checks.metres_text(length, LARGEST)
        raise InvalidInput(f"{name}: expected metres, at most {LARGEST}, got {came}")
    if not length >= SMALLEST:
        raise InvalidInput(f"{name}: expected metres, at least {SMALLEST:g}, got {length:g}")


FINGERTIP_HELP = """\
ellipsoid:A,B,C<unit> or sphere:R<unit>, semi-axes along x, y, z of the tip, which points along +z;
then options, each after a comma (or a semicolon):
  cap=Z<unit>         least z that is sensed, from the centre (without it: the whole closed surface)
  friction=MU         largest tangential / normal force (without it: no limit)
  min_force=F         newtons below which nothing is touched (0.1)
  sensor=X,Y,Z<unit>  where the sensor's origin sits in the surface's frame, its axes parallel
                      (without it: at the centre)
A length needs its unit: mm, cm or m. Example: ellipsoid:8,8,12mm,cap=-2mm,friction=1.2
"""
ARGUMENTS = {
    "cap": "cap",
    "friction": "max_friction",
    "min_force": "min_force",
    "sensor": "T_surface_sensor",
}
"""Arguments of a fingertip, by the options of its text."""
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z]*)")


def parse_fingertip(text: str) -> Fingertip:
    """Returns the fingertip of a text such as `ellipsoid:8,8,12mm,cap=-2mm`; its grammar is `FINGERTIP_HELP`.

    Raises an InvalidInput that quotes the part at fault.
    """
    shape, colon, rest = text.partition(":")
    shape = shape.strip().lower()
    if shape not in ("ellipsoid", "sphere") or not colon:
        raise InvalidInput(f"fingertip: expected ellipsoid:A,B,Cmm or sphere:Rmm, got {text!r}")
    sizes, *parts = re.split(r"[,;](?=[^,;=]*=)", rest)
    lengths = _lengths(sizes, shape, 3 if shape == "ellipsoid" else 1)
    arguments = dict[str, Any]()
    for part in parts:
        name, _, value = (word.strip() for word in part.partition("="))
        argument = ARGUMENTS.get(name)
        if argument is None or argument in arguments:
            raise InvalidInput(f"fingertip: expected options {', '.join(ARGUMENTS)}, each once, got {name!r}")
        if name == "cap":
            arguments[argument] = _lengths(value, name, 1)[0]
        elif name == "sensor":
            arguments[argument] = se3.compose(np.eye(3), np.array(_lengths(value, name, 3)))
        else:
            match = _NUMBER.fullmatch(value.removesuffix("N") if name == "min_force" else value)
            if not match or match[2]:
                raise InvalidInput(f"fingertip: {name}: expected a number, got {value!r}")
            arguments[argument] = float(match[1])
    try:
        return Ellipsoid(lengths, **arguments) if shape == "ellipsoid" else Sphere(lengths[0], **arguments)
    except InvalidInput as error:
        raise InvalidInput(f"fingertip {text!r}: {error}") from None


def _lengths(text: str, name: str, count: int) -> list[float]:
    """Returns `count` lengths [m]; the unit of the last one is that of those without a unit."""
    parts = [_NUMBER.fullmatch(part.strip()) for part in re.split("[,;]", text)]
    matches = [match for match in parts if match]
    if not len(matches) == len(parts) == count:
        raise InvalidInput(
            f"fingertip: {name}: expected lengths such as 8,8,12mm, {count} in all, got {text!r}"
        )
    metres = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
    units = [match[2] or matches[-1][2] for match in matches]
    if not metres.keys() >= set(units):
        raise InvalidInput(f"fingertip: {name}: expected lengths in mm, cm or m, got {text!r}")
    return [float(match[1]) * metres[unit] for match, unit in zip(matches, units, strict=True)]
