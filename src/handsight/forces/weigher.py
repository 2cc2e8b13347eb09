"""The weight of the object in a hand over time, and as a sensor of its pose.

Instants with different directions of gravity are kept, carried along as the object moves in the grip, and weighed
together. A weighing that something contradicts is not trusted; a trusted one measures the centre of mass in the palm.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PoseEstimate, WeightEvidence
from handsight.forces.loads import LoadSum, lacking, load_sensors, load_sum, read_in_air
from handsight.forces.object_motion import moved_with_tips
from handsight.forces.weight import Carried, Unknowns, Weighing, weigh
from handsight.gaussian_pose import GaussianPose
from handsight.objects import ObjectModel
from handsight.objects.symmetry import kept_center
from handsight.observation import Observation, seconds
from handsight.rig import Rig

WINDOW = 0.2  # over which loads are averaged [s]
MAX_GAP = 0.1  # between two observations: after a longer one averaging starts anew [s]
MIN_OBSERVATIONS = 3  # fewest observations of a mean
MAX_REACH = 0.5  # a centre of mass farther from the loads is not that of an object in a hand [m]
MIN_WEIGHT = 0.25  # a smaller force is not weighed [N]
NEW_DIRECTION = np.deg2rad(3.0)  # turn of gravity in the palm for another instant to be kept [rad]
SAME_DIRECTION = np.deg2rad(1.5)  # a kept instant with gravity so near is replaced [rad]
MAX_KEPT = 8  # most instants that are kept
MAX_ACCELERATION = 0.3
"""Instants with less acceleration [m/s²], and less than `max_turning`, are kept: others' errors are correlated."""
MAX_TURNING = 0.5  # angular acceleration [rad/s²]
CREEP = 5e-4  # standard deviation of the speed at which contacts creep [m/(N s)]
OBJECT_CREEP = 1.5e-4
"""Sigma of the object's motion in addition to that of the tips and of creep, per axis after a second, where two or
more tips hold it [m]; it grows with the root of time."""
LOOSE_OBJECT_CREEP = 3e-3
"""The same where fewer tips hold it, because the others do not touch it or are at their limits of friction: boxes
of .3 to .5 kg move 3 to 6 mm in a second then, always the same way."""
SIGMA_UNFELT = 0.12
"""Sigma per axis of a force on the object that no sensor feels, where the loads would not fit a weight otherwise [N]:
.2 N in all. Twice as much is refused, mostly."""
SIGMA_GRAVITY = float(np.deg2rad(1.0))  # of its direction in the world, about each axis [rad]
WRONG_MASS = 2.33
"""A mass that is farther off than so many sigmas contradicts the declared one: by chance in 2 %, whose share of the
sigmas is mostly that of the declared mass, so that more directions are not more chances."""
RIGHT_MASS = 1.64  # a declared mass stays contradicted until it is nearer (a level of 10 %)
OTHER_OBJECT = 3.29
"""A mass that is farther off than so many sigmas (by chance in 1 of 1000) makes it doubtful which object is held: that
is said of the pose, while a mass that is off by less only costs the evidence of its weight."""
BIASED = 5.0  # a larger bias, in sigmas of a reading, is reported
PULL = 0.3  # cosine of forces with the way out of the grasp, below whose negative fingers pull
RESTART_AFTER = 3.0  # how long loads may contradict the kept instants before these are dropped [s]
TRUSTED_DIRECTIONS = 3  # directions that must fit after that: with one, any load fits


PULLED_UP = "the object seems to be pulled up: does gravity point the other way?"
WRONG_SIGN = "the fingers seem to pull on the object: have the forces the right sign (each sensor's reading)?"
WEIGHS = "it weighs"
BORNE_ELSEWHERE = "the loads are not those of this weight alone: something else bears part of it"
ASSUMED = "the loads fit a weight only if sensors have wrong gains, or a small force is not measured"


