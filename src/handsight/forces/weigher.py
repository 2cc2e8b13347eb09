"""The weight of the object in a hand over time, and as a sensor of its pose.

Instants with different directions of gravity are kept, carried through the grip, and weighed together; a weighing that
something contradicts is not believed. A believed one measures where the centre of mass is.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.copies import shallow_copy
from handsight.correction import PoseEstimate, WeightEvidence
from handsight.forces.loads import LoadSum, lacking, load_sum, read_in_air
from handsight.forces.object_motion import moved_with_tips
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.symmetry import kept_center
from handsight.observation import Observation
from handsight.rig import Rig


class WeigherOptions(NamedTuple):
    """`WeigherOptions` say how an object in the hand is weighed over time."""

    window: float = 0.2  # over which loads are averaged [s]
    max_gap: float = 0.1  # between two observations: after a longer one averaging starts anew [s]
    min_observations: int = 3  # observations of a mean
    min_weight: float = 0.25  # less than this is no weight [N]
    new_direction: float = np.deg2rad(3.0)
    """Angle by which gravity must have turned in the palm for another instant to be kept [rad]."""
    same_direction: float = np.deg2rad(1.5)
    """A kept instant is renewed where gravity is within this angle of where it was [rad]."""
    max_kept: int = 8  # instants that are kept
    max_acceleration: float = 0.3
    """Only instants below this [m/s²] and `max_turning` are kept: errors of others would have a common cause."""
    max_turning: float = 0.5  # angular acceleration [rad/s²]
    creep: float = 5e-4  # how fast contacts creep: sigma [m/(N s)]
    object_creep: float = 1.5e-4
    """Motion of the object that neither the tips' motion nor creep explains, per axis after a second [m], where two
    or more tips hold it; it grows with the root of time.
    """
    loose_object_creep: float = 2e-3  # the same where fewer do
    sigma_gravity: float = float(np.deg2rad(1.0))  # how far a world is off plumb, about each axis [rad]
    wrong_mass: float = 3.3  # in sigmas: a mass that is farther off is another one
    biased: float = 5.0  # in sigmas of a reading: by a larger bias a sensor is not as it was calibrated
    restart_after: float = 3.0
    """How long loads may contradict what was kept before all of that is dropped [s]."""
    trusted_directions: int = 3
    """Directions that must fit then before any is believed: a single one fits whatever presses."""


WEIGHER = WeigherOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A `Kept` is an earlier instant with a direction of gravity of its own."""

    carried: Carried
    direction: Array
    """(3,) unit, of gravity in the palm when this direction was first kept."""


