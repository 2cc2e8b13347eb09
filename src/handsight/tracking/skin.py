"""A rig's tactile surfaces over time: baselines at rest, faulty taxels, and which patches are fingers' contacts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handsight import checks, se3
from handsight._kernels.touch.taxel_records import FAULTS, LOW, PATCH, PRESSED, WATCHED
from handsight._kernels.touch.taxels import TAXELS, watch_taxels
from handsight.checks import Array
from handsight.contact import Contacts, Pad, SkinTouch
from handsight.correction import SkinEvidence
from handsight.errors import InvalidInput
from handsight.forces import FRICTION, LINK_TAXELS
from handsight.hand.chains import Chains
from handsight.observation import Observation
from handsight.rig import Rig


class SkinOptions(NamedTuple):
    """`SkinOptions` say which readings of tactile surfaces are news, and which are none."""

    changed_share: float = 0.3
    """The pose is corrected again when more than this share of the taxels that are or were pressed has changed."""
    sure: float = 4.0
    """A tip whose baseline is unknown is touched where a taxel reads this many thresholds: an offset is less."""
    max_force: float = 1000.0  # of a patch of three-axis taxels; more is in another unit [N]


SKIN = SkinOptions()


class LinkPose:
    """A `LinkPose` is the pose in the palm of a link with a tactile surface, computed when it is asked for."""

    def __init__(
        self, chains: Chains, joint_positions: Mapping[str, float] | None, sigma_joint: float
    ) -> None:
        """`joint_positions`: of all joints of the chains; `sigma_joint`: of each joint's error [rad]."""
        self._chains, self._joints, self._sigma_joint = chains, joint_positions, sigma_joint

    @cached_property
    def placed(self) -> tuple[Array, Array]:
        """(4, 4) the pose, and (6, j) its change for one sigma of each joint's error."""
        Ts, axes = self._chains.poses(self._joints or {})
        errors = self._sigma_joint * np.eye(len(self._chains.joints))
        J = self._chains.jacobians(Ts[:, :3, 3].copy(), np.zeros(1, dtype=np.int64), axes, errors)
        return Ts[0], J[0]


@dataclass(frozen=True, slots=True, eq=False)
class Watched:
    """A `Watched` is what is known of a surface's taxels by their readings so far."""

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
        taxels, baseline = self.taxels.copy(), np.empty_like(self.baseline)
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
    """A `SkinContacts` is what all tactile surfaces measure at one instant."""

    touches: Mapping[str, tuple[SkinTouch, LinkPose]] = field(default_factory=dict)
    """By surface, which taxels are pressed, and where it is; without those whose link's pose is unknown."""
    watched: Mapping[str, Watched] = field(default_factory=dict)
    """By surface, what is known of its taxels by their readings so far."""
    tips: Mapping[str, str] = field(default_factory=dict)
    """By finger, the surface on its tip that is touched: its strongest patch is the finger's contact."""
    wrenches: Mapping[str, Array] = field(default_factory=dict)
    """By the name of the load sensor that a link's taxels are, the wrench (6,) on them, see `SkinTouch.wrench`."""

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

    def beside_tips(self) -> tuple[tuple[str, ...], Contacts, Array]:
        """Returns the loads on the taxels of k links that are no fingertips, as a tip's load is given.

        They are the links' names as load sensors, one contact each, at its centre of pressure, and the loads (k, 5),
        see `FingertipContacts.loads`. The torque is scaled to that which brings a tip as near to its limit.
        """
        tips = {self.touches[name][0].surface.frame for name in self.tips.values()}
        pressed = {
            LINK_TAXELS.format(touch.surface.frame): (touch, pose.placed[0])
            for touch, pose in self.touches.values()
            if len(touch.patches) and touch.surface.frame not in tips
        }
        points, normals, loads = (np.empty((len(pressed), k)) for k in (3, 3, 5))
        for k, (name, (touch, T)) in enumerate(pressed.items()):
            wrench, R = self.wrenches[name], T[:3, :3]
            if not np.isfinite(wrench).all():  # nothing but where it is touched
                patch = touch.patches[touch.strongest]
                points[k], normals[k] = R @ patch["point"] + T[:3, 3], R @ patch["normal"]
                loads[k] = np.nan
                continue
            share = np.where(touch.states[1, :-1] >= 0, touch.rise[:-1, -1], 0.0)
            share /= share.sum()
            point, normal = share @ touch.surface.points, -share @ touch.surface.normals
            normal /= math.sqrt(normal @ normal)
            force, along = wrench[:3], wrench[:3] @ normal
            radius = math.sqrt(share @ ((touch.surface.points - point) ** 2).sum(axis=1))
            torsion = wrench[3:] @ normal - force @ (se3.skew(normal) @ point)  # n · (t - p × f)
            loads[k, :3], loads[k, 3] = R @ (force - along * normal), along
            loads[k, 4] = torsion * FRICTION.torsion / max(radius, FRICTION.torsion)
            points[k], normals[k] = R @ point + T[:3, 3], R @ normal
        return tuple(pressed), Contacts.trusted(points, normals, np.zeros((len(pressed), 6, 6))), loads

    def patches(self) -> NDArray[np.void]:
        """Returns the records PATCH of the fingers' contacts, in the order of `tips`."""
        found = np.empty(len(self.tips), dtype=PATCH)
        for i, name in enumerate(self.tips.values()):
            touch, _ = self.touches[name]
            found[i] = touch.patches[touch.strongest]
        return found

    def contacts(self) -> Contacts | None:
        """Returns the contacts in the palm, those of fingers too; None where no taxel is pressed."""
        found: Contacts | None = None
        for touch, pose in self.touches.values():
            more = touch.contacts(*pose.placed)
            found = more if found is None else found if more is None else found.joined(more)
        return found

    def evidence(self) -> SkinEvidence | None:
        """Returns the evidence of what is touched beside the contacts of fingers; None where there is none."""
        found: SkinEvidence | None = None
        for name, (touch, pose) in self.touches.items():
            given = touch.strongest if name in self.tips.values() else -1
            if len(touch.patches) > (given >= 0):
                T, J = pose.placed
                contacts, sigmas = touch.contacts(T, J, given), touch.sigmas_common(J, given)
                more = SkinEvidence(contacts, touch.outside(T), sigmas, touch.sigma_clearance)
                found = more if found is None else found.joined(more)
        return found

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
            if (now != then).sum() > SKIN.changed_share * (now | then).sum():
                return True
        return False


