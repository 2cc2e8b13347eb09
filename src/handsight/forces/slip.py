"""Whether the object slips, over time: how near each finger's load is to the limit of friction.

A finger's ratio is √(f_t² + (τ / e)²) / (μ f_n), which is 1 on its limit surface. One finger at its limit does not make
the object slip: one that sticks holds the object in all six directions. So the object slips when the *least* ratio is
at the limit.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from handsight.checks import Array
from handsight.forces.friction import FRICTION, Friction, Vector
from handsight.rig import Rig


class SlipOptions(NamedTuple):
    """`SlipOptions` say when contacts slip, as thresholds on a finger's ratio."""

    begin_ratio: float = 0.95  # a slip begins when the least ratio is above this
    end_ratio: float = 0.93  # and ends when it has been below this for `min_hold`
    stick_ratio: float = 0.4  # or at once when it is below this
    min_hold: float = 0.03  # at the limit of slipping, ratios fluctuate [s]
    time_constant: float = 0.01  # of a load's running mean [s]: its noise is that of a mean over 20 ms
    max_gap: float = 0.1  # between two readings: after a longer one the mean starts anew [s]
    min_force: float = 0.2  # normal force above which a finger's ratio counts [N]
    sure_force: float = 0.5  # normal force above which friction is learnt from the ratio [N]
    min_force_sigmas: float = 10.0  # the first is at least so many standard deviations of a reading
    sure_force_sigmas: float = 40.0  # the second is at least so many


SLIP = SlipOptions()


Load = list[float]
"""Tangential force (3), normal force, torque about the normal."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A `Slip` says whether the object slips at one instant, and how near each finger is to slipping."""

    slipping: bool = False
    """Whether the object slips."""
    ratios: Mapping[str, float] = field(default_factory=dict)
    """By finger that holds the object, its ratio; empty before friction is known."""
    friction: float | None = None
    """Coefficient of friction; None before it was learnt."""
    began: float = -math.inf
    """When the object began to slip, this time or the last [s]."""
    ended: float = -math.inf
    """When the last slip ended [s]."""

    @property
    def least(self) -> float | None:
        """The least ratio, that of the finger that holds the object best; None where no ratio is known."""
        return min(self.ratios.values(), default=None)

    @property
    def pivots(self) -> bool:
        """Whether fewer than two fingers are below their limits: what one finger holds can turn about it, slowly."""
        holding = sum(ratio < SLIP.begin_ratio for ratio in self.ratios.values())
        return bool(self.ratios) and holding < 2


class SlipDetector:
    """A `SlipDetector` detects slips from loads over time.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig) -> None:
        """Starts without loads, and with friction unknown."""
        self.now = Slip()
        """The value after the last update."""
        self.friction = Friction()
        self.stamp = self._at_limit = -math.inf
        """Stamps of the last update, and of the last one at the limit [s]."""
        self._min_forces = {
            name: (
                max(SLIP.min_force, SLIP.min_force_sigmas * finger.sigma_force),
                max(SLIP.sure_force, SLIP.sure_force_sigmas * finger.sigma_force),
            )
            for name, finger in rig.fingers.items()
        }
        """By finger, the normal forces above which its ratio counts, and friction is learnt from it [N]."""
        self._means: Mapping[str, Load] = {}
        """By finger, the running mean of its load."""

    def update(self, stamp: float, fingers: tuple[str, ...], loads: Array | None) -> Slip:
        """Returns whether the object slips at `stamp` [s]; an update not newer than the last one changes nothing.

        `loads` (n, 5) are those on `fingers`, see `FingertipContacts.loads`; NaN where a finger does not measure its
        load.
        """
        if not stamp > self.stamp:
            return self.now
        since, self.stamp = stamp - self.stamp, stamp
        rows = () if loads is None else zip(fingers, loads.tolist(), strict=True)
        weight = 1 - math.exp(-since / SLIP.time_constant)
        before = self._means if since <= SLIP.max_gap else {}
        # A load without a normal force, or with NaN, has no ratio.
        self._means = {
            name: [mean + weight * (x - mean) for mean, x in zip(before.get(name, row), row, strict=True)]
            for name, row in rows
            if row[3] > 0 and math.isfinite(sum(row))
        }
        vectors, sure = dict[str, Vector](), dict[str, Vector]()
        for name, (x, y, z, normal, torque) in self._means.items():
            enough, enough_to_learn = self._min_forces[name]
            if normal > enough:
                vectors[name] = x / normal, y / normal, z / normal, torque / FRICTION.torsion / normal
            if normal > enough_to_learn:
                sure[name] = vectors[name]
        self.friction.update(sure)
        mu = self.friction.coefficient
        ratios = {} if mu is None else {name: math.hypot(*vector) / mu for name, vector in vectors.items()}

        # Hysteresis, in the ratio and in time.
        was, least = self.now, min(ratios.values(), default=0.0)
        if least >= (SLIP.end_ratio if was.slipping else SLIP.begin_ratio):
            self._at_limit = stamp
        holds_after = SLIP.min_hold if was.slipping else 0.0
        slipping = least >= SLIP.stick_ratio and stamp - self._at_limit <= holds_after
        began = stamp if slipping and not was.slipping else was.began
        ended = stamp if was.slipping and not slipping else was.ended
        self.now = Slip(slipping, ratios, mu, began, ended)
        return self.now