class Weigher:
    """A `Weigher` estimates the weight of one object in one hand over time.

    Its methods bind its attributes anew and change none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig, mass: float | None = None, sigma_mass: float = 0.0) -> None:
        """`mass`: that of the object [kg], where it is known, with its standard deviation."""
        self.rig, self.mass, self.sigma_mass = rig, mass, sigma_mass
        self.weighing: Weighing | None = None
        """The last one; None before the first, and after the object was released."""
        self.reason = "nothing is lifted"
        """Why there is no weighing, or why it is not believed; empty where it is."""
        sensors = [[finger.sigma_force] * 3 + [finger.sigma_torque] * 3 for finger in rig.fingers.values()]
        self._biases = np.array(sensors).reshape(-1)
        """(6 t,) sigmas: a calibration leaves about as much as a reading's noise."""
        self.tare = np.zeros((len(rig.fingers), 6))
        """(t, 6) what the tips read while they touch nothing, in their sensors' frames [N], [N m]."""
        self._lifted = False
        self._window: tuple[Observation, ...] = ()
        self._kept: tuple[Kept, ...] = ()
        self._last: LoadSum | None = None
        self._fits_at = -np.inf
        self._doubted = False
        """Whether all that was kept was dropped because loads contradicted it, and no weight was believed since."""

    @property
    def believed(self) -> Weighing | None:
        """The last weighing, where nothing speaks against it."""
        return None if self.reason else self.weighing

    def forget(self, reason: str) -> None:
        """Drops all weighings, because the object was released, put down or has slipped: it may be elsewhere."""
        if self._last is not None or self.reason != reason:
            self._window, self._kept, self._last, self.weighing, self.reason = (), (), None, None, reason
            self._doubted = False

    @property
    def biased(self) -> tuple[str, ...]:
        """Fingers whose sensors read more than their calibration leaves, which is subtracted."""
        sizes = np.linalg.norm(self.tare[:, :3], axis=1)
        named = zip(self.rig.fingers.items(), sizes, strict=True)
        return tuple(name for (name, finger), size in named if size > WEIGHER.biased * finger.sigma_force)

    def listen(self, observation: Observation) -> None:
        """Measures the tips' biases in the air, while nothing is lifted."""
        self._lifted = False
        window = self._full_window(observation)
        if window and not lacking(self.rig, window):
            read = read_in_air(self.rig, window)
            self.tare = np.where(np.isnan(read), self.tare, read)

    def update(
        self,
        observation: Observation,
        fingers: tuple[str, ...],
        contacts: Contacts | None,
        joints: tuple[Array, Array],
    ) -> bool:
        """Returns whether there is a new weighing, after an observation of an object in the air.

        `fingers` touch it, and `contacts` are theirs in the palm, in the same order. `joints`: what is known of the
        joints' constant errors, their mean (j,) and L (j, j), L Lᵀ their covariance [rad].
        """
        if not self._lifted:
            self._lifted, self._window = True, ()
        window = self._full_window(observation)
        if not window:
            return False
        if why := lacking(self.rig, window):
            self.reason = why
            return False
        places = [] if contacts is None else zip(contacts.points_palm, contacts.normals_palm, strict=True)
        load = load_sum(self.rig, window, dict(zip(fingers, places, strict=False)), joints[0])
        load = replace(load, wrench=load.wrench - load.by_bias @ self.tare.ravel())
        if np.linalg.norm(load.wrench[:3]) < WEIGHER.min_weight:
            self.reason = f"less than {WEIGHER.min_weight:g} N hangs on the fingertips"
            return False
        if self._last is not None:
            self._kept = _carried_on(self._kept, self._last, load)
        self._last = load
        self._weigh(load, joints[1])
        if load.acceleration <= WEIGHER.max_acceleration and load.turning <= WEIGHER.max_turning:
            self._keep(load)
        return True

    def _full_window(self, observation: Observation) -> tuple[Observation, ...]:
        """Returns the observations of a window that this one completes, else an empty tuple."""
        if observation.joint_positions is None or observation.T_world_palm is None or not self.rig.fingers:
            return ()
        window = self._window
        if window and not 0 < observation.stamp - window[-1].stamp <= WEIGHER.max_gap:
            window = ()
        self._window = window = (*window, observation)
        lasts = observation.stamp - window[0].stamp
        if lasts < WEIGHER.window - 1e-9 or len(window) < WEIGHER.min_observations:
            return ()
        self._window = ()
        return window

    def _weigh(self, load: LoadSum, root: Array) -> None:
        """Weighs by the kept instants and a new one, and decides whether the result is believed."""
        direction = load.gravity / np.linalg.norm(load.gravity)
        others = [
            k.carried for k in self._kept if _angle(k.carried.load.gravity, direction) > WEIGHER.new_direction
        ]
        instants = [*others, Carried(load)]
        unknowns = Unknowns(root, self._biases, WEIGHER.creep, self.rig.gravity, WEIGHER.sigma_gravity)
        found = weigh(instants, unknowns, self.weighing)
        self.reason = ""
        if found.mass <= 0:
            self.reason = "the object seems to be pulled up: does gravity point the other way?"
        elif self.mass is not None:
            known = found.given_mass(self.mass, self.sigma_mass)
            off = abs(found.mass - self.mass) / np.hypot(found.sigma_mass, self.sigma_mass)
            if off <= WEIGHER.wrong_mass or len(instants) == 1:
                found = known
            else:
                self.reason = f"it weighs {found.mass:.3g} kg, not {self.mass:.3g}"
        if not self.reason and not found.consistent:
            self.reason = "the loads are not those of this weight alone: something else bears part of it"
        if not self.reason and self._doubted and len(instants) < WEIGHER.trusted_directions:
            self.reason = (
                f"loads have fitted no weight, and not one in {WEIGHER.trusted_directions} directions since"
            )
        self._doubted = self._doubted and bool(self.reason)
        self.weighing = found
        if not self.reason or self._fits_at == -np.inf:
            self._fits_at = load.stamp
        if load.stamp - self._fits_at > WEIGHER.restart_after:
            self._kept, self._fits_at, self._doubted = (), load.stamp, True

    def _keep(self, load: LoadSum) -> None:
        """Keeps a static instant if its direction of gravity is new, or replaces the one of the same direction."""
        direction = load.gravity / np.linalg.norm(load.gravity)
        angles = [_angle(kept.direction, direction) for kept in self._kept]
        near = int(np.argmin(angles)) if angles else -1
        if near < 0 or angles[near] > WEIGHER.new_direction:
            kept = self._kept if len(self._kept) < WEIGHER.max_kept else self._kept[1:]
            self._kept = (*kept, Kept(Carried(load), direction))
        elif angles[near] < WEIGHER.same_direction:
            new = replace(self._kept[near], carried=Carried(load))
            self._kept = (*self._kept[:near], new, *self._kept[near + 1 :])


def _carried_on(kept: tuple[Kept, ...], last: LoadSum, load: LoadSum) -> tuple[Kept, ...]:
    """Returns the kept instants after what the grip has done between two loads."""
    if not kept:
        return kept
    motion = moved_with_tips(last, load)
    T, creep = (np.eye(4), np.zeros(6)) if motion is None else motion
    sigma = WEIGHER.loose_object_creep if motion is None else WEIGHER.object_creep
    sigma *= float(np.sqrt(max(load.stamp - last.stamp, 0.0)))
    return tuple(replace(each, carried=each.carried.moved(T, creep, sigma)) for each in kept)


