"""Whether the object slips: how much of what friction holds each finger's load takes, over time.

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
    """`SlipOptions` say when contacts slip: thresholds on the ratio of tangential force to what friction holds."""

    begin_ratio: float = 0.95  # share of the least ratio at which a slip begins
    end_ratio: float = 0.93  # it ends where the ratio has been below this share for `min_hold`
    stick_ratio: float = 0.4  # or is below this share
    min_hold: float = 0.03  # on the brink of slipping, ratios go to and fro [s]
    time_constant: float = 0.01  # of the mean of a load [s]: of steady readings as good as the mean of 20 ms
    max_gap: float = 0.1  # between two readings: after more the mean starts anew [s]
    min_force: float = 0.2  # normal force from which on a finger has a say in whether the object slips [N]
    sure_force: float = 0.5  # and in what friction holds [N]
    min_force_sigmas: float = 10.0  # the first in standard deviations of a reading
    sure_force_sigmas: float = 40.0  # the second in standard deviations of a reading


SLIP = SlipOptions()


Load = list[float]
"""Tangential force (3), normal force, torque about the normal."""


@dataclass(frozen=True, slots=True)
class Slip:
    """A `Slip` says how the object is held at one instant."""

    slipping: bool = False
    """Whether it slips."""
    ratios: Mapping[str, float] = field(default_factory=dict)
    """By finger that holds it: how much of what friction holds its load takes; empty before friction is known."""
    friction: float | None = None
    """Coefficient of friction, as far as it was learnt."""
    began: float = -math.inf
    """When the object began to slip, this time or last [s]."""
    ended: float = -math.inf
    """When it was last told to hold again [s]."""

    @property
    def least(self) -> float | None:
        """The ratio of the finger that holds it best."""
        return min(self.ratios.values(), default=None)


class SlipDetector:
    """A `SlipDetector` watches loads over time; `update` is the only thing that changes it, and binds anew what it
    changes."""

    def __init__(self, rig: Rig, friction: Friction | None = None) -> None:
        """Starts with nothing loaded at first; `friction`: what is known of it, else nothing."""
        self.now = Slip()
        """After the last update."""
        self.friction = friction or Friction()
        self.stamp = self._at_limit = -math.inf
        """Of the last update, and of the last at the limit [s]."""
        self._least = {
            name: (
                max(SLIP.min_force, SLIP.min_force_sigmas * of.sigma_force),
                max(SLIP.sure_force, SLIP.sure_force_sigmas * of.sigma_force),
            )
            for name, of in rig.fingers.items()
        }
        self._means: Mapping[str, Load] = {}
        """By finger, never changed in place."""

    def update(self, stamp: float, fingers: tuple[str, ...], loads: Array | None) -> Slip:
        """Returns how the object is held at `stamp` [s]; an update that is not newer than the last one changes nothing.

        `loads` (n, 5): of each of `fingers`, as `FingertipContacts` has them; NaN where a finger does not say it.
        """
        if not stamp > self.stamp:
            return self.now
        since, self.stamp = stamp - self.stamp, stamp
        rows = () if loads is None else zip(fingers, loads.tolist(), strict=True)
        weight = 1 - math.exp(-since / SLIP.time_constant)
        before = self._means if since <= SLIP.max_gap else {}
        # Of a load without a normal force, or with NaN, there is nothing to say.
        self._means = {
            name: _mean(before.get(name, row), row, weight)
            for name, row in rows
            if row[3] > 0 and math.isfinite(sum(row))
        }
        vectors, mu = self._vectors(), self.friction.coefficient
        ratios = {} if mu is None else {name: math.hypot(*vector) / mu for name, vector in vectors.items()}
        self.now = self._judged(ratios, mu)
        return self.now

    def _vectors(self) -> dict[str, Vector]:
        """Returns the ratio vectors of fingers that are loaded; friction learns of those that are enough so."""
        found, sure = dict[str, Vector](), dict[str, Vector]()
        for name, (x, y, z, normal, torque) in self._means.items():
            least, enough = self._least[name]
            if normal > least:
                found[name] = x / normal, y / normal, z / normal, torque / FRICTION.torsion / normal
            if normal > enough:
                sure[name] = found[name]
        self.friction.update(sure)
        return found

    def _judged(self, ratios: Mapping[str, float], friction: float | None) -> Slip:
        """Judges with hysteresis, in the ratio and in time."""
        was, now, least = self.now, self.stamp, min(ratios.values(), default=0.0)
        if least >= (SLIP.end_ratio if was.slipping else SLIP.begin_ratio):
            self._at_limit = now
        slipping = least >= SLIP.stick_ratio and now - self._at_limit <= (
            SLIP.min_hold if was.slipping else 0.0
        )
        began = now if slipping and not was.slipping else was.began
        ended = now if was.slipping and not slipping else was.ended
        return Slip(slipping, ratios, friction, began, ended)


def _mean(before: Load, row: Load, weight: float) -> Load:
    """Returns a mean after another reading."""
    a, b, c, d, e = before
    return [
        a + weight * (row[0] - a),
        b + weight * (row[1] - b),
        c + weight * (row[2] - c),
        d + weight * (row[3] - d),
        e + weight * (row[4] - e),
    ]
