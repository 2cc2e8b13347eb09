"""Coupled joints whose measured positions are not those that their leaders say."""

from collections import Counter
from collections.abc import Mapping
from math import hypot

import numpy as np

from handsight.rig.rig import Rig

SIGMAS = 3.0  # a joint that is further off its law, in standard deviations, follows another one
MIN_SHARE = 0.1  # of the positions that are so far off; fewer are outliers
EVERY = 10  # observations of which one is compared: laws do not change


class CoupledJoints:
    """Compares the positions of coupled joints with the laws of the hand's file."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._laws = {
            name: (leader, law, law.deriv())
            for name, (leader, law) in rig.hand.couplings.laws.items()
            if name in rig.hand.moving
        }
        self._count = 0
        self._compared, self._beyond = Counter[str](), Counter[str]()
        self._off = dict.fromkeys(self._laws, 0.0)

    def put(self, positions: Mapping[str, float]) -> None:
        """Adds the positions of joints as they were measured."""
        self._count += 1
        if self._laws.keys().isdisjoint(positions) or self._count % EVERY != 1:
            return
        for name, (leader, law, slope) in self._laws.items():
            if name not in positions or (leader and leader not in positions):
                continue
            lead = positions.get(leader, 0.0)
            off = abs(positions[name] - float(law(lead)))
            encoders = self._rig.sigma_joint_offset * hypot(1.0, slope(lead))
            self._compared[name] += 1
            self._beyond[name] += off > SIGMAS * hypot(self._rig.sigma_coupled, encoders)
            self._off[name] += off

    def sentences(self) -> list[str]:
        """Returns a sentence for each joint that is often further off its law than its errors explain."""
        known = f"coupled_joint_deg is {np.rad2deg(self._rig.sigma_coupled):g}"
        found = list[str]()
        for name, count in self._compared.items():
            if self._beyond[name] < max(1.0, MIN_SHARE * count):
                continue
            leader, _, _ = self._laws[name]
            says = f"what {leader!r} says" if leader else "where it always is"
            far = self._text(name, self._off[name] / count)
            found.append(
                f"joint {name!r}: {far} from {says} by the hand's file ({known}): another ratio, or zero?"
            )
        return found

    def _text(self, name: str, off: float) -> str:
        """Returns the text of a distance of a joint, an angle or a length."""
        chains = self._rig.hand.chains
        slides = chains.steps["value"][chains.steps["slides"] > 0]
        if chains.joints.index(name) in slides:
            return f"{1e3 * off:.3g} mm"
        return f"{np.rad2deg(off):.1f}°"
