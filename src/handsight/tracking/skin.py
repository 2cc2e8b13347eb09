"""A rig's tactile arrays over time; the baseline of each is what it read while nothing was touched."""

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

    min_baseline: int = 5  # fewest readings of an untouched array whose mean is used as its baseline
    max_baseline: int = 50  # most readings that are averaged
    changed_share: float = 0.3
    """The pose is corrected again when more than this share of the taxels that are or were pressed has changed."""


SKIN = SkinOptions()


class ArrayPose(NamedTuple):
    """An `ArrayPose` is the pose in the palm of the link that carries a tactile array."""

    T_palm_frame: Array
    """(4, 4)"""
    by_error: Array | None
    """(6, j) change of the pose for one sigma of each joint's error; None: the link is fixed in the palm."""


@dataclass(frozen=True, slots=True, eq=False)
class Untouched:
    """An `Untouched` is the sum of an array's readings while nothing was touched."""

    count: int
    """The number of readings."""
    total: Array
    """(rows, columns) their sum."""
    varied: Mask
    """(rows, columns) whether the taxel has ever changed."""
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
        """Returns (rows, columns) the mean reading, NaN for dead and stuck taxels; 0 if there were too few readings.

        A taxel is stuck at full scale, and dead if it never changes while most others do.
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

    touches: Mapping[str, tuple[SkinTouch, ArrayPose]] = field(default_factory=dict)
    """By array, which taxels are pressed, and where the array is; without arrays whose link's pose is unknown."""
    untouched: Mapping[str, Untouched] = field(default_factory=dict)
    """By array, the sum of its readings so far while nothing was touched."""

    @property
    def pressed(self) -> bool:
        """Whether any taxel is pressed."""
        return any(touch.pressed.any() for touch, _ in self.touches.values())

    def contacts(self) -> Contacts | None:
        """Returns the pressed taxels' contacts in the palm; None where no taxel is pressed."""
        found: Contacts | None = None
        for touch, pose in self.touches.values():
            more = touch.contacts(pose.T_palm_frame)
            found = more if found is None else found if more is None else found.joined(more)
        return found

    def evidence(self) -> SkinEvidence | None:
        """Returns the evidence of the arrays on which a taxel is pressed; None where there is none."""
        found: SkinEvidence | None = None
        for touch, pose in self.touches.values():
            if touch.pressed.any():
                more = SkinEvidence.of(touch, pose.T_palm_frame, pose.by_error)
                found = more if found is None else found.joined(more)
        return found

    def news(self, last: "SkinContacts") -> bool:
        """Returns whether many other taxels are pressed than in `last`, the value at the last correction."""
        if self.touches.keys() != last.touches.keys():
            return True
        for name, (touch, _) in self.touches.items():
            now, then = touch.pressed, last.touches[name][0].pressed
            if (now != then).sum() > SKIN.changed_share * (now | then).sum():
                return True
        return False


NOTHING = SkinContacts()


class SkinSensors:
    """A `SkinSensors` reads a rig's tactile arrays."""

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
        """Returns what the arrays measure now; arrays on links whose joints are missing are left out.

        `before` is what they measured at the last observation. `touched`: whether a fingertip touches something; then
        an array may be touched, too, so its reading is not added to its baseline. Raises InvalidInput.
        """
        if not isinstance(observation.skin, Mapping):
            came = checks.brief(observation.skin)
            raise InvalidInput(f"observation.skin: expected a mapping from array to readings, got {came}")
        touches, untouched = dict[str, tuple[SkinTouch, ArrayPose]](), dict(before.untouched)
        for name, array in self.rig.skin.items():
            if name not in observation.skin:
                continue
            reading = array.reading(observation.skin[name], f"observation.skin[{name!r}]")
            known = untouched.get(name)
            if not touched and (known is None or known.count < SKIN.max_baseline):
                clean = np.where(np.isfinite(reading), reading, 0.0)
                untouched[name] = known = Untouched.first(clean) if known is None else known.after(clean)
            touch = array.touch(reading, 0.0 if known is None else known.baseline(array.full_scale))
            if (pose := self._pose(name, observation.joint_positions)) is not None:
                touches[name] = touch, pose
        return SkinContacts(touches, untouched)

    def _pose(self, name: str, joint_positions: Mapping[str, float] | None) -> ArrayPose | None:
        """Returns the pose of an array's link; None where joints are missing."""
        chains = self._chains[name]
        if not chains.joints:
            return ArrayPose(chains.homes[0], None)
        if joint_positions is None or not joint_positions.keys() >= set(chains.joints):
            return None
        Ts, axes = chains.poses(joint_positions)
        J = chains.jacobians(Ts[:, :3, 3].copy(), np.zeros(1, dtype=np.int64), axes)[0]
        return ArrayPose(Ts[0], self._sigma_joint * J)