class Weigher:
    """Estimates the weight of one object in one hand over time.

    Its methods bind its attributes anew and change none in place, so that a shallow copy evolves apart from it.
    """

    def __init__(self, rig: Rig, mass: float | None = None, sigma_mass: float = 0.0) -> None:
        """`mass`: the object's declared mass with its standard deviation [kg]; None: unknown."""
        self.rig, self.mass, self.sigma_mass = rig, mass, sigma_mass
        self.weighing: Weighing | None = None
        """The last weighing; None before the first one since the object was grasped."""
        self.reason = "nothing is lifted"
        """Why there is no weighing, or why it is not trusted; empty where it is trusted."""
        self.instants: tuple[Carried, ...] = ()  # the instants that it used, the last one at its end
        self.other_object = ""
        """How the mass contradicts the declared one so far that another object may be held; empty where it does not. It
        stays until the object is released, or a later weighing does not contradict it."""
        self.assumed = ""  # what the rig does not have, and a trusted weighing still has to assume
        self._names: frozenset[str] = frozenset()  # names of readings that came, by which sensors are chosen
        self.sensors = load_sensors(rig)  # the t load sensors
        self.tare = np.zeros((len(self.sensors), 6))
        """(t, 6) the biases, read while the tips touched nothing, in their sensors' frames [N, N m]."""
        self._lifted = False
        self._window: tuple[Observation, ...] = ()
        self._kept: tuple[tuple[Carried, Array], ...] = ()
        """Earlier instants with other directions of gravity, each with its unit vector (3,) as it was first kept."""
        self._summed: LoadSum | None = None  # that of a window that has just ended, until it is weighed
        self._last: LoadSum | None = None
        self._fits_at = -np.inf
        self._loose = False  # whether the object could turn about one finger at any time since the last load
        self._doubted = False  # whether loads contradicted what was kept, and no weighing was trusted since

    @property
    def believed(self) -> Weighing | None:
        """The last weighing if it is trusted, else None."""
        return None if self.reason else self.weighing

    def forget(self, reason: str) -> None:
        """Drops all weighings and kept instants, for a reason such as that the object was released or has slipped."""
        if self._last is not None or self._summed is not None or self.reason != reason:
            self._window = ()
            self._kept = ()
            self._doubted = False
            self.assumed = ""
            self.reason = reason
            self._summed = self._last = self.weighing = None

    @property
    def biased(self) -> tuple[str, ...]:
        """Fingers whose sensors have larger biases than calibration leaves; these are subtracted."""
        sizes = np.linalg.norm(self.tare[:, :3], axis=1)
        named = zip(self.sensors, sizes, strict=True)
        return tuple(sensor.name for sensor, size in named if size > BIASED * sensor.sigma[0])

    def listen(self, observation: Observation) -> None:
        """Measures the sensors' biases while nothing is lifted, if their tips are in the air."""
        self._lifted = False
        window = self._full_window(observation)
        if window and not lacking(self.sensors, window):
            read = read_in_air(self.rig, window, self.sensors)
            self.tare = np.where(np.isnan(read), self.tare, read)

    def update(
        self,
        observation: Observation,
        fingers: tuple[str, ...],
        contacts: Contacts | None,
        joints: tuple[Array, Array],
        *,
        pivots: bool = False,
    ) -> bool:
        """Returns whether there is a new weighing, after an observation of an object in the air: one observation after
        a window has ended, as to sum its loads and to weigh would take too long for one update.

        `fingers` touch it, and `contacts` are theirs in the palm, in the same order. `joints`: the estimated constant
        errors of the joints, their mean (j,) and L (j, j), where L Lᵀ is their covariance [rad]. `pivots`: fewer than
        two of the fingers are below their limits of friction (`Slip.pivots`).
        """
        self._loose = self._loose or pivots
        if not self._lifted:
            self._lifted = True
            self._window = ()
            self._summed = None
        window = self._full_window(observation)
        if self._summed is not None:
            self._weigh(self._summed, joints[1], pivots=pivots)
            return True
        if not window:
            return False
        if reason := lacking(self.sensors, window):
            self.reason = reason
            return False
        places = [] if contacts is None else zip(contacts.points_palm, contacts.normals_palm, strict=True)
        touched = dict(zip(fingers, places, strict=False))
        load = load_sum(self.rig, window, touched, joints[0], self.sensors)
        tare = self.tare.ravel()
        load = replace(load, wrench=load.wrench - load.by_bias @ tare, readings=load.readings - tare)
        if np.linalg.norm(load.wrench[:3]) < MIN_WEIGHT:
            self.reason = f"less than {MIN_WEIGHT:g} N hangs on the fingertips"
        else:
            self._summed = load
        return False

    def _full_window(self, observation: Observation) -> tuple[Observation, ...]:
        """Returns the observations of the window that this one completes, or an empty tuple."""
        if observation.joint_positions is None or observation.T_world_palm is None or not self.rig.fingers:
            return ()
        if not observation.wrenches.keys() <= self._names:
            self._names |= observation.wrenches.keys()
            sensors = load_sensors(self.rig, self._names)
            if [each.name for each in sensors] != [each.name for each in self.sensors]:
                self.forget("other sensors measure its load now")
                self.sensors = sensors
                self.tare = np.zeros((len(sensors), 6))
        window = self._window
        if window and not 0 < seconds(observation.stamp, window[-1].stamp) <= MAX_GAP:
            window = ()
        self._window = window = (*window, observation)
        lasts = seconds(observation.stamp, window[0].stamp)
        if lasts < WINDOW or len(window) < MIN_OBSERVATIONS:
            return ()
        self._window = ()
        return window

    def _weigh(self, load: LoadSum, root: Array, *, pivots: bool) -> None:
        """Weighs with the kept instants and a new one, and decides whether the result is trusted."""
        self._carry_on(load)
        self._last = load
        self._loose = pivots
        self._summed = None
        direction = load.gravity / np.linalg.norm(load.gravity)
        new = _angles([each.load.gravity for each, _ in self._kept], direction) > NEW_DIRECTION
        far = [each for (each, _), is_new in zip(self._kept, new, strict=True) if is_new]
        self.instants = (*far, Carried(load))
        found = self._found(root)
        lifts = found.mass < -WRONG_MASS * found.sigma_mass
        other_mass = self._other_mass(found)
        if self.mass is not None and not lifts and not other_mass:
            found = found.given_mass(self.mass, self.sigma_mass)
        self.reason = self._distrust(found, load, other_mass, lifts=lifts)
        self._doubted = self._doubted and bool(self.reason)
        self.weighing = found
        # Where only the declared mass contradicts them, the loads still fit those that were kept.
        fits = not self.reason or (found.consistent and not self._doubted)
        if fits or self._fits_at == -np.inf:
            self._fits_at = load.stamp
        if seconds(load.stamp, self._fits_at) > RESTART_AFTER:
            self._kept = ()
            self._fits_at = load.stamp
            self._doubted = True
        if load.acceleration <= MAX_ACCELERATION and load.turning <= MAX_TURNING:
            self._keep(load)

    def _carry_on(self, load: LoadSum) -> None:
        """Carries the kept instants on to that of a load, as the object has moved in the grip since the last one."""
        if not self._kept or self._last is None:
            return
        motion = moved_with_tips(self._last, load)
        T, creep = (np.eye(4), np.zeros(6)) if motion is None else motion
        speed = LOOSE_OBJECT_CREEP if self._loose or motion is None else OBJECT_CREEP
        since = max(seconds(load.stamp, self._last.stamp), 0.0)
        sigma = speed * float(np.sqrt(since))
        self._kept = tuple((each.moved(T, creep, sigma), way) for each, way in self._kept)

    def _found(self, root: Array) -> Weighing:
        """Returns what the instants weigh, and notes what that has to assume; `root` is the L of `update`."""
        instants = self.instants
        # Calibration leaves biases that are about as large as a reading's noise.
        biases = np.concatenate([sensor.sigma for sensor in self.sensors])
        gains = np.repeat([sensor.sigma_gain for sensor in self.sensors], 6)
        exactly = Unknowns(root, biases, CREEP, self.rig.gravity, SIGMA_GRAVITY)
        found = weigh(instants, replace(exactly, gains=gains), self.weighing)
        self.assumed = "" if weigh(instants, exactly, found).consistent else ASSUMED
        if self.assumed and found.consistent:
            found = weigh(instants, replace(exactly, gains=gains, unfelt=SIGMA_UNFELT), found)
        return found

    def _distrust(self, found: Weighing, load: LoadSum, other_mass: str, *, lifts: bool) -> str:
        """Returns why a weighing is not trusted; empty where it is. `lifts`: its mass is below zero."""
        if lifts:
            return WRONG_SIGN if _pulls(load) else PULLED_UP
        if other_mass:
            return other_mass
        away = float(np.abs(found.center_palm - load.middle_palm).max())
        if not away < MAX_REACH:
            return f"the loads would be those of a weight {away:.1f} m away from the hand"
        if not found.consistent:
            return BORNE_ELSEWHERE
        if self._doubted and len(self.instants) < TRUSTED_DIRECTIONS:
            return f"loads have fitted no weight, and not one in {TRUSTED_DIRECTIONS} directions since"
        return ""

    def _other_mass(self, found: Weighing) -> str:
        """Returns how a weighing contradicts the declared mass; empty where it does not, as in one direction alone."""
        if self.mass is None or found.directions == 1:
            return ""
        off = abs(found.mass - self.mass) / np.hypot(found.sigma_mass, self.sigma_mass)
        weighs = f"{1e3 * found.mass:.0f} ± {1e3 * found.sigma_mass:.0f} g"
        said = f"{WEIGHS} {weighs}, the model says {1e3 * self.mass:.0f} ± {1e3 * self.sigma_mass:.0f} g"
        # Loads that are not those of a weight alone have no mass, and in two directions that is seldom noticed.
        tells = found.consistent and found.directions >= TRUSTED_DIRECTIONS
        is_other = tells and off > (RIGHT_MASS if self.other_object else OTHER_OBJECT)
        if tells or off < RIGHT_MASS:
            self.other_object = f"{said}: this may be another object" if is_other else ""
        limit = RIGHT_MASS if self.reason.startswith(WEIGHS) else WRONG_MASS
        return said if off > limit else ""

    def _keep(self, load: LoadSum) -> None:
        """Keeps a static instant if its direction of gravity is new, or replaces the one of the same direction."""
        direction = load.gravity / np.linalg.norm(load.gravity)
        angles = _angles([way for _, way in self._kept], direction)
        near = int(angles.argmin()) if self._kept else -1
        if near < 0 or angles[near] > NEW_DIRECTION:
            kept = self._kept if len(self._kept) < MAX_KEPT else self._kept[1:]
            self._kept = (*kept, (Carried(load), direction))
        elif angles[near] < SAME_DIRECTION:
            new = Carried(load), self._kept[near][1]
            self._kept = (*self._kept[:near], new, *self._kept[near + 1 :])


