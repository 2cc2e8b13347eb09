"""What a recording tells of the values that a rig and an object's model declare, and whether it contradicts them.

While a hand grasps an object in different ways, contacts measure more than its pose: what remains tells of the errors
that all grasps have in common. Contact i of an instant is off the surface by r_i + A_i (M_i x + C_i θ), with x the
instant's own error of the pose and θ the declared values' errors: of each fingertip's radius and position, of each
joint, and of the object's size. The instants' x are eliminated (Schur complement), and θ, with the sigmas that are
declared as its prior, is the solution of one linear problem.

Declared is θ = 0 with prior covariance P; estimated is θ̂ with covariance S. If what is declared is right, θ̂ is a
Gaussian with covariance P - S, so θ̂ᵀ (P - S)⁻¹ θ̂ is a χ². The estimate that is shown is that of the recording
alone, without the value's own prior: information S⁻¹ - P⁻¹.
"""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.fingertips import FingertipSensors
from handsight.tracking.joint_offsets import JointOffsets, contact_equations
from handsight.tracking.tracker import Tracker


class DiagnosisOptions(NamedTuple):
    """`DiagnosisOptions` say which instants of a recording are compared, and when a value is called wrong."""

    new_contact: float = 0.01
    """An instant is kept where a finger touches by so much elsewhere in the palm than in all kept instants [m]: others
    have the same errors, as those of a bent tip or of a soft one, and would count them again. On simulated grasps of a
    can, 3 mm made the errors of the estimates three times their sigmas."""
    new_normal: float = float(np.deg2rad(30.0))  # or where the normal is turned by so much [rad]
    min_fingers: int = 3  # an instant has so many fingers or more: fewer determine the pose alone
    min_force: float = 0.3  # each presses by so much [N]: fingers that close are not at rest yet
    max_instants: int = 200  # most instants that are kept
    sigma_size: float = 0.01  # of an object's size, as a share: models do not declare it
    sigma_pose: float = 0.02  # sigma of an instant's pose about the tracked one [m]; see `sigma_turn`
    sigma_turn: float = float(np.deg2rad(20.0))  # [rad]
    measured: float = 0.8
    """A value is measured where the recording's own sigma is below this share of the declared one."""
    level: float = 0.01
    """Probability that any right value of a recording is called wrong."""


DIAGNOSIS = DiagnosisOptions()


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A `Diagnosed` is one declared value, and what a recording tells of it."""

    name: str
    """Such as `tip ff radius` or `joint robot0:FFJ2`."""
    unit: str
    believed: float
    sigma: float
    """Standard deviation that is declared, or assumed, of the value."""
    estimated: float
    """The value that the recording alone tells; NaN where it tells nothing."""
    sigma_estimated: float
    """Its standard deviation; infinite where the recording tells nothing."""
    chi2: float
    """Squared deviation of the estimate from the declared value, in units of its variance if that value is right."""
    wrong: bool = False
    """Whether the recording contradicts the value."""

    @property
    def measured(self) -> bool:
        """Whether the recording tells more of the value than was declared."""
        return self.sigma_estimated < DIAGNOSIS.measured * self.sigma

    @property
    def verdict(self) -> str:
        """What to think of the value, in words."""
        if self.wrong:
            more = self.estimated - self.believed
            than = "larger" if more > 0 else "smaller"
            return f"{abs(more):.2g} {self.unit} {than} than declared"
        return "agrees" if self.measured else "not measured by this recording"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A `Diagnosis` compares what a rig and a model declare with a recording."""

    values: tuple[Diagnosed, ...]
    instants: int
    """The number of different grasps that were compared."""

    @property
    def wrong(self) -> tuple[Diagnosed, ...]:
        """The values that the recording contradicts, the worst first."""
        return tuple(sorted((value for value in self.values if value.wrong), key=lambda value: -value.chi2))


def diagnose(observations: Iterable[Observation], rig: Rig, model: ObjectModel) -> Diagnosis:
    """Returns what a recording tells of the values that a rig and a model declare; raises InvalidInput.

    Observations that a tracker refuses are left out.
    """
    tracker = Tracker(rig, model)
    diagnoser = Diagnoser(tracker)
    for observation in observations:
        with contextlib.suppress(InvalidInput):
            tracker.update(observation)
            diagnoser.watch()
    return diagnoser.diagnosis()