def _angle(gravity: Array, direction: Array) -> float:
    """Returns the angle between a vector and a unit vector [rad]."""
    return float(np.arctan2(np.linalg.norm(se3.skew(gravity) @ direction), gravity @ direction))


@dataclass(frozen=True, slots=True, eq=False)
class ObjectWeight:
    """An `ObjectWeight` is what the object in the hand weighs, by the fingertips' loads."""

    mass: float
    """[kg]"""
    sigma_mass: float
    center_object: Array
    """(3,) its centre of mass in the object's frame [m]."""
    covariance: Array
    """(3, 3) of that, along the object's axes, with the pose's uncertainty [m²]."""
    center_palm: Array
    """(3,) its centre of mass in the palm [m]."""
    covariance_palm: Array
    """(3, 3) of that, along the palm's axes [m²]."""
    directions: int
    """In how many directions of gravity it was weighed: after one, the centre's height along that is open."""
    reason: str
    """Why it is not believed; empty where it is."""
    biased: tuple[str, ...]
    """Fingers whose sensors read more in the air than their calibration leaves, which is subtracted."""

    def kept_by_symmetries(self, model: ObjectModel) -> tuple[Array, float]:
        """Returns the centre of mass (3,) that the object's symmetries allow [m], and its largest sigma."""
        zero = kept_center(model.symmetries, np.zeros(3))
        kept = np.column_stack([kept_center(model.symmetries, axis) - zero for axis in np.eye(3)])
        variances = np.linalg.eigvalsh(kept @ self.covariance @ kept.T)
        return kept_center(model.symmetries, self.center_object), float(np.sqrt(max(variances[-1], 1e-8)))


class WeightSensor:
    """A `WeightSensor` weighs the object in the air, and measures where its centre of mass is in the palm."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """A model without a centre of mass is weighed too, but its weight says nothing of its pose."""
        mass, sigma_declared = model.mass, 0.03  # one standard deviation, as a part of the mass
        self.weigher = Weigher(rig, mass, sigma_declared * (mass or 0.0))
        self.model = model
        self._used: Weighing | None = None
        """The weighing that the last correction used."""

    def copied(self) -> "WeightSensor":
        """Returns a copy that evolves apart from this one."""
        copy = shallow_copy(self)
        copy.weigher = shallow_copy(self.weigher)
        return copy

    def update(
        self,
        observation: Observation,
        touch: tuple[tuple[str, ...], Contacts | None],
        joints: tuple[Array, Array],
        *,
        grasped: bool,
        lifted: bool,
        finger_on_table: bool,
    ) -> None:
        """Weighs an object that is grasped and in the air; of one that is not, measures the tips' biases.

        `touch` (fingers and their contacts) and `joints` are as `Weigher.update` takes them.
        """
        reason = ""
        if not grasped:
            reason = "nothing is grasped"
        elif not lifted and observation.T_world_palm is not None:
            reason = "the palm has not risen since the grasp"
        elif finger_on_table:
            reason = "a finger is on the table"
        if reason:
            self.weigher.forget(reason)
            self.weigher.listen(observation)
        else:
            self.weigher.update(observation, *touch, joints)

    @property
    def news(self) -> bool:
        """Whether the weight says something else of the pose than at the last correction."""
        found, used = self.weigher.believed, self._used
        if found is used or self.model.center_of_mass is None:
            return False
        if found is None or used is None or found.directions != used.directions:
            return True
        return bool(np.abs(found.center_palm - used.center_palm).max() > 1e-3)  # [m]

    def evidence(self) -> WeightEvidence | None:
        """Returns where the object's centre of mass is; None where the model has none, or no weighing is believed."""
        found, center = self.weigher.believed, self.model.center_of_mass
        if found is None or center is None:
            return None
        own = self.model.sigma_center_of_mass**2 * np.eye(3)
        return WeightEvidence(center, found.center_palm, found.covariance_center + own)

    def used(self) -> Weighing | None:
        """Returns the weighing that is believed, with which later ones are compared by `news`: a correction uses it."""
        self._used = self.weigher.believed
        return self._used

    def of(self, estimate: PoseEstimate | None) -> ObjectWeight | None:
        """Returns the weight of an object at a pose; None where it was not weighed since it was grasped."""
        found = self.weigher.weighing
        if found is None or estimate is None:
            return None
        T = estimate.T_palm_object
        R, center = T[:3, :3], T[:3, :3].T @ (found.center_palm - T[:3, 3])
        by_pose = GaussianPose(T, estimate.bounded_covariance).at_point(center).covariance[:3, :3]
        reason, declared = self.weigher.reason, self.model.center_of_mass
        if not reason and estimate.weight_fits is False and declared is not None:
            off = 1e3 * float(np.linalg.norm(center - declared))
            reason = f"contacts and vision have the centre of mass elsewhere, by {off:.0f} mm"
        return ObjectWeight(
            mass=found.mass,
            sigma_mass=found.sigma_mass,
            center_object=center,
            covariance=R.T @ (found.covariance_center + by_pose) @ R,
            center_palm=found.center_palm,
            covariance_palm=found.covariance_center,
            directions=found.directions,
            reason=reason,
            biased=self.weigher.biased,
        )
