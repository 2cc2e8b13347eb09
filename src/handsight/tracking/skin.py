"""A rig's tactile arrays over time: each is read above its baseline, what it read while nothing was touched."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from handsight import checks
from handsight.checks import Array, Mask
from handsight.contact import Contacts
from handsight.contact.taxels import SkinTouch
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.rig import Rig


class SkinOptions(NamedTuple):
    """`SkinOptions` say how readings of tactile arrays are used."""

    min_baseline: int = 5  # readings of an untouched array, of which the mean is its baseline, at least
    max_baseline: int = 50  # and at most
    changed_share: float = 0.3
    """The pose is corrected again where more than this part of the taxels that are or were pressed has changed."""


SKIN = SkinOptions()

Place = tuple[Array, Array | None]
"""T_palm_frame (4, 4) of an array's link, and its change (6, j) by its joints' errors; None: fixed in the palm."""


@dataclass(frozen=True, slots=True, eq=False)
class Untouched:
    """An `Untouched` sums up an array's readings while nothing was touched."""

    count: int
    total: Array
    """(rows, columns) their sum."""
    varied: Mask
    """(rows, columns) which taxels have ever changed."""
    last: Array
    """(rows, columns) the last reading."""

    @classmethod
    def first(cls, reading: Array) -> "Untouched":
        """Returns the sum of one reading (rows, columns)."""
        return cls(1, reading, np.zeros(reading.shape, dtype=bool), reading)

    def after(self, reading: Array) -> "Untouched":
        """Returns the sum with one more reading (rows, columns)."""
        varied = self.varied | (reading != self.last)
        return Untouched(self.count + 1, self.total + reading, varied, reading)

    def baseline(self, full_scale: float | None) -> Array | float:
        """Returns (rows, columns) the mean reading, NaN for dead and stuck taxels; 0 of too few readings.

        Those are taxels at full scale, and those that never change where most do.
        """
        if self.count < SKIN.min_baseline:
            return 0.0
        mean = self.total / self.count
        dead = ~self.varied if self.varied.mean() > 0.5 else np.zeros_like(self.varied)
        if full_scale is not None:
            dead |= mean >= full_scale
        return np.where(dead, np.nan, mean)


@dataclass(frozen=True, slots=True, eq=False)
class SkinContacts:
    """A `SkinContacts` is what all tactile arrays measure at one instant."""

    touches: Mapping[str, tuple[SkinTouch, Place]] = field(default_factory=dict)
    """By array that has a reading and whose link's place is known."""
    untouched: Mapping[str, Untouched] = field(default_factory=dict)
    """By array, its readings so far while nothing was touched."""

    @property
    def pressed(self) -> bool:
        """Whether any taxel is pressed."""
        return any(touch.pressed.any() for touch, _ in self.touches.values())

    def contacts(self) -> Contacts | None:
        """Returns the pressed taxels' contacts in the palm; None where no taxel is pressed."""
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
        """Returns whether other taxels are pressed than in `last`, that of the last correction."""
        if self.touches.keys() != last.touches.keys():
            return True
        for name, (touch, _) in self.touches.items():
            now, then = touch.pressed, last.touches[name][0].pressed
            if (now != then).sum() > SKIN.changed_share * (now | then).sum():
                return True
        return False


NOTHING = SkinContacts()


class SkinSensors:
    """A `SkinSensors` is a rig's tactile arrays."""

    def __init__(self, rig: Rig) -> None:
        """The frame of each array must be a body of the rig's hand."""
        self.rig = rig
        self._chains = {
            name: rig.hand.chains_to({f"skin[{name!r}].frame": array.frame})
            for name, array in rig.skin.items()
        }
        self._sigma_joint = float(np.hypot(rig.sigma_joint_offset, rig.sigma_joint))

    def observed(
        self, observation: Observation, before: SkinContacts = NOTHING, *, touched: bool
    ) -> SkinContacts:
        """Returns what the arrays measure now; those on links whose joints are missing are left out.

        `before` is what they measured at the last observation. `touched`: a fingertip touches something, so an array
        may, too, and its reading is not added to its baseline. Raises InvalidInput.
        """
        if not isinstance(observation.skin, Mapping):
            came = checks.brief(observation.skin)
            raise InvalidInput(f"observation.skin: expected a mapping from array to readings, got {came}")
        touches, untouched = dict[str, tuple[SkinTouch, Place]](), dict(before.untouched)
        for name, array in self.rig.skin.items():
            if name not in observation.skin:
                continue
            reading = array.reading(observation.skin[name], f"observation.skin[{name!r}]")
            known = untouched.get(name)
            if not touched and (known is None or known.count < SKIN.max_baseline):
                clean = np.where(np.isfinite(reading), reading, 0.0)
                untouched[name] = known = Untouched.first(clean) if known is None else known.after(clean)
            touch = array.touch(reading, 0.0 if known is None else known.baseline(array.full_scale))
            if (place := self._place(name, observation.joint_positions)) is not None:
                touches[name] = touch, place
        return SkinContacts(touches, untouched)

    def _place(self, name: str, joint_positions: Mapping[str, float] | None) -> Place | None:
        """Returns the place of an array's link; None where joints are missing."""
        chains = self._chains[name]
        if not chains.joints:
            return chains.homes[0], None
        if joint_positions is None or not joint_positions.keys() >= set(chains.joints):
            return None
        Ts, axes = chains.poses(joint_positions)
        J = chains.jacobians(Ts[:, :3, 3].copy(), np.zeros(1, dtype=np.int64), axes)[0]
        return Ts[0], self._sigma_joint * J
