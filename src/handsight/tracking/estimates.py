"""What a tracker has estimated of values that a rig or a model declares, beside what is declared."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from handsight.forces import ObjectWeight
from handsight.tracking.tracker import Tracker

TELLS = 0.9  # a row is shown where the estimate's sigma is below this share of the declared one
SCALES = {"": 1, "mm": 1000, "ms": 1000, "g": 1000, "°": math.degrees(1)}
"""How many of each unit of the table there are in one of SI's."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """One declared value, and what the tracker made of it while it followed an object."""

    name: str
    """Such as `camera shift x` or `joint robot0:FFJ2`."""
    unit: str
    declared: float | None
    """In `unit`; None where nothing is declared."""
    sigma_declared: float | None
    """Its standard deviation; None where none is declared."""
    estimated: float
    """In `unit`; what is declared is the estimate's prior."""
    sigma_estimated: float
    """Its standard deviation."""

    def row(self) -> tuple[str, str, str, str]:
        """Returns the value as a row of a table: name, unit, declared and estimated."""
        declared = "-"
        if self.declared is not None:
            sigma = "?" if self.sigma_declared is None else f"{self.sigma_declared:.3g}"
            declared = f"{self.declared:.4g} ± {sigma}"
        return self.name, self.unit, declared, f"{self.estimated:.4g} ± {self.sigma_estimated:.3g}"


def estimated_values(tracker: Tracker, weight: ObjectWeight | None) -> list[Estimated]:
    """Returns the values of which the tracker knows more than was declared; `weight`: the last weighing, if any."""
    values = [*_camera(tracker), *_joints(tracker), *_object(tracker, weight)]
    return [v for v in values if v.sigma_declared is None or v.sigma_estimated < TELLS * v.sigma_declared]


def _camera(tracker: Tracker) -> Iterator[Estimated]:
    """Yields vision's constant error, along the axes of the camera's mount at the object, and its latency."""
    camera = tracker.vision.camera
    latency = tracker.vision_latency()
    if tracker.smoother is None or latency is None:
        return
    now = tracker.smoother.now
    bias, covariance = tracker.vision_bias() or (now.vision_bias, now.covariance[6:12, 6:12])
    sigmas = np.sqrt(covariance.diagonal())
    declared = (0.0, camera.sigma_position_constant), (0.0, camera.sigma_rotation_constant)
    for i, axis in enumerate("xyz"):
        yield _scaled(f"camera shift {axis}", "mm", declared[0], (bias[i], sigmas[i]))
    for i, axis in enumerate("xyz", start=3):
        yield _scaled(f"camera turn {axis}", "°", declared[1], (bias[i], sigmas[i]))
    yield _scaled("camera latency", "ms", (camera.latency, camera.sigma_latency), latency)


def _joints(tracker: Tracker) -> Iterator[Estimated]:
    offsets = tracker.joint_offsets
    declared = np.sqrt(offsets.prior.diagonal())
    sigmas = np.sqrt(offsets.covariance.diagonal())
    for joint, mean, before, after in zip(offsets.joints, offsets.mean, declared, sigmas, strict=True):
        yield _scaled(f"joint {joint}", "°", (0.0, before), (mean, after))


def _object(tracker: Tracker, weight: ObjectWeight | None) -> Iterator[Estimated]:
    model, slip = tracker.model, tracker.slip
    if slip.friction is not None and slip.sigma_friction is not None:
        declared = None if model.friction is None else (model.friction, model.sigma_friction)
        yield _scaled("friction", "", declared, (slip.friction, slip.sigma_friction))
    if weight is not None and not weight.reason:
        sigma_mass = tracker.track_state.weight.weigher.sigma_mass
        declared = None if model.mass is None else (model.mass, sigma_mass)
        yield _scaled("object mass", "g", declared, (weight.mass, weight.sigma_mass))


def _scaled(
    name: str, unit: str, declared: tuple[float, float] | None, estimated: tuple[float, float]
) -> Estimated:
    """Returns a value in its unit; both are with their standard deviations, in SI units."""
    scale = SCALES[unit]
    mean, sigma = (None, None) if declared is None else (scale * declared[0], scale * declared[1])
    return Estimated(name, unit, mean, sigma, scale * float(estimated[0]), scale * float(estimated[1]))
