"""Fingertip shapes: a closed convex surface, the part of it that is sensed, and where its sensor sits.

The frame `surface` (the tip's frame) has its origin at the surface's centre, its axes along the semi-axes,
and the tip points along +z. A pull at one point of a closed surface is a push at the point behind it, so a
shape carries what tells them apart: a `cap` (least z that is sensed) and a `max_friction`.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks, se3
from handsight._kernels.touch.sensing_records import FINGERTIP
from handsight.checks import Array
from handsight.errors import InvalidInput

SMALLEST, LARGEST = 1e-5, 0.2
"""Semi-axes of a fingertip [m]; beyond them the unit is wrong."""
MOST_FRICTION = 1e3
"""No two materials have more; beyond it there is no limit."""
LEAST_FORCE = 1e-9
"""Smallest `min_force` [N]: below it a force has no direction worth the name."""


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Ellipsoid:
    """An ellipsoidal fingertip (Bicchi, Salisbury and Brock 1993)."""

    semi_axes: Array
    """(3,) along x, y, z of the surface frame [m]."""
    cap: float | None
    """Least z of a point that is sensed [m], within ± semi_axes[2]; None: the closed surface."""
    max_friction: float | None
    """Largest |tangential force| / normal force; None: no limit."""
    min_force: float
    """Forces weaker than this are no contact [N]."""
    T_surface_sensor: Array | None
    """(4, 4) pose of the sensor's frame in the surface's; None: wrenches come in the surface's frame."""
    record: NDArray[Any] = field(repr=False)
    """(1,) the same as contact sensing's kernels take it; not to be written to."""

    def __init__(
        self,
        semi_axes: ArrayLike,
        cap: float | None = None,
        max_friction: float | None = None,
        min_force: float = 0.1,
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
            if max_friction > MOST_FRICTION:
                came = f"{max_friction:g} (without a limit: None)"
                raise InvalidInput(f"max_friction: expected at most {MOST_FRICTION:g}, got {came}")
        min_force = checks.positive(min_force, "min_force")
        checks.load(min_force, "min_force", ())
        if min_force < LEAST_FORCE:
            raise InvalidInput(f"min_force: expected newtons, at least {LEAST_FORCE:g}, got {min_force:g}")
        T = None if T_surface_sensor is None else se3.check(T_surface_sensor, "T_surface_sensor")
        pose = np.eye(4) if T is None else T
        lowest = -np.inf if cap is None else cap
        limit = np.inf if max_friction is None else max_friction
        record = np.array([(axes, lowest, limit, min_force, pose[:3, :3], pose[:3, 3])], FINGERTIP)
        axes.flags.writeable = pose.flags.writeable = False
        values = (axes, cap, max_friction, min_force, T, record)
        for name, value in zip(Ellipsoid.__slots__, values, strict=True):
            object.__setattr__(self, name, value)


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Sphere(Ellipsoid):
    """A spherical fingertip: an ellipsoid with equal axes."""

    radius: float
    """[m]"""

    def __init__(
        self,
        radius: float,
        cap: float | None = None,
        max_friction: float | None = None,
        min_force: float = 0.1,
        T_surface_sensor: ArrayLike | None = None,
    ) -> None:
        """Lengths in metres; raises InvalidInput (InvalidTransform for the pose) naming the field."""
        length = checks.positive(radius, "radius")
        _check_length(length, "radius")
        Ellipsoid.__init__(self, (length,) * 3, cap, max_friction, min_force, T_surface_sensor)
        object.__setattr__(self, "radius", length)


Fingertip = Ellipsoid
"""What any fingertip is, so far."""


def unambiguous_cap(fingertip: Fingertip) -> float:
    """The least cap [m] above which no pull can pass for a push, whatever the local torque.

    Above it every force within the friction cone of an inward normal points down the tip (-z), so its reverse
    lies in no such cone. With a lower cap some pulls near its rim *are* the wrench of a push from the other
    side, and no sensor can tell. Raises InvalidInput without a `max_friction`: then no cap suffices.
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