def _pulls(load: LoadSum) -> bool:
    """Returns whether the fingers' forces lead out of the grasp."""
    arms = load.Ts_palm_tip[:, :3, 3] - load.middle_palm
    size = np.linalg.norm(load.forces) * np.linalg.norm(arms) + 1e-9
    return bool((load.forces * arms).sum() < -PULL * size)


def _angles(vectors: Sequence[Array], direction: Array) -> Array:
    """Returns the angles (k,) between k vectors (3,) and a unit vector [rad]."""
    rows = np.array(vectors).reshape(-1, 3)
    return np.asarray(np.arctan2(np.linalg.norm(rows @ se3.skew(direction), axis=1), rows @ direction))


@dataclass(frozen=True, slots=True, eq=False)
class ObjectWeight:
    """The mass and the centre of mass of the object in the hand, from the fingertips' loads."""

    mass: float  # [kg]
    sigma_mass: float  # [kg]
    center_object: Array  # (3,) the centre of mass in the object's frame [m]
    covariance: Array  # (3, 3) of `center_object`, along the object's axes, with the pose's uncertainty [m²]
    center_palm: Array  # (3,) the centre of mass in the palm [m]
    covariance_palm: Array  # (3, 3) of `center_palm`, along the palm's axes [m²]
    directions: int
    """The number of directions of gravity in which it was weighed; one leaves the centre's height along it unknown."""
    reason: str  # why the weight is not trusted; empty where it is trusted
    biased: tuple[str, ...]
    """Fingers whose sensors have larger biases in the air than calibration leaves; these are subtracted."""
    assumed: str = ""
    """What the weighing has to assume, because the loads would not fit a weight if gains were exact: wrong gains, or a
    small force that no sensor measures. Empty where they would."""

    def kept_by_symmetries(self, model: ObjectModel) -> tuple[Array, float]:
        """Returns the centre of mass (3,) that the object's symmetries allow, and its largest sigma [m]."""
        zero = kept_center(model.symmetries, np.zeros(3))
        kept = np.column_stack([kept_center(model.symmetries, axis) - zero for axis in np.eye(3)])
        variances = np.linalg.eigvalsh(kept @ self.covariance @ kept.T)
        return kept_center(model.symmetries, self.center_object), float(np.sqrt(max(variances[-1], 1e-8)))


