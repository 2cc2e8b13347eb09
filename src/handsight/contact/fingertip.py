"""Fingertip shapes: a closed convex surface, the part of it that is sensed, and where its sensor sits.

The frame `surface` (the tip's frame) has its origin at the surface's centre, its axes along the semi-axes,
and the tip points along +z. A pull at one point of a closed surface is a push at the point behind it, so a
shape carries what tells them apart: a `cap` (least z that is sensed) and a `max_friction`.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput

SMALLEST, LARGEST = 1e-5, 0.2
"""Semi-axes of a fingertip [m]; beyond them the unit is wrong."""
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
    _numbers: Array = field(init=False, repr=False)
    """As `_packed`."""

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
        axes.flags.writeable = False
        object.__setattr__(self, "semi_axes", axes)
        _set_sensed(self, cap, max_friction, min_force, T_surface_sensor)


@dataclass(frozen=True, slots=True, init=False, eq=False)
class Sphere:
    """A spherical fingertip."""

    radius: float
    """[m]"""
    cap: float | None
    """Least z of a point that is sensed [m], between -radius and radius; None: the closed surface."""
    max_friction: float | None
    """Largest |tangential force| / normal force; None: no limit."""
    min_force: float
    """Forces weaker than this are no contact [N]."""
    T_surface_sensor: Array | None
    """(4, 4) pose of the sensor's frame in the surface's; None: wrenches come in the surface's frame."""
    _numbers: Array = field(init=False, repr=False)
    """As `_packed`."""

    def __init__(
        self,
        radius: float,
        cap: float | None = None,
        max_friction: float | None = None,
        min_force: float = 0.1,
        T_surface_sensor: ArrayLike | None = None,
    ) -> None:
        """Lengths in metres; raises InvalidInput (InvalidTransform for the pose) naming the field."""
        object.__setattr__(self, "radius", _check_length(checks.positive(radius, "radius"), "radius"))
        _set_sensed(self, cap, max_friction, min_force, T_surface_sensor)

    @property
    def semi_axes(self) -> Array:
        """(3,) three times the radius [m]."""
        return np.full(3, self.radius)


Fingertip = Ellipsoid | Sphere


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


def _check_length(length: float, name: str) -> float:
    if length > LARGEST:
        raise InvalidInput(f"{name}: expected metres, at most {LARGEST}, got {length:g} (millimetres?)")
    if not length >= SMALLEST:
        raise InvalidInput(f"{name}: expected metres, at least {SMALLEST:g}, got {length:g}")
    return length


def _set_sensed(
    tip: Fingertip,
    cap: float | None,
    max_friction: float | None,
    min_force: float,
    T_surface_sensor: ArrayLike | None,
) -> None:
    """Sets the fields that every shape has, checked."""
    top = float(tip.semi_axes[2])
    if cap is not None:
        cap = float(checks.finite(cap, "cap", ()))
        if not -top < cap < top:
            raise InvalidInput(f"cap: expected metres within the tip's ends ±{top:g}, got {cap:g}")
    if max_friction is not None:
        max_friction = checks.positive(max_friction, "max_friction")
    min_force = checks.positive(min_force, "min_force")
    if min_force < LEAST_FORCE:
        raise InvalidInput(f"min_force: expected newtons, at least {LEAST_FORCE:g}, got {min_force:g}")
    T = None
    if T_surface_sensor is not None:
        T = se3.check(T_surface_sensor, "T_surface_sensor")
        T.flags.writeable = False
    for name, value in (
        ("cap", cap),
        ("max_friction", max_friction),
        ("min_force", min_force),
        ("T_surface_sensor", T),
    ):
        object.__setattr__(tip, name, value)
    object.__setattr__(tip, "_numbers", _packed(tip))


def _packed(tip: Fingertip) -> Array:
    """The tip as contact sensing's kernels take it; where is what says `handsight._kernels.sensing_steps`."""
    axes, W = tip.semi_axes, 1 / tip.semi_axes
    cap = -np.inf if tip.cap is None else tip.cap
    friction = np.inf if tip.max_friction is None else tip.max_friction
    # A power of two: forces are compared squared, and their squares must not under- or overflow.
    unit = np.ldexp(1.0, 1 - np.frexp(tip.min_force)[1])
    T = np.eye(4) if tip.T_surface_sensor is None else tip.T_surface_sensor
    judged = [1 / W.prod(), cap, friction * friction, unit, (tip.min_force * unit) ** 2]
    return np.concatenate([W, axes, W.prod() / W, judged, T[:3, :3].ravel(), T[:3, 3]])
