"""A rig's tactile surfaces over time: baselines at rest, faulty taxels, and which patches are fingers' contacts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from handsight.checks import Array
from handsight.contact import Contacts, SkinTouch
from handsight.contact.kernels.taxel_records import FAULTS, LOW, PATCH, PRESSED, WATCHED
from handsight.contact.kernels.taxels import TAXELS, watch_taxels
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from handsight.forces import LINK_TAXELS
from handsight.hand.chains import Chains
from handsight.observation import Observation
from handsight.rig import Rig

CHANGED_SHARE = 0.3
"""The pose is corrected again when more than this share of the taxels that are or were pressed has changed."""
SURE_THRESHOLDS = 4
"""A tip whose baseline is unknown is touched where a taxel reads this many thresholds: an offset is less."""
MAX_PATCH_FORCE = 1000.0  # of a patch of three-axis taxels; more is in another unit [N]


class LinkPose:
    """The pose in the palm of a link with a tactile surface, computed when it is asked for."""

    def __init__(
        self, chains: Chains, joint_positions: Mapping[str, float] | None, joint_errors: Array
    ) -> None:
        """`joint_positions`: of all joints of the chains; `joint_errors` (j, j): as `Rig.joint_errors` has them."""
        self._chains, self._joints, self._errors = chains, joint_positions, joint_errors

    @cached_property
    def placed(self) -> tuple[Array, Array]:
        """(4, 4) the pose, and (6, j) its change for one sigma of each joint's error."""
        Ts, axes = self._chains.poses(self._joints or {})
        J = self._chains.jacobians(Ts[:, :3, 3].copy(), np.zeros(1, dtype=np.int64), axes, self._errors)
        return Ts[0], J[0]


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """What is known of a surface's taxels by their readings so far."""

    count: int
    """The number of readings while nothing was touched."""
    taxels: NDArray[np.void]
    """(n,) records WATCHED."""
    baseline: Array
    """(n, components) the scaled readings while nothing is touched; NaN for taxels that are left out."""

    @classmethod
    def first(cls, readings: Array) -> "Watched":
        """Returns what is known before any readings (n, components)."""
        taxels = np.zeros(len(readings), dtype=WATCHED)
        taxels["last"] = np.nan
        return cls(0, taxels, np.zeros(readings.shape))

    def after(self, readings: Array, touch: SkinTouch, *, untouched: bool) -> "Watched":
        """Returns what is known after one more reading (n, components), and what it says."""
        taxels = self.taxels.copy()
        baseline = np.empty_like(self.baseline)
        given = readings, touch.surface.record, touch.states, touch.rise, untouched, self.count
        return Watched(watch_taxels(*given, taxels, baseline), taxels, baseline)

    @property
    def faults(self) -> str:
        """The taxels that are dead, stuck, at full scale or drifting, for a person; empty where there are none."""
        found = []
        for k, name in enumerate(FAULTS):
            if k and len(numbers := np.flatnonzero(self.taxels["fault"] == k)):
                more = f" and {len(numbers) - 12} more" if len(numbers) > 12 else ""
                found.append(f"{name}: taxel {', '.join(map(str, numbers[:12]))}{more}")
        return "; ".join(found)


@dataclass(frozen=True, slots=True, eq=False)
class SkinContacts:
    """What all tactile surfaces measure at one instant."""

    touches: Mapping[str, tuple[SkinTouch, LinkPose]] = field(default_factory=dict)
    """By surface, which taxels are pressed, and where it is; without those whose link's pose is unknown."""
    watched: Mapping[str, Watched] = field(default_factory=dict)
    """By surface, what is known of its taxels by their readings so far."""
    tips: Mapping[str, str] = field(default_factory=dict)
    """By finger, the surface on its tip that is touched: its strongest patch is the finger's contact."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By the name of the load sensor that a fingertip's taxels are, the wrench (6,) on them, see `SkinTouch.wrench`."""
    unzeroed: tuple[str, ...] = ()
    """Surfaces that are pressed and have been since their first readings, so that their offsets are unknown."""

    @property
    def pressed(self) -> bool:
        """Whether any taxel is pressed."""
        return any(len(touch.patches) for touch, _ in self.touches.values())

    @property
    def faults(self) -> dict[str, str]:
        """By surface, which taxels are faulty, by their numbers; without surfaces on which none is."""
        return {name: faults for name, watched in self.watched.items() if (faults := watched.faults)}

    @property
    def bears(self) -> bool:
        """Whether anything is touched beside the contacts of fingers."""
        tips = self.tips.values()
        touches = ((name, touch) for name, (touch, _) in self.touches.items() if len(touch.patches))
        return any(touch.states[1].max() >= (name in tips) for name, touch in touches)

    def patches(self) -> NDArray[np.void]:
        """Returns the records PATCH of the fingers' contacts, in the order of `tips`."""
        found = np.empty(len(self.tips), dtype=PATCH)
        for i, name in enumerate(self.tips.values()):
            touch, _ = self.touches[name]
            found[i] = touch.patches[touch.strongest]
        return found

    def contacts(self) -> Contacts | None:
        """Returns the contacts in the palm, those of fingers too; None where no taxel is pressed."""
        parts = [touch.contacts(*pose.placed) for touch, pose in self.touches.values()]
        given = [part for part in parts if part is not None]
        return reduce(Contacts.joined, given) if given else None

    def evidence(self) -> SkinEvidence | None:
        """Returns the evidence of what is touched beside the contacts of fingers; None where there is none."""
        parts = list[SkinEvidence]()
        for name, (touch, pose) in self.touches.items():
            given = touch.strongest if name in self.tips.values() else -1
            if len(touch.patches) > (given >= 0):
                T, J = pose.placed
                contacts = touch.contacts(T, J, given)
                sigmas = touch.sigmas_common(J, given)
                parts.append(SkinEvidence(contacts, touch.outside(T), sigmas, touch.sigma_clearance))
        return reduce(SkinEvidence.joined, parts) if parts else None

    def news(self, last: "SkinContacts") -> bool:
        """Returns whether many other taxels are pressed than in `last`, the value at the last correction."""
        if self.touches.keys() != last.touches.keys():
            return True
        for name, (touch, _) in self.touches.items():
            if name in self.tips.values():
                continue  # contacts of fingers are compared elsewhere
            before = last.touches[name][0]
            if not len(touch.patches) and not len(before.patches):
                continue
            now, then = touch.states[0] == PRESSED, before.states[0] == PRESSED
            if (now != then).sum() > CHANGED_SHARE * (now | then).sum():
                return True
        return False


