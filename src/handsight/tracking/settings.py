"""When a tracker corrects the pose, which motions of the object it expects, and when the object is lost."""

import math
from dataclasses import dataclass

import numpy as np

from handsight import checks
from handsight.correction.outside import MOST_POINTS
from handsight.errors import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """When a tracker corrects the pose, which motions it expects, and when the object is lost.

    The defaults are for a hand that holds still or moves slowly.
    """

    rate: float | None = None
    """Corrections per second while something is touched, even if nothing has changed; None: only after a change."""
    process_noise_position: float = 0.001
    """Random walk of the object in the palm: one standard deviation per axis after a second [m]; it grows with the root
    of time. Objects between simulated tips move by millimetres while they are lifted, and creep afterwards."""
    process_noise_rotation: float = float(np.deg2rad(3))
    """The same of its rotation [rad]: a box between three simulated tips creeps by degrees while it is carried."""
    memory: float = 5.0
    """How long the contact of a finger that has let go is still used [s]; 0: not at all."""
    outside: int = 200
    """Number of points on the hand's other links, which the object cannot contain; 0: none are used.

    None are used either where the hand's file has no shapes, or where an observation lacks a joint of some link."""
    images: bool = True
    """Whether depth images are used, if the rig's camera has intrinsics; poses from that camera are then left out."""
    concurrent_images: bool = False
    """Whether a thread of its own evaluates depth images: no update then waits for one, its pose is used when it is
    ready, as of the time at which the image was taken, and two runs are no longer equal to the last digit."""
    uncertain_position: float = 0.005
    """Largest standard deviation of the position with which the state is "tracking" [m]: what a next grasp, or placing
    the object, needs."""
    lost_after: float = 10.0
    """The object is lost once nothing was touched, and vision did not detect it, for so long [s]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        if self.rate is not None:
            checks.positive(self.rate, "settings.rate")
        largest = {
            "memory": math.inf,
            "uncertain_position": math.inf,
            "lost_after": math.inf,
            "process_noise_position": checks.MAX_DISTANCE,
            "process_noise_rotation": checks.MAX_DISTANCE,
        }
        for name, most in largest.items():
            value = getattr(self, name)
            if isinstance(value, float) and value == most:
                continue
            number = float(checks.finite(value, f"settings.{name}", ()))
            if not 0 <= number <= most:
                raise InvalidInput(f"settings.{name}: expected a number from 0 to {most:g}, got {number:g}")
        checks.integer(self.outside, "settings.outside", MOST_POINTS)
