"""When a tracker corrects the pose, and what motions it expects."""

from dataclasses import dataclass

import numpy as np

from handsight import checks
from handsight.correction import MOST_SAMPLES
from handsight.correction.mean import checked_answer
from handsight.correction.outside import MOST_POINTS
from handsight.errors import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """A `TrackerSettings` says when a tracker corrects the pose, what motions it expects, and when the pose is lost.

    The defaults are for a hand that holds still or moves slowly.
    """

    rate: float | None = None
    """Corrections per second while something is touched, even if nothing has changed; None: only when it has."""
    moved: float = 0.001
    """The pose is corrected when a contact has moved so far in the palm [m]."""
    turned: float = float(np.deg2rad(5.0))
    """The pose is corrected when a contact's normal has turned so far [rad]."""
    process_noise_position: float = 0.002
    """Random walk of the object in the palm: one standard deviation per axis after a second [m]; it grows with the root
    of time. Objects between simulated tips move by millimetres as they are lifted, and creep on after."""
    process_noise_rotation: float = float(np.deg2rad(3.0))
    """[rad]; a box between three simulated tips creeps by degrees while it is carried."""
    regrasp_position: float = 0.005
    """How far the object may be pushed when a finger comes or goes, one standard deviation per axis [m]."""
    regrasp_rotation: float = float(np.deg2rad(3.0))
    """[rad]"""
    memory: float = 5.0
    """How long the contact of a finger that has let go is still used [s]; 0: not at all."""
    answer: str = "best"
    """As `correct_pose` takes it: the mean where contacts bound a slide and do not fix it, else the maximum."""
    samples: int = 0
    """Above 0: the mean from so many samples instead, an independent check; 4000 take some 50 ms."""
    outside: int = 200
    """How many points of the hand's other links, none of which can be inside the object, are used; 0: none.

    There are none where the hand's file has no shapes, nor where an observation lacks the joints of some link."""
    images: bool = True
    """Whether depth images are used, where the rig's camera has intrinsics; its poses are then left out."""
    uncertain_position: float = 0.015
    """Largest standard deviation of the position [m] that counts as tracking."""
    lost_after: float = 10.0
    """The pose is lost after nothing was touched, and the object not detected, for so long [s]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        if self.rate is not None:
            checks.positive(self.rate, "settings.rate")
        infinite = "moved", "turned", "memory", "uncertain_position", "lost_after"  # which means never
        motions = "process_noise_position", "process_noise_rotation", "regrasp_position", "regrasp_rotation"
        for name in (*infinite, *motions):
            value, most = getattr(self, name), np.inf if name in infinite else checks.MAX_DISTANCE
            if isinstance(value, float) and value == most == np.inf:
                continue
            number = float(checks.finite(value, f"settings.{name}", ()))
            if not 0 <= number <= most:
                raise InvalidInput(f"settings.{name}: expected a number from 0 to {most:g}, got {number:g}")
        checked_answer(self.answer, "settings.answer")
        checks.integer(self.samples, "settings.samples", MOST_SAMPLES)
        checks.integer(self.outside, "settings.outside", MOST_POINTS)
