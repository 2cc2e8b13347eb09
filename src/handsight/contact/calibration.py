"""Force/torque sensor: its bias, and the mass and centre of mass of the fingertip that hangs on it.

With the tip touching nothing and held still, in the sensor's frame, about the sensor's origin:

    force  = bias_force  + mass · gravity
    torque = bias_torque + center_of_mass × (mass · gravity)

These readings are what the tip exerts on the sensor (`reading="on_sensor"`, as ATI's sensors give them): a
tip at rest reads its weight, along gravity. MuJoCo and some drivers give the reverse, what the sensor exerts
on the tip (`reading="on_tip"`): then both weight terms change sign.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.checks import Array
from handsight.errors import InvalidInput

Reading = Literal["on_sensor", "on_tip"]

LEAST_ROWS = 3
"""Two orientations leave the centre of mass unknown along one direction."""
WORST_CONDITION = 50.0
"""About 2.5 degrees of spread: there the noise of the answer is fifty times that of the readings."""
GRAVITY_RANGE = (1.5, 30.0)
"""Lengths of gravity that can be in m/s² (the Moon's is 1.6, Jupiter's 25); a unit vector is none of them."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchCalibration:
    """Bias of a force/torque sensor and the weight on it, in the sensor's frame."""

    bias_force: Array
    """(3,) reading without load [N]."""
    bias_torque: Array
    """(3,) [N m]."""
    mass: float
    """Of all that hangs on the sensor [kg], above zero."""
    center_of_mass: Array
    """(3,) from the sensor's origin [m]."""
    residual_force: Array
    """(3,) root mean square of what the model leaves, per axis [N]."""
    residual_torque: Array
    """(3,) [N m]."""
    condition: float
    """Conditioning of the worse of the two fits: how much noise is amplified; 1.4 at best."""
    reading: Reading = "on_sensor"
    """What the readings were: of the tip on the sensor, or of the sensor on the tip."""


def calibrate_wrench(
    forces: ArrayLike, torques: ArrayLike, gravities: ArrayLike, *, reading: Reading = "on_sensor"
) -> WrenchCalibration:
    """Bias, mass and centre of mass from readings in several orientations, by linear least squares.

    `forces` [N], `torques` [N m] and `gravities` (the vector of gravity in the sensor's frame [m/s²]), (n, 3)
    each, the tip touching nothing. At least three orientations that do not share an axis; six along ±x, ±y,
    ±z are best. Raises InvalidInput for fewer, for orientations too alike, and for a mass that is not above
    zero.
    """
    F, M, G = (
        checks.finite(value, name, (None, 3))
        for value, name in ((forces, "forces"), (torques, "torques"), (gravities, "gravities"))
    )
    if not len(F) == len(M) == len(G):
        raise InvalidInput(f"forces, torques, gravities: expected one length, got {[len(F), len(M), len(G)]}")
    sign = _sign(reading)
    length = _check_gravities(G)
    g = sign * G / length
    eye = np.broadcast_to(np.eye(3), (len(g), 3, 3))
    design_force = np.concatenate([eye, g[:, :, None]], axis=2).reshape(-1, 4)
    design_torque = np.concatenate([eye, -se3.skew(g)], axis=2).reshape(-1, 6)
    condition = max(_condition(design_force, G), _condition(design_torque, G))
    x_force = np.linalg.lstsq(design_force, F.ravel(), rcond=None)[0]
    x_torque = np.linalg.lstsq(design_torque, M.ravel(), rcond=None)[0]
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
        residual_force=_rms(F - (design_force @ x_force).reshape(-1, 3)),
        residual_torque=_rms(M - (design_torque @ x_torque).reshape(-1, 3)),
        condition=condition,
        reading=reading,
    )


def compensate(
    forces: ArrayLike, torques: ArrayLike, gravities: ArrayLike, calibration: WrenchCalibration
) -> tuple[Array, Array]:
    """What the object exerts on the tip: readings without bias and weight, (3,) or (n, 3) each [N], [N m].

    In the sensor's frame, about its origin, as `contact_from_wrench` takes it; readings of the sensor on the
    tip are turned round. One gravity (3,) [m/s²] serves for many readings. Raises InvalidInput.
    """
    stack: tuple[int | None, ...] = (None, 3) if np.ndim(forces) > 1 else (3,)
    F, M = checks.finite(forces, "forces", stack), checks.finite(torques, "torques", stack)
    G = checks.finite(gravities, "gravities", stack if np.ndim(gravities) > 1 else (3,))
    if F.shape != M.shape or (G.ndim > 1 and G.shape != F.shape):
        raise InvalidInput(
            f"forces, torques, gravities: expected one shape, got {F.shape}, {M.shape}, {G.shape}"
        )
    sign = _sign(calibration.reading)
    weight = calibration.mass * G
    return (
        sign * (F - calibration.bias_force) - weight,
        sign * (M - calibration.bias_torque) - np.cross(calibration.center_of_mass, weight),
    )


def _sign(reading: str) -> float:
    if reading not in get_args(Reading):
        raise InvalidInput(f"reading: expected one of {', '.join(get_args(Reading))}, got {reading!r}")
    return 1.0 if reading == "on_sensor" else -1.0


def _check_gravities(gravities: Array) -> float:
    """The root mean square length of gravity [m/s²]."""
    if len(gravities) < LEAST_ROWS:
        raise InvalidInput(f"gravities: expected at least {LEAST_ROWS} orientations, got {len(gravities)}")
    lengths = np.linalg.norm(gravities, axis=1)
    least, most = GRAVITY_RANGE
    for i in np.flatnonzero(~((lengths >= least) & (lengths <= most))):
        raise InvalidInput(
            f"gravities[{i}]: expected a length of {least:g} to {most:g} m/s², got {lengths[i]:.4g}"
            + (" (a unit vector?)" if abs(lengths[i] - 1) < 0.01 else "")
        )
    return float(np.sqrt((lengths**2).mean()))


def _condition(design: Array, gravities: Array) -> float:
    """The conditioning of a fit whose columns have like units; raises InvalidInput where it is hopeless."""
    values = np.linalg.svd(design, compute_uv=False)
    if values[-1] * WORST_CONDITION < values[0]:
        directions = gravities / np.linalg.norm(gravities, axis=1, keepdims=True)
        spread = np.linalg.svd(directions - directions.mean(axis=0), compute_uv=False)[1]
        spread_deg = np.rad2deg(spread / np.sqrt(len(gravities)))
        raise InvalidInput(
            f"gravities: expected orientations that turn about two axes, got {len(gravities)} with a spread "
            f"of {spread_deg:.2g} degrees about the second (conditioning "
            f"{values[0] / max(values[-1], 1e-300):.2g}, at most {WORST_CONDITION:g})"
        )
    return float(values[0] / values[-1])


def _rms(residuals: Array) -> Array:
    return np.asarray(np.sqrt((residuals**2).mean(axis=0)), dtype=np.float64)