NOTHING = SkinContacts()


class SkinSensors:
    """Reads a rig's tactile surfaces."""

    def __init__(self, rig: Rig) -> None:
        """The frame of each surface must be a body of the rig's hand."""
        self.rig = rig
        frames = {name: surface.frame for name, surface in rig.skin.items()}
        self._chains = {n: rig.hand.chains_to({f"skin[{n!r}].frame": link}) for n, link in frames.items()}
        self._joints = {name: frozenset(chains.joints) for name, chains in self._chains.items()}
        fingers = {finger.frame: name for name, finger in rig.fingers.items()}
        self._fingers = {name: fingers.get(link) for name, link in frames.items()}
        self._links = {name: LINK_TAXELS.format(link) for name, link in frames.items()}
        sigma = float(np.hypot(rig.sigma_joint_offset, rig.sigma_joint))
        self._errors = {name: rig.joint_errors(chains.joints, sigma) for name, chains in self._chains.items()}

    def observed(
        self, observation: Observation, before: SkinContacts = NOTHING, *, touched: bool
    ) -> SkinContacts:
        """Returns what the surfaces measure now; those on links whose joints are missing are left out.

        `before` is what they measured at the last observation. `touched`: whether a fingertip touches something; then
        a surface may be touched, too, so its reading is not added to its baseline. Raises InvalidInput.
        """
        if not self.rig.skin:
            return NOTHING
        touches = dict[str, tuple[SkinTouch, LinkPose]]()
        watched = dict(before.watched)
        tips = dict[str, str]()
        wrenches = dict[str, Array]()
        unzeroed = list[str]()
        joints = observation.joint_positions
        for name, surface in self.rig.skin.items():
            if name not in observation.skin:
                continue
            readings = surface.cells(surface.reading(observation.skin[name], f"observation.skin[{name!r}]"))
            known = watched.get(name) or Watched.first(readings)
            touch = surface.sensed(readings, known.baseline)
            if surface.components == 3 and len(touch.patches) and touch.patches["total"][0] > MAX_PATCH_FORCE:
                expected = "expected newtons, after the rig's scale and offset"
                came = f"a force of {touch.patches['total'][0]:.0f} (counts without a scale?)"
                raise InvalidInput(f"observation.skin[{name!r}]: {expected}, got {came}")
            finger = self._fingers[name]
            watched[name] = known.after(readings, touch, untouched=not touched)
            if surface.is_pad and (finger in observation.wrenches or finger in observation.contacts):
                continue  # which say more of the same contact
            if self._joints[name] and (joints is None or not self._joints[name] <= joints.keys()):
                continue
            offset_unknown = not surface.is_zeroed and known.count < TAXELS.min_rest
            if finger is not None and offset_unknown:
                strongest = touch.rise[touch.states[0] > LOW, -1]  # without filled taxels
                if not strongest.max(initial=0.0) >= SURE_THRESHOLDS * surface.threshold:  # they are offsets
                    touch = surface.sensed(readings, known.baseline + touch.rise[:-1])
            if offset_unknown and len(touch.patches):
                unzeroed.append(name)
            touches[name] = touch, LinkPose(self._chains[name], joints, self._errors[name])
            if finger is None:
                continue
            link = self._links[name]
            wrenches[link] = wrenches.get(link, np.zeros(6)) + touch.wrench
            if len(touch.patches) and joints is not None:
                other = touches[tips.get(finger, name)][0]
                if other is touch or other.patches["total"].max() < touch.patches["total"].max():
                    tips[finger] = name
        return SkinContacts(touches, watched, tips, wrenches, tuple(unzeroed))
