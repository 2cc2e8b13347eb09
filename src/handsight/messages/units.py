"""Whether what a robot says is in the units it should be in: told by what its rig says of it."""

from collections import Counter
from math import hypot
from typing import NamedTuple

import numpy as np

from handsight.observation import Observation
from handsight.rig import Rig


class UnitLimits(NamedTuple):
    """`UnitLimits` are sizes beyond which a unit is doubted."""

    max_range: float = 10.0  # no hand sees its object farther away [m]
    max_force: float = 300.0  # no fingertip bears a larger force [N]
    min_share: float = 0.1  # part of the observations; fewer are outliers


UNITS = UnitLimits()


class Units:
    """An `Units` is what was beyond any hand in the observations so far."""

    def __init__(self, rig: Rig) -> None:
        self._rig, self._count, self._beyond = rig, 0, Counter[str]()
        self._largest: dict[str, tuple[float, str]] = {}
        limits = zip(rig.hand.joint_names, np.abs(rig.hand.limits).max(axis=1).tolist(), strict=True)
        # A hinge turns by a radian or two; where a file limits it to less, it may be off by more.
        self._limits = {
            name: limit for name, limit in limits if name in rig.hand.moving and np.isfinite(limit)
        }
        self._names = list(self._limits)
        self._most = 2 * np.array(list(self._limits.values())) + 1

    def put(self, observation: Observation) -> None:
        """Takes in an observation."""
        self._count += 1
        positions = observation.joint_positions or {}
        values = np.abs([positions.get(name, 0.0) for name in self._limits])
        for k in np.flatnonzero(values > self._most):
            self._joint(self._names[k], float(values[k]))
        for name, wrench in observation.wrenches.items():
            force = hypot(*wrench[:3].tolist())
            if force > UNITS.max_force:
                self._note(f"finger {name}", force, f"{force:.4g} N (millinewtons? {1e-3 * force:.3g} N)")
        vision = observation.vision
        if vision is not None and vision.frame != "world":
            distance = float(np.linalg.norm(vision.T_frame_object[:3, 3]))
            if distance > UNITS.max_range:
                text = f"{distance:.4g} m away (millimetres? {1e-3 * distance:.3g} m)"
                self._note(f"{self._rig.topics.vision}: poses", distance, text)

    def _joint(self, name: str, value: float) -> None:
        limit, degrees = self._limits[name], np.deg2rad(value)
        meant = (
            f"degrees? {degrees:.3g} rad" if degrees <= 2 * limit else f"{1e-3 * value:.3g} in thousandths?"
        )
        text = f"{value:.4g} where its file limits it to {limit:.4g} ({meant})"
        self._note(f"{self._rig.topics.joint_states}: joint {name!r}", value, text)

    def _note(self, what: str, value: float, text: str) -> None:
        self._beyond[what] += 1
        if value > self._largest.get(what, (0.0, ""))[0]:
            self._largest[what] = value, text

    def sentences(self) -> list[str]:
        """Returns what was beyond often; empty: nothing."""
        often = [what for what, count in self._beyond.items() if count >= UNITS.min_share * self._count]
        return [f"{what} up to {self._largest[what][1]}" for what in often]