NOTHING = SkinContacts()


class SkinSensors:
    """A `SkinSensors` reads a rig's tactile surfaces."""

    def __init__(self, rig: Rig) -> None:
        """The frame of each surface must be a body of the rig's hand."""
        self.rig = rig
        frames = {name: surface.frame for name, surface in rig.skin.items()}
        self._chains = {n: rig.hand.chains_to({f"skin[{n!r}].frame": link}) for n, link in frames.items()}
        self._joints = {name: frozenset(chains.joints) for name, chains in self._chains.items()}
        fingers = {finger.frame: name for name, finger in rig.fingers.items()}
        self._fingers = {name: fingers.get(link) for name, link in frames.items()}
        self._links = {name: LINK_TAXELS.format(link) for name, link in frames.items()}
        self._sigma_joint = float(np.hypot(rig.sigma_joint_offset, rig.sigma_joint))

    def observed(
        self, observation: Observation, before: SkinContacts = NOTHING, *, touched: bool
    ) -> SkinContacts:
        """Returns what the surfaces measure now; those on links whose joints are missing are left out.

        `before` is what they measured at the last observation. `touched`: whether a fingertip touches something; then
        a surface may be touched, too, so its reading is not added to its baseline. Raises InvalidInput.
        """
        if not isinstance(observation.skin, Mapping):
            came = checks.brief(observation.skin)
            raise InvalidInput(f"observation.skin: expected a mapping from array to readings, got {came}")
        if not self.rig.skin:
            return NOTHING
        touches, watched = dict[str, tuple[SkinTouch, LinkPose]](), dict(before.watched)
        tips, wrenches, joints = dict[str, str](), dict[str, Array](), observation.joint_positions
        for name, surface in self.rig.skin.items():
            if name not in observation.skin:
                continue
            readings = surface.cells(surface.reading(observation.skin[name], f"observation.skin[{name!r}]"))
            known = watched.get(name) or Watched.first(readings)
            touch = surface.sensed(readings, known.baseline)
            if surface.components == 3 and len(touch.patches) and touch.patches["total"][0] > SKIN.max_force:
                expected = "expected newtons, after the rig's scale and offset"
                came = f"a force of {touch.patches['total'][0]:.0f} (counts without a scale?)"
                raise InvalidInput(f"observation.skin[{name!r}]: {expected}, got {came}")
            finger, is_pad = self._fingers[name], isinstance(surface, Pad)
            pressed = is_pad and known.count >= TAXELS.min_rest and len(touch.patches) > 0
            watched[name] = known.after(readings, touch, untouched=not touched and not pressed)
            if is_pad and (finger in observation.wrenches or finger in observation.contacts):
                continue  # which say more of the same contact
            if self._joints[name] and (joints is None or not self._joints[name] <= joints.keys()):
                continue
            if finger is not None and surface.kind == "taxels" and known.count < TAXELS.min_rest:
                strongest = touch.rise[touch.states[0] > LOW, -1]  # without filled taxels
                if not strongest.max(initial=0.0) >= SKIN.sure * surface.threshold:  # they are offsets
                    touch = surface.sensed(readings, known.baseline + touch.rise[:-1])
            touches[name] = touch, LinkPose(self._chains[name], joints, self._sigma_joint)
            link = self._links[name]
            wrenches[link] = touch.wrench if link not in wrenches else wrenches[link] + touch.wrench
            if finger is not None and len(touch.patches) and joints is not None:
                other = touches[tips[finger]][0] if finger in tips else None
                if other is None or other.patches["total"].max() < touch.patches["total"].max():
                    tips[finger] = name
        return SkinContacts(touches, watched, tips, wrenches)
