"""Whether the object slips: the share of friction's limit that each finger's load takes, over time.

A finger's ratio is √(f_t² + (τ / e)²) / (μ f_n), 1 on its limit surface. One finger at its limit is no slip: fingers
rest there, and one that sticks holds the object in all six directions. So the object slips where the *least* ratio is
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

    begin_ratio: float = 0.95  # share of the least ratio at which a slip begins
    end_ratio: float = 0.93  # it ends where the ratio has been below this share for `min_hold`
    stick_ratio: float = 0.4  # or is below this share
    min_hold: float = 0.03  # on the brink of slipping, ratios go to and fro [s]
    time_constant: float = 0.01  # of the mean of a load [s]: of steady readings as good as the mean of 20 ms
    max_gap: float = 0.1  # between two readings: after more the mean starts anew [s]
    min_force: float = 0.2  # normal force above which a finger's ratio counts [N]
    sure_force: float = 0.5  # normal force above which friction is learnt from it [N]
    min_force_sigmas: float = 10.0  # `min_force` is at least so many standard deviations of a reading
    sure_force_sigmas: float = 40.0  # `sure_force` is at least so many


SLIP = SlipOptions()


Load = list[float]
"""Tangential force (3), normal force, torque about the normal."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A `Slip` says how the object is held at one instant."""

    slipping: bool = False
    """Whether it slips."""
    ratios: Mapping[str, float] = field(default_factory=dict)
    """By finger that holds it, its ratio; empty before friction is known."""
    friction: float | None = None
    """Coefficient of friction; None before it was learnt."""
    began: float = -math.inf
    """When the object began to slip, this time or the last [s]."""
    ended: float = -math.inf
    """When the last slip ended [s]."""

    @property
    def least(self) -> float | None:
        """The ratio of the finger that holds it best."""
        return min(self.ratios.values(), default=None)


class SlipDetector:
    """A `SlipDetector` detects slips from loads over time.

    `update` binds its attributes anew and changes none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig) -> None:
        """Starts without loads, and with friction unknown."""
        self.now = Slip()
        """After the last update."""
        self.friction = Friction()
        self.stamp = self._at_limit = -math.inf
        """Of the last update, and of the last one at the limit [s]."""
        self._min_forces = {
            name: (
                max(SLIP.min_force, SLIP.min_force_sigmas * finger.sigma_force),
                max(SLIP.sure_force, SLIP.sure_force_sigmas * finger.sigma_force),
            )
            for name, finger in rig.fingers.items()
        }
        self._means: Mapping[str, Load] = {}
        """By finger."""

    def update(self, stamp: float, fingers: tuple[str, ...], loads: Array | None) -> Slip:
        """Returns how the object is held at `stamp` [s]; an update that is not newer than the last one changes nothing.

        `loads` (n, 5): of each of `fingers`, as `FingertipContacts` has them; NaN where a finger does not measure it.
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

        # With hysteresis, in the ratio and in time.
        was, least = self.now, min(ratios.values(), default=0.0)
        if least >= (SLIP.end_ratio if was.slipping else SLIP.begin_ratio):
            self._at_limit = stamp
        holds_after = SLIP.min_hold if was.slipping else 0.0
        slipping = least >= SLIP.stick_ratio and stamp - self._at_limit <= holds_after
        began = stamp if slipping and not was.slipping else was.began
        ended = stamp if was.slipping and not slipping else was.ended
        self.now = Slip(slipping, ratios, mu, began, ended)
        return self.now
