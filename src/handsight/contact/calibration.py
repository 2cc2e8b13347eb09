"""Calibration of a force/torque sensor: its bias, and the mass and centre of mass of the fingertip that hangs on it.

With the tip touching nothing and at rest, in the sensor's frame, about the sensor's origin:

    force  = bias_force  + mass · gravity
    torque = bias_torque + center_of_mass × (mass · gravity)

These readings are what the tip exerts on the sensor (`reading="on_sensor"`, as ATI's sensors give them): a
tip at rest reads its weight, along gravity. MuJoCo and some drivers give the reverse, what the sensor exerts
on the tip (`reading="on_tip"`): then both weight terms change sign.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.representation import short_repr

Reading = Literal["on_sensor", "on_tip"]

GRAVITY_RANGE = (1.5, 30)
"""Lengths that gravity can have [m/s²]: the Moon's is 1.6, Jupiter's 25; a unit vector is outside."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchCalibration:
    """Bias of a force/torque sensor and the mass on it, in the sensor's frame."""

    bias_force: Array
    """(3,) force reading without load [N]."""
    bias_torque: Array
    """(3,) torque reading without load [N m]."""
    mass: float
    """Mass of all that hangs on the sensor [kg], above zero."""
    center_of_mass: Array
    """(3,) centre of that mass from the sensor's origin [m]."""
    residual_force: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) standard deviation of the force readings about the fit, per axis [N]; `Finger.calibrated` takes it."""
    residual_torque: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) standard deviation of the torque readings about the fit, per axis [N m]."""
    condition: float = 1.0
    """Condition number of the worse of the two fits, by which noise is amplified; 1.4 at best."""
    reading: Reading = "on_sensor"
    """Whether readings are of the tip on the sensor, or of the sensor on the tip."""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Raises an InvalidInput that names the first wrong field."""
        mass = float(checks.finite(self.mass, "mass", ()))
        if not 0 <= mass <= 100:
            raise InvalidInput(f"mass: expected kilograms from 0 to 100, got {mass:g}")
        object.__setattr__(self, "mass", mass)
        for name, check in (
            ("bias_force", checks.load),
            ("bias_torque", checks.load),
            ("center_of_mass", checks.position),
        ):
            object.__setattr__(self, name, check(getattr(self, name), name, (3,)))
        _sign(self.reading)


def calibrate_wrench(
    forces: ArrayLike, torques: ArrayLike, gravities: ArrayLike, *, reading: Reading = "on_sensor"
) -> WrenchCalibration:
    """Returns bias, mass and centre of mass from readings in several orientations, by linear least squares.

    `forces` [N], `torques` [N m] and `gravities` (the vector of gravity in the sensor's frame [m/s²]) are (n, 3) each,
    the tip touching nothing. At least three orientations that do not share an axis are needed; six along ±x, ±y, ±z are
    best. Raises InvalidInput for fewer, for orientations that are too similar, and for a mass that is not above zero.
    """
    F = checks.load(forces, "forces", (None, 3))
    M = checks.load(torques, "torques", (None, 3))
    G = checks.finite(gravities, "gravities", (None, 3))
    if not len(F) == len(M) == len(G):
        raise InvalidInput(f"forces, torques, gravities: expected one length, got {[len(F), len(M), len(G)]}")
    sign = _sign(reading)
    # Two orientations leave the centre of mass unknown along one direction.
    if len(G) < 3:
        raise InvalidInput(f"gravities: expected at least 3 orientations, got {len(G)}")
    lengths = np.linalg.norm(G, axis=1)
    least, most = GRAVITY_RANGE
    for i, each in enumerate(lengths):
        if not least <= each <= most:
            came = f"{each:.4g} (a unit vector?)" if abs(each - 1) < 0.01 else f"{each:.4g}"
            raise InvalidInput(f"gravities[{i}]: expected a length of {least:g} to {most:g} m/s², got {came}")
    length = float(np.sqrt((lengths**2).mean()))
    g = sign * G / length
    x_force, residual_force, condition_force = _fit(g[:, :, None], F)
    x_torque, residual_torque, condition_torque = _fit(-se3.skew(g), M)
    mass = float(x_force[3]) / length
    if not mass > 0:
        raise InvalidInput(
            f"forces: expected readings that give a mass above 0, got {mass:.3g} kg; for "
            f"reading={reading!r} a tip at rest reads its weight {'along' if sign > 0 else 'against'} "
            f"gravity, else pass the other reading ({', '.join(get_args(Reading))})"
        )
    return WrenchCalibration(
        bias_force=x_force[:3],
        bias_torque=x_torque[:3],
        mass=mass,
        center_of_mass=x_torque[3:] / (mass * length),
        residual_force=residual_force,
        residual_torque=residual_torque,
        condition=max(condition_force, condition_torque),
        reading=reading,
    )


def compensate(
    forces: ArrayLike, torques: ArrayLike, gravities: ArrayLike, calibration: WrenchCalibration
) -> tuple[Array, Array]:
    """Returns the force [N] and torque [N m] of the object on the tip: readings (3,) or (n, 3) without bias and weight.

    They are in the sensor's frame, about its origin, as `contact_from_wrench` takes them; the sign of readings "on_tip"
    is reversed. One gravity (3,) [m/s²] serves for many readings. Raises InvalidInput.
    """
    stack: tuple[int | None, ...] = (3,) if checks.ndim(forces) == 1 else (None, 3)
    if not isinstance(calibration, WrenchCalibration):
        raise InvalidInput(f"calibration: expected a WrenchCalibration, got {type(calibration).__name__}")
    F = checks.load(forces, "forces", stack)
    M = checks.load(torques, "torques", stack)
    G = checks.finite(gravities, "gravities", (3,) if checks.ndim(gravities) == 1 else stack)
    checks.within(G, "gravities", GRAVITY_RANGE[1], "m/s²")
    if F.shape != M.shape or (G.ndim > 1 and G.shape != F.shape):
        raise InvalidInput(
            f"forces, torques, gravities: expected one shape, got {F.shape}, {M.shape}, {G.shape}"
        )
    return compensated(F, M, G, calibration)


def compensated(F: Array, M: Array, gravities: Array, calibration: WrenchCalibration) -> tuple[Array, Array]:
    """Returns `compensate` of arrays that are not checked."""
    sign = _sign(calibration.reading)
    weight = calibration.mass * gravities
    torque = sign * (M - calibration.bias_torque) - np.cross(calibration.center_of_mass, weight)
    return sign * (F - calibration.bias_force) - weight, torque


def _sign(reading: str) -> float:
    if not isinstance(reading, str) or reading not in get_args(Reading):
        names = ", ".join(get_args(Reading))
        raise InvalidInput(f"reading: expected one of {names}, got {checks.brief(reading)!r}")
    return 1.0 if reading == "on_sensor" else -1.0


def _fit(slopes: Array, readings: Array) -> tuple[Array, Array, float]:
    """Returns the coefficients of a bias and of `slopes` (n, 3, k), the residuals' sigmas (3,), the condition number.

    Residuals are fewer degrees of freedom than readings: each coefficient takes one, a third of it from each axis.
    Raises InvalidInput above a condition number of 50, which is about 2.5 degrees of spread of the orientations.
    """
    design = np.concatenate([np.broadcast_to(np.eye(3), (len(slopes), 3, 3)), slopes], axis=2)
    x, _, _, singular = np.linalg.lstsq(design.reshape(-1, design.shape[2]), readings.ravel(), rcond=None)
    if singular[-1] * 50 < singular[0]:
        raise InvalidInput(
            "gravities: expected orientations that turn about two axes, with a condition number of at most 50, got "
            f"{singular[0] / max(singular[-1], 1e-300):.2g}"
        )
    freedom = len(readings) - design.shape[2] / 3
    left = np.sqrt(((readings - design @ x) ** 2).sum(axis=0) / freedom)
    return x, left, float(singular[0] / singular[-1])
