"""When a tracker corrects, and what it expects."""

from dataclasses import dataclass

import numpy as np

from handsight import checks
from handsight.correction import MOST_SAMPLES
from handsight.correction.mean import checked_answer
from handsight.correction.outside import MOST_POINTS
from handsight.errors import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackerSettings:
    """A `TrackerSettings` says when a tracker corrects, how it expects things to move, and when it admits that it
    does not know.

    The defaults serve a hand that holds still or moves slowly.
    """

    rate: float | None = None
    """Corrections a second while something is touched, whether or not anything changed; None: only when it did."""
    moved: float = 0.001
    """A contact that moved so far in the palm is a new one [m]."""
    turned: float = float(np.deg2rad(5.0))
    """Or whose normal turned so far [rad]."""
    process_noise_position: float = 0.002
    """Random walk of the object in the palm: one standard deviation per axis after a second [m]; it grows with the root
    of time. Objects between simulated tips move by millimetres as they are lifted, and creep on after."""
    process_noise_rotation: float = float(np.deg2rad(3.0))
    """[rad]; a box between three simulated tips creeps by degrees while it is carried."""
    regrasp_position: float = 0.005
    """How far it may be pushed when a finger comes or goes, per axis [m]."""
    regrasp_rotation: float = float(np.deg2rad(3.0))
    """[rad]"""
    memory: float = 5.0
    """How long a contact that was lifted is still believed [s]; 0: not at all."""
    answer: str = "best"
    """As `correct_pose` takes it: the mean where contacts bound a slide and do not fix it, else the maximum."""
    samples: int = 0
    """Above 0: the mean from so many samples instead, an independent check; 4000 take some 50 ms."""
    outside: int = 200
    """How many points of the hand's other links, none of which can be inside the object, are used; 0: none.

    There are none where the hand's file has no shapes, nor where an observation lacks the joints of some link."""
    images: bool = True
    """Whether depth images are looked at, where the rig's camera has intrinsics; its poses are then left out."""
    uncertain_position: float = 0.015
    """Largest standard deviation of the position [m] that counts as tracking."""
    lost_after: float = 10.0
    """How long nothing may be touched and nothing seen [s]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput."""
        if self.rate is not None:
            checks.positive(self.rate, "settings.rate")
        for names, most in ((LIMITS, np.inf), (STEPS, checks.MAX_DISTANCE)):
            for name in names:
                _check_size(getattr(self, name), f"settings.{name}", most)
        checked_answer(self.answer, "settings.answer")
        checks.integer(self.samples, "settings.samples", MOST_SAMPLES)
        checks.integer(self.outside, "settings.outside", MOST_POINTS)


LIMITS = ("moved", "turned", "memory", "uncertain_position", "lost_after")
"""Infinite: never."""
STEPS = ("process_noise_position", "process_noise_rotation", "regrasp_position", "regrasp_rotation")


def _check_size(value: object, name: str, most: float) -> None:
    """Raises InvalidInput where a setting is no number from 0 to `most`."""
    endless = isinstance(value, float) and value == most == np.inf
    number = 0.0 if endless else float(checks.finite(value, name, ()))  # type: ignore[arg-type]
    if not 0 <= number <= most:
        raise InvalidInput(f"{name}: expected a number from 0 to {most:g}, got {number:g}")