class Diagnoser:
    """A `Diagnoser` watches a tracker through a recording, and gathers what its grasps have in common."""

    def __init__(self, tracker: Tracker) -> None:
        """The tracker's rig and model declare the values."""
        self.tracker, self.instants = tracker, 0
        self._offsets, self._sensors = JointOffsets.of(tracker.rig), FingertipSensors(tracker.rig)
        points = [max(finger.sigma_point, 1e-6) for finger in tracker.rig.fingers.values()]
        joints = [max(self._offsets.sigma, 1e-6)] * len(self._offsets.joints)
        self._sigmas = np.array([*joints, *points, *np.repeat(points, 3), DIAGNOSIS.sigma_size])
        """(j + 4 f + 1,) declared sigmas of joints, tips' radii, tips' positions (x, y, z), and the object's size."""
        self._H, self._slope = np.diag(self._sigmas**-2), np.zeros(len(self._sigmas))
        self._kept = dict[tuple[str, ...], list[Contacts]]()
        """By fingers that touched, the contacts of the instants that are kept."""

    def watch(self) -> None:
        """Adds the tracker's last observation, if a finger touches elsewhere than in those that are kept."""
        observation, estimate = self.tracker.processed, self.tracker.estimate
        corrected = self.tracker.track_state.correction
        if observation is None or estimate is None or corrected is None or corrected.stamp != observation.stamp:
            return
        if self.instants >= DIAGNOSIS.max_instants or observation.contacts or not estimate.consistent:
            return
        touch, T = self._sensors.contacts(observation), estimate.T_palm_object
        contacts, loads = touch.contacts, touch.loads
        if contacts is None or touch.by_error is None or loads is None or len(contacts) < DIAGNOSIS.min_fingers:
            return
        if not loads[:, 3].min() >= DIAGNOSIS.min_force or not self._is_new(touch.fingers, contacts):
            return
        K = touch.by_error @ np.linalg.inv(self._offsets.root)
        alone = contacts.covariance - K @ self._offsets.covariance @ K.swapaxes(1, 2)
        J = self._by_parameter(observation, touch.fingers, contacts, K, T)
        H, slope = contact_equations(self.tracker.model, contacts, alone, J, T)
        wide = np.repeat([DIAGNOSIS.sigma_pose, DIAGNOSIS.sigma_turn], 3)
        gain = np.linalg.solve(H[:6, :6] + np.diag(wide**-2), H[:6]).T
        self._H += H[6:, 6:] - gain[6:] @ H[:6, 6:]
        self._slope += slope[6:] - gain[6:] @ slope[:6]
        self._kept.setdefault(touch.fingers, []).append(contacts)
        self.instants += 1

    def diagnosis(self) -> Diagnosis:
        """Returns the diagnosis of all that was watched."""
        values = [value for value in self._contact_values() if value.sigma > 0]
        # Bonferroni: that any of n right values is called wrong has at most the stated probability.
        level = DIAGNOSIS.level / max(len(values), 1)
        judged = (
            replace(value, wrong=value.measured and float(chdtrc(1, value.chi2)) < level) for value in values
        )
        return Diagnosis(tuple(judged), self.instants)

    def _is_new(self, fingers: tuple[str, ...], contacts: Contacts) -> bool:
        """Returns whether a finger touches elsewhere than in all kept instants with the same fingers."""
        least = np.cos(DIAGNOSIS.new_normal)
        for kept in self._kept.get(fingers, ()):
            shift = np.linalg.norm(contacts.points_palm - kept.points_palm, axis=1).max()
            cosine = (contacts.normals_palm * kept.normals_palm).sum(axis=1).min()
            if shift < DIAGNOSIS.new_contact and cosine > least:
                return False
        return True

    def _by_parameter(
        self,
        observation: Observation,
        fingers: tuple[str, ...],
        contacts: Contacts,
        by_joint: Array,
        T_palm_object: Array,
    ) -> Array:
        """Returns (n, 6, j + 4 f + 1) the change of each contact by the error of each value, in its own unit.

        A joint that reads too much is one whose true angle is smaller.
        """
        n, rig = len(contacts), self.tracker.rig
        names, j = list(rig.fingers), by_joint.shape[2]
        Ts_palm_tip = rig.hand.Ts_palm_tip(observation.joint_positions or {})
        J = np.zeros((n, 6, len(self._sigmas)))
        J[:, :, :j] = -by_joint
        for i, finger in enumerate(fingers):
            f, R = names.index(finger), Ts_palm_tip[list(rig.hand.tips).index(finger), :3, :3]
            J[i, :3, j + f] = -contacts.normals_palm[i]  # the tip's surface is farther out, towards the object
            place = j + len(names) + 3 * f
            J[i, :3, place : place + 3] = R
        # A contact on a larger object is nearer to the middle, relative to the surface.
        middle = se3.apply(T_palm_object, self.tracker.model.center_object[None])[0]
        J[:, :3, -1] = middle - contacts.points_palm
        return J

    def _contact_values(self) -> Iterator[Diagnosed]:
        """Yields what contacts tell of joints, tips and the object's size."""
        S = np.linalg.inv(self._H)
        mean, variance = -S @ self._slope, S.diagonal()
        prior = self._sigmas**2
        with np.errstate(divide="ignore", invalid="ignore"):
            own = 1 / variance - 1 / prior
            estimated, sigma = mean / variance / own, own**-0.5
            chi2 = mean**2 / (prior - variance)
        told = own * prior > 1e-6
        j, fingers = len(self._offsets.joints), self.tracker.rig.fingers
        rows = [(f"joint {joint}", "°", 0.0, 180 / np.pi) for joint in self._offsets.joints]
        for name, finger in fingers.items():
            radius = float(np.mean(finger.tip.semi_axes))
            rows.append((f"tip {name} radius", "mm", radius, 1e3))
        for name in fingers:
            rows += [(f"tip {name} {axis}", "mm", 0.0, 1e3) for axis in "xyz"]
        rows.append(("object size", "%", 1.0, 100.0))
        for i, (name, unit, believed, factor) in enumerate(rows):
            known = bool(told[i])
            yield Diagnosed(
                name,
                unit,
                factor * believed,
                factor * float(self._sigmas[i]),
                factor * (believed + float(estimated[i])) if known else np.nan,
                factor * float(sigma[i]) if known else np.inf,
                float(chi2[i]) if known else 0.0,
            )