class WeightSensor:
    """Weighs the object in the air, and measures where its centre of mass is in the palm."""

    def __init__(self, rig: Rig, model: ObjectModel) -> None:
        """An object without a declared centre of mass is weighed too, but that is no evidence of its pose."""
        self.weigher = Weigher(rig, model.mass, model.sigma_mass)
        self.model = model
        self._used: Weighing | None = None  # the weighing that the last correction used

    def copied(self) -> "WeightSensor":
        """Returns a copy that evolves apart from this one."""
        other = copy(self)
        other.weigher = copy(self.weigher)
        return other

    def update(
        self,
        observation: Observation,
        touch: tuple[tuple[str, ...], Contacts | None],
        joints: tuple[Array, Array],
        *,
        grasped: bool,
        lifted: bool,
        finger_on_table: bool,
        pivots: bool,
        borne: bool,
    ) -> None:
        """Weighs the object if it is grasped and in the air; else measures the sensors' biases.

        `touch` (fingers and their contacts), `joints` and `pivots` are those of `Weigher.update`. `borne`: a link
        beside the fingertips touches the object, too.
        """
        reason = ""
        if not grasped:
            reason = "nothing is grasped"
            self.weigher.other_object = ""
        elif not lifted and observation.T_world_palm is not None:
            reason = "the palm has not risen since the grasp"
        elif finger_on_table:
            reason = "a finger is on the table"
        elif borne:
            reason = "a link beside the fingertips bears a part of it"
        if reason:
            self.weigher.forget(reason)
            self.weigher.listen(observation)
        else:
            self.weigher.update(observation, *touch, joints, pivots=pivots)

    @property
    def news(self) -> bool:
        """Whether the weight is other evidence of the pose than at the last correction."""
        found = self.weigher.believed
        used = self._used
        if found is used or self.model.center_of_mass is None:
            return False
        if found is None or used is None or found.directions != used.directions:
            return True
        return bool(np.abs(found.center_palm - used.center_palm).max() > 1e-3)  # [m]

    def evidence(self) -> WeightEvidence | None:
        """Returns the centre of mass as evidence of the pose; None without a declared centre or a trusted weighing."""
        found, center = self.weigher.believed, self.model.center_of_mass
        if found is None or center is None:
            return None
        own = self.model.sigma_center_of_mass**2 * np.eye(3)
        return WeightEvidence(center, found.center_palm, found.covariance_center + own)

    def used(self) -> Weighing | None:
        """Returns the trusted weighing, which a correction uses; `news` compares later ones with it."""
        self._used = self.weigher.believed
        return self._used

    def of(self, estimate: PoseEstimate | None) -> ObjectWeight | None:
        """Returns the weight of the object at an estimated pose; None where it was not weighed since the grasp."""
        found = self.weigher.weighing
        if found is None or estimate is None:
            return None
        T = estimate.T_palm_object
        R = T[:3, :3]
        center = T[:3, :3].T @ (found.center_palm - T[:3, 3])
        by_pose = GaussianPose(T, estimate.bounded_covariance).at_point(center).covariance[:3, :3]
        mass, in_palm = (found.mass, found.sigma_mass), (found.center_palm, found.covariance_center)
        covariance = R.T @ (in_palm[1] + by_pose) @ R
        reason = self.weigher.reason or self.elsewhere(estimate)
        known = *mass, center, covariance, *in_palm, found.directions
        return ObjectWeight(*known, reason, self.weigher.biased, self.weigher.assumed)

    @property
    def doubt(self) -> str:
        """Why the loads make any pose doubtful; empty where they do not.

        Gravity of the wrong sign makes the tips' own weight wrong too, and forces of the wrong sign each contact. An
        object of another mass may be another object, of another shape where no finger touches it.
        """
        if self.weigher.reason in (PULLED_UP, WRONG_SIGN):
            return self.weigher.reason
        return self.weigher.other_object

    def elsewhere(self, estimate: PoseEstimate) -> str:
        """Returns how far the weight's centre is from where the rest has it; empty where they do not differ."""
        found, declared = self.weigher.weighing, self.model.center_of_mass
        if estimate.weight_fits is not False or found is None or declared is None:
            return ""
        T = estimate.T_palm_object
        off = 1e3 * float(np.linalg.norm(T[:3, :3] @ declared + T[:3, 3] - found.center_palm))
        return f"contacts, vision and the table have the centre of mass {off:.0f} mm from where the weight has it"
