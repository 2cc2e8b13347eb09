"""Which readings of a force/torque sensor cannot be used."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

from handsight.checks import Array

STUCK_AFTER = 0.5
"""A sensor that reads the same for longer, while another's changes, is dead [s]."""
MIN_STUCK_READINGS = 5
"""With fewer equal readings, a slow sensor is not called stuck."""
FULL_SCALE_SHARE = 0.999
"""A reading above this share of a sensor's full scale is rejected."""


@dataclass(slots=True)
class WrenchSensor:
    """What one finger's sensor has read until now: is it stuck, or at full scale?"""

    reading: tuple[float, ...] = ()
    changed: float = -inf  # when the reading last changed [s]
    repeated: int = 0  # number of messages in a row with the same reading

    def read(
        self,
        wrench: Array,
        stamp: float,
        full_scale: tuple[float, float] | None,
        sensors: Iterable["WrenchSensor"],
    ) -> str | None:
        """Returns why the sensor's next wrench (6,) cannot be used; None: it can. `full_scale`: the largest force [N]
        and torque [N m] that the sensor can measure; None: unknown. `sensors`: those of all fingers."""
        reading = tuple(wrench.tolist())
        if reading != self.reading:
            self.reading = reading
            self.changed = stamp
            self.repeated = 0
        self.repeated += 1
        if full_scale is not None:
            force = max(map(abs, reading[:3]))
            torque = max(map(abs, reading[3:]))
            if max(force / full_scale[0], torque / full_scale[1]) >= FULL_SCALE_SHARE:
                return "at full scale ({:g} N, {:g} N m): a dead sensor, or another unit?".format(*full_scale)
        constant = self.repeated >= MIN_STUCK_READINGS and stamp - self.changed > STUCK_AFTER
        if constant and any(other.changed >= stamp - STUCK_AFTER for other in sensors):
            return f"the same six numbers for more than {STUCK_AFTER} s while others change: a dead sensor?"
        return None
