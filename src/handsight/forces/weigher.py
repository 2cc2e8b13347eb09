"""Weighing over time: which instants are kept, how they are carried through the grip, when they are not believed."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.forces.loads import LoadSum, lacking, load_sum
from handsight.forces.odometry import moved_with_tips
from handsight.forces.tare import read_in_air
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh
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
    creep: float = 5e-4  # how fast contacts creep: sigma [m/(N s)]
    object_creep: float = 1.5e-4
    """Motion of the object that neither the tips' motion nor creep tells, per axis after a second [m], where at least
    two tips hold it; it grows with the root of time.
    """
    loose_object_creep: float = 2e-3  # the same where fewer do
    sigma_gravity: float = float(np.deg2rad(1.0))  # how far a world is off plumb, about each axis [rad]
    wrong_mass: float = 3.3  # in sigmas: a mass that is farther off is another one
    biased: float = 5.0  # in sigmas of a reading: by a larger bias a sensor is not as it was calibrated
    restart_after: float = 3.0
    """How long loads may contradict what was kept before all of that is dropped [s]."""
    trusted_directions: int = 3
    """Directions that must fit then before any is believed: one fits whatever presses."""


WEIGHER = WeigherOptions()

STILL = 0.3, 0.5
"""Only instants with smaller accelerations [m/s²], [rad/s²] are kept: what is wrong with others has one cause."""


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A `Kept` is an instant of earlier."""

    carried: Carried
    direction: Array
    """(3,) unit, gravity in the palm as it was when this was begun."""


class Weigher:
    """A `Weigher` estimates the weight of one object in one hand, over time; what changes is bound anew, never
    changed in place."""

    def __init__(self, rig: Rig, mass: float | None = None, sigma_mass: float = 0.0) -> None:
        """`mass` of the object [kg], where it is known, and its sigma."""
        self.rig, self.mass, self.sigma_mass = rig, mass, sigma_mass
        self.weighing: Weighing | None = None
        """The last; None before there was one, and since the object was let go."""
        self.reason = "nothing is lifted"
        """Why it is not believed, or there is none; empty where it is."""
        sensors = [[finger.sigma_force] * 3 + [finger.sigma_torque] * 3 for finger in rig.fingers.values()]
        self._biases = np.array(sensors).reshape(-1)
        """(6 t,) sigmas: what a calibration has left is about as much as a reading's noise."""
        self.tare = np.zeros((len(rig.fingers), 6))
        """(t, 6) what the tips have read while they touched nothing, in their sensors' frames [N], [N m]."""
        self._lifted = False
        self._window: tuple[Observation, ...] = ()
        self._kept: tuple[Kept, ...] = ()
        self._last: LoadSum | None = None
        self._fits_at = -np.inf
        self._doubted = False
        """Whether what was kept has been dropped because loads contradicted it, and nothing has told another yet."""

    @property
    def believed(self) -> Weighing | None:
        """The last weighing, where nothing speaks against it."""
        return None if self.reason else self.weighing

    def forget(self, reason: str) -> None:
        """Forgets what is no longer true: the object has been let go, put down, or has slipped: what was weighed says
        nothing more of where it is."""
        if self._last is not None or self.reason != reason:
            self._window, self._kept, self._last, self.weighing, self.reason = (), (), None, None, reason
            self._doubted = False

    @property
    def biased(self) -> tuple[str, ...]:
        """Fingers whose sensors read more than their calibration leaves, which is taken off."""
        sizes = np.linalg.norm(self.tare[:, :3], axis=1)
        named = zip(self.rig.fingers.items(), sizes, strict=True)
        return tuple(name for (name, finger), size in named if size > WEIGHER.biased * finger.sigma_force)

    def listen(self, observation: Observation) -> None:
        """Takes note of what tips read in the air, while nothing is lifted."""
        self._lifted = False
        window = self._full(observation)
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

        `fingers` that touch it, and in their order their contacts in the palm. `joints`: what is known of the joints'
        constant errors, their mean (j,) and L (j, j), L Lᵀ their covariance [rad].
        """
        if not self._lifted:
            self._lifted, self._window = True, ()
        window = self._full(observation)
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
        self._carry(load)
        self._weigh(load, joints[1])
        self._keep(load)
        return True

    def _full(self, observation: Observation) -> tuple[Observation, ...]:
        """Returns the observations of a window that this one completes; none as long as it does not."""
        if observation.joint_positions is None or observation.T_world_palm is None or not self.rig.fingers:
            return ()
        window = self._window
        if window and not 0 < observation.stamp - window[-1].stamp <= WEIGHER.max_gap:
            window = ()
        self._window = window = (*window, observation)
        if (
            observation.stamp - window[0].stamp < WEIGHER.window - 1e-9
            or len(window) < WEIGHER.min_observations
        ):
            return ()
        self._window = ()
        return window

    def _carry(self, load: LoadSum) -> None:
        """Brings what is kept through what the grip has done since the last."""
        last, self._last = self._last, load
        if last is None or not self._kept:
            return
        found, passed = moved_with_tips(last, load), max(load.stamp - last.stamp, 0.0)
        T, creep = (np.eye(4), np.zeros(6)) if found is None else found
        creep_sigma = (WEIGHER.loose_object_creep if found is None else WEIGHER.object_creep) * np.sqrt(
            passed
        )
        self._kept = tuple(
            replace(kept, carried=_moved(kept.carried, T, creep, float(creep_sigma))) for kept in self._kept
        )

    def _weigh(self, load: LoadSum, root: Array) -> None:
        """Weighs by what is kept and what is new, and judges it."""
        direction = load.gravity / np.linalg.norm(load.gravity)
        now = Carried(load, np.eye(4), np.zeros(6), 0.0)
        others = [
            k.carried for k in self._kept if _angle(k.carried.load.gravity, direction) > WEIGHER.new_direction
        ]
        instants = [*others, now]
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
        """Keeps a still instant if gravity is as at none that is, or in place of the one where it is the same."""
        if load.acceleration > STILL[0] or load.turning > STILL[1]:
            return
        direction = load.gravity / np.linalg.norm(load.gravity)
        carried = Carried(load, np.eye(4), np.zeros(6), 0.0)
        angles = [_angle(kept.direction, direction) for kept in self._kept]
        near = int(np.argmin(angles)) if angles else -1
        if near < 0 or angles[near] > WEIGHER.new_direction:
            kept = self._kept if len(self._kept) < WEIGHER.max_kept else self._kept[1:]
            self._kept = (*kept, Kept(carried, direction))
        elif angles[near] < WEIGHER.same_direction:
            new = replace(self._kept[near], carried=carried)
            self._kept = (*self._kept[:near], new, *self._kept[near + 1 :])


def _moved(carried: Carried, T: Array, creep: Array, creep_sigma: float) -> Carried:
    """Returns an instant after another step: T (4, 4) as the tips tell, the creep (6,), and the sigma of what they do
    not."""
    return Carried(
        carried.load,
        T @ carried.T_now_then,
        carried.creep + creep,
        float(np.hypot(carried.sigma, creep_sigma)),
    )


def _angle(gravity: Array, direction: Array) -> float:
    """Returns the angle between a vector and a unit vector [rad]."""
    return float(np.arctan2(np.linalg.norm(se3.skew(gravity) @ direction), gravity @ direction))
