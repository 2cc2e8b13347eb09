"""What a rig's tactile arrays feel over time: each read above what it read while nothing was touched."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from handsight import checks
from handsight.checks import Array, Mask
from handsight.contact import Contacts
from handsight.contact.taxels import SkinTouch, TaxelArray
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.rig import Rig


class SkinOptions(NamedTuple):
    """`SkinOptions` say how readings of tactile arrays are used."""

    min_baseline: int = 5  # readings of an untouched array from which on their mean is its baseline
    max_baseline: int = 50  # readings that are taken for it
    changed_share: float = 0.3
    """Of the taxels that are or were pressed: where more have changed, the pose is corrected again."""


SKIN = SkinOptions()


Place = tuple[Array, Array | None]
"""T_palm_frame (4, 4) of an array's link, and how its joints' errors move it (6, j); None: it is fixed in the palm."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinContacts:
    """A `SkinContacts` is what all arrays say at one instant; in the palm it is put when it is asked for."""

    touches: Mapping[str, tuple[SkinTouch, Place]] = field(default_factory=dict)
    """By array that was heard and whose link's place is known."""

    @property
    def pressed(self) -> bool:
        """Whether any taxel is."""
        return any(touch.pressed.any() for touch, _ in self.touches.values())

    def contacts(self) -> Contacts | None:
        """Returns contacts of pressed taxels; None where none is."""
        found: Contacts | None = None
        for touch, (T_palm_frame, _) in self.touches.values():
            more = touch.contacts(T_palm_frame)
            found = more if found is None else found if more is None else found.joined(more)
        return found

    def evidence(self) -> SkinEvidence | None:
        """Returns the evidence of the arrays on which a taxel is pressed; None where there is none."""
        found: SkinEvidence | None = None
        for touch, place in self.touches.values():
            if touch.pressed.any():
                more = SkinEvidence.of(touch, *place)
                found = more if found is None else found.joined(more)
        return found

    def news(self, last: "SkinContacts") -> bool:
        """Returns whether other taxels are pressed than at the last correction."""
        if self.touches.keys() != last.touches.keys():
            return True
        for name, (touch, _) in self.touches.items():
            now, then = touch.pressed, last.touches[name][0].pressed
            if (now != then).sum() > SKIN.changed_share * (now | then).sum():
                return True
        return False


NOTHING = SkinContacts()


@dataclass(frozen=True, slots=True, eq=False)
class Untouched:
    """`Untouched` are the readings of an array while nothing was touched."""

    count: int
    total: Array
    """(rows, columns)"""
    varied: Mask
    """(rows, columns) which have ever changed."""
    last: Array
    """(rows, columns)"""

    def baseline(self, full_scale: float | None) -> Array | float:
        """Returns (rows, columns) what each reads untouched, NaN for those not to be believed; 0 of too few readings.

        Not believed are taxels at full scale, and those that never change where most do: dead or stuck.
        """
        if self.count < SKIN.min_baseline:
            return 0.0
        mean = self.total / self.count
        dead = ~self.varied if self.varied.mean() > 0.5 else np.zeros_like(self.varied)
        if full_scale is not None:
            dead |= mean >= full_scale
        return np.where(dead, np.nan, mean)


class SkinSensors:
    """A `SkinSensors` is a rig's tactile arrays; what it knows it binds anew and never changes in place, for a
    tracker may come back."""

    def __init__(self, rig: Rig) -> None:
        """Nothing was heard yet."""
        self.rig = rig
        self._chains = {
            name: rig.hand.chains_to({f"skin[{name!r}].frame": array.frame})
            for name, array in rig.skin.items()
        }
        self._sigma_joint = float(np.hypot(rig.sigma_joint_offset, rig.sigma_joint))
        self._untouched: Mapping[str, Untouched] = {}

    def observed(self, observation: Observation, *, touched: bool) -> SkinContacts:
        """Returns what is felt now; `touched`: a fingertip feels something, so that the arrays may, too.

        An array on a link whose joints were not heard says nothing. Raises InvalidInput.
        """
        if not isinstance(observation.skin, Mapping):
            came = checks.brief(observation.skin)
            raise InvalidInput(f"observation.skin: expected a mapping from array to readings, got {came}")
        found = dict[str, tuple[SkinTouch, Place]]()
        for name, array in self.rig.skin.items():
            if name in observation.skin:
                touch = self._touch(name, array, observation.skin[name], touched=touched)
                if (place := self._place(name, observation.joint_positions)) is not None:
                    found[name] = touch, place
        return SkinContacts(found)

    def _touch(self, name: str, array: TaxelArray, values: Array, *, touched: bool) -> SkinTouch:
        """Returns what the array's readings say above its baseline, of which these are part where nothing is
        touched."""
        reading = array.reading(values, f"observation.skin[{name!r}]")
        known = self._untouched.get(name)
        if not touched and (known is None or known.count < SKIN.max_baseline):
            clean = np.where(np.isfinite(reading), reading, 0.0)
            if known is None:
                known = Untouched(1, clean, np.zeros(array.shape, dtype=bool), clean)
            else:
                varied = known.varied | (clean != known.last)
                known = Untouched(known.count + 1, known.total + clean, varied, clean)
            self._untouched = {**self._untouched, name: known}
        return array.touch(reading, 0.0 if known is None else known.baseline(array.full_scale))

    def _place(
        self, name: str, joint_positions: Mapping[str, float] | None
    ) -> tuple[Array, Array | None] | None:
        """Returns T_palm_frame (4, 4) of an array's link, and how its joints' errors move it (6, j); None: not
        known."""
        chains = self._chains[name]
        if not chains.joints:
            return chains.homes[0], None
        if joint_positions is None or not joint_positions.keys() >= set(chains.joints):
            return None
        Ts, axes = chains.poses(joint_positions)
        J = chains.jacobians(Ts[:, :3, 3].copy(), np.zeros(1, dtype=np.int64), axes)[0]
        return Ts[0], self._sigma_joint * J
