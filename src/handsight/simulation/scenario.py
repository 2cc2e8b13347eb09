"""A scenario, the errors of its sensors, and the samples that its simulation yields."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidInput
from handsight.objects.library import Library
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.rig.rig import DepthCamera
from handsight.simulation.tables import tables

Profile = Literal["ramp", "steps", "sine", "creep", "jerks"]
Motion = Literal["grasp", "manipulate", "weigh", Profile]
SensorKind = Literal["wrench", "xela", "paxini", "inspire"]
Published = Literal["driven", "all"]
Phase = Literal["touch", "close", "hold", "move", "pull"]


MESHES = (".stl", ".obj", ".ply", ".off")
TORSION_ARM = 0.005
"""Largest torque about a tip's normal by the largest force along the surface [m]."""
STEPS_PER_SECOND = 500
"""Of the simulator: two milliseconds are as accurate as one."""
FINGERS = tuple(tables()["shadow_tips"])
"""Of the Shadow hand."""
OBJECT_MASS = 0.15
"""The mass of an object if a scenario does not give another [kg]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisances:
    """The errors of a real robot's readings; zero switches one off, `none` all of them.

    Each sigma is one standard deviation per axis. A constant error is drawn once from the scenario's seed, and a
    setting changes the size of its own error only, never the draws of another.
    """

    joint_offset: float = math.radians(1.0)
    """Sigma of a constant error of each joint [rad]."""
    joint_noise: float = math.radians(0.1)
    """Sigma of the noise of a joint's readings [rad]."""
    coupled_joint: float = math.radians(2.0)
    """Sigma of the constant error of each coupled joint, by how far it is off what its leader says [rad], of a slide on
    an arm of 5 cm; the Shadow hand has none."""
    force_noise: float = 0.01
    """Sigma of the noise of forces [N]."""
    torque_noise: float = 5e-5
    """Sigma of the noise of torques [N m]."""
    force_bias: float = 0.0
    """Sigma of the constant error of forces that remains after calibration [N]."""
    torque_bias: float = 0.0
    """Sigma of the constant error of torques that remains after calibration [N m]."""
    force_drift: float = 1e-4
    """Sigma of the constant rate at which the forces' bias grows from the first sample on [N/s]."""
    torque_drift: float = 5e-7
    """Sigma of the constant rate at which the torques' bias grows [N m/s]."""
    object_mass: float = OBJECT_MASS
    """Mass of the object, of uniform density [kg]; 0 means the default mass."""
    object_off_center: float = 0.0
    """Constant distance of its centre of mass from the middle of its bounds, in a random direction, at most a third of
    the object's size along each axis [m]."""
    unsensed_force: float = 0.0
    """Constant force on the object while the palm moves, such as that of a link without a sensor: fixed in the palm, at
    a random point and in a random direction [N]."""
    support_force: float = 0.0
    """Constant upward force on the object while the palm moves, such as that of a table or another hand, at a random
    point of its underside [N]."""
    tip_bias: float = 0.0
    """Constant error of the force measured by one fingertip, in a random direction [N]; the tip is one of those that
    grip both can and box."""
    tip_compliance: float = 2e-5
    """Compliance of a tip, whose deflection the joints do not measure [m/N]."""
    camera_position: float = 0.08
    """Mean length of the constant shift, in the table's plane, of all that the camera measures, by a wrong extrinsic
    calibration [m]."""
    camera_height: float = 0.064
    """Sigma of that shift along the vertical [m]; 0 leaves the error in the plane."""
    camera_rotation: float = math.radians(6.0)
    """Sigma of the constant rotation, about the scene's middle, of all that the camera measures [rad]."""
    vision_position: float = 0.005
    """Sigma of the noise of vision's poses [m]."""
    vision_rotation: float = math.radians(3.0)
    """Sigma of the noise of the rotations of vision's poses [rad]."""
    vision_delay: float = 0.02
    """How much older a pose measurement, or an image, is than its stamp says [s]."""
    table_height: float = 0.003
    """Sigma of the constant height of the true table above the table of the robot's rig [m]."""
    table_tilt: float = math.radians(1.0)
    """Sigma of the constant tilt of the table about each of its sides [rad]."""
    depth_noise: float = 1.0
    """Factor of the usual noise, quantisation, dropout and lost edges of a depth camera."""
    object_scale: float = 1.0
    """Size of the robot's model of the object, relative to the true one."""
    skin_noise: float = 0.1
    """Sigma of the noise of a taxel's reading, relative to its true force."""
    skin_offset: float = 0.02
    """Sigma of each taxel's constant reading without contact [N]."""
    skin_uneven: float = 5e-5
    """Sigma of each taxel's constant distance below the skin's surface [m]."""
    taxel_noise: float = 0.05
    """Sigma of the noise of a reading of tactile `sensors`, relative to the true force."""
    taxel_hysteresis: float = 0.05
    """By how much such a reading lags, as a share of the force: less while it grows, more while it falls."""
    taxel_dead: float = 1.0
    """Number of taxels of each such surface that always read the same; below 1 it is a share of them."""
    taxel_crosstalk: float = 0.03
    """Share of such a taxel's force that each of its neighbours reads in its place."""
    friction: float = 1.0
    """Coefficient of friction of the fingertips; torsional friction is proportional to it, with an arm of 5 mm."""
    pull_force: float = 9.0
    """Greatest force with which the object is pulled, in the motions of a `Profile` [N]."""
    pull_torque: float = 0.0
    """Greatest torque of that pull [N m]."""
    force_gain: float = 0.0
    """Sigma of the constant relative error of the gain of each axis of each force/torque sensor."""
    force_backlash: float = 0.0
    """Half the width of the hysteresis of each axis of force [N]: a reading stays until the true force is this far
    away, and follows it at this distance."""
    torque_backlash: float = 0.0
    """The same of each axis of torque [N m]."""
    vision_drift_position: float = 0.0
    """Sigma of the part of vision's error that wanders, by which all that the camera measures is shifted [m]: an
    Ornstein-Uhlenbeck process."""
    vision_drift_rotation: float = 0.0
    """Sigma of the same part of its rotation, about the scene's middle [rad]."""
    vision_drift_time: float = 10.0
    """Correlation time of that part [s]; over a much shorter time t it is a random walk of sigma · √(2 t / this)."""
    message_loss: float = 0.0
    """Probability that a message is lost: a joint state, and with it the observation; a finger's wrench; a pose of
    vision, or an image."""
    stamp_jitter: float = 0.0
    """How much later than the measurement an observation's stamp may be, drawn uniformly from 0 to this [s]. Stamps
    stay in order: at most nine tenths of the time to the next observation."""
    tip_size: float = 0.0
    """Sigma of the constant error of each true tip's radius, and of its length, against the rig's ellipsoid; at most
    twice this [m]."""
    contact_softness: float = 0.0
    """How much softer than usual the contacts of tips and object are: their time constant is (1 + this) · 10 ms."""
    pyramidal_friction: float = 0.0
    """1: friction is limited by a pyramid within the cone, weaker between its axes; 0: by the cone."""
    declared_mass: float = 0.0
    """Mass that the robot's model of the object declares, with a homogeneous centre, relative to the true mass; 0: it
    declares none."""

    def __post_init__(self) -> None:
        ranges = tables()["ranges"]
        for item in dataclasses.fields(self):
            value = float(checks.finite(getattr(self, item.name), item.name, ()))
            low, high = ranges.get(item.name, (0, 100))  # no robot's errors are larger, in their units
            if not low <= value <= high:
                raise InvalidInput(f"{item.name}: expected {low:g} to {high:g}, got {value:g}")
        if self.pyramidal_friction not in (0, 1):
            raise InvalidInput(f"pyramidal_friction: expected 0 or 1, got {self.pyramidal_friction:g}")

    @classmethod
    def none(cls) -> "Nuisances":
        """Returns nuisances of size zero: the robot's readings are exact."""
        kept = ("object_scale", "object_mass", "friction", "vision_drift_time")
        names = [item.name for item in dataclasses.fields(cls)]
        return cls(**{name: 0.0 for name in names if name not in kept})

    @classmethod
    def harsh(cls, seed: int) -> "Nuisances":
        """Returns nuisances of the sizes that a hard world of this seed has, each drawn from its range in the tables.

        Each size has its own random stream: a nuisance that is added, or left out, changes no other.
        """
        drawn = {}
        for name, (low, high) in tables()["harsh"].items():
            rng = np.random.default_rng((seed, 13, *name.encode()))
            if name == "pyramidal_friction":
                drawn[name] = float(rng.integers(2))
            elif name == "object_mass":
                drawn[name] = math.exp(rng.uniform(math.log(low), math.log(high)))
            else:
                drawn[name] = float(rng.uniform(low, high))
        return cls(**drawn)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One grasp or manipulation of an object, one draw of its errors, and how it is recorded."""

    object: str = "can"
    """`can` (large-diameter grasp), `box` (tripod grasp), a mesh file in metres, or a name in the library; the convex
    hull of these is simulated. Their grasp, and any grasp of a rig's own hand, is searched: the object rests as in the
    file, or on a side if it can be held only then."""
    seed: int = 0
    """Seed of all random numbers."""
    motion: Motion = "grasp"
    """`grasp`: the fingers close, the object is let go and held for half a second. Then, with `manipulate`: it is moved
    over the table, lifted and turned; with `weigh`: lifted, tilted by 20° about two axes, with pauses, and shaken; with
    `ramp`, `steps`, `sine`, `jerks` and `creep` (a ramp that follows slowly): lifted, pulled by a force of that profile
    while the hand is still, and tilted."""
    rate: float = 100.0
    """Observations per second; 500 must be a multiple of it."""
    images: bool = False
    """Whether the camera's images are simulated too, 30 a second."""
    skin: bool = False
    """Whether the palm has a tactile array; the can is then held in a power grasp with its upper end on the array."""
    sensors: SensorKind = "wrench"
    """What is in the fingertips, and in the palm with `skin`: force/torque sensors, or taxels as XELA's, PaXini's or
    Inspire's."""
    depth_camera: DepthCamera = "structured_light"
    """How the camera measures depth, which determines its errors."""
    nuisances: Nuisances = dataclasses.field(default_factory=Nuisances)
    rig: Rig | None = None
    """The rig of the hand, a force/torque sensor in each fingertip; None: the Shadow hand."""
    joints: Published = "driven"
    """Which joints' positions are measured: those with a motor, as coupled ones follow them, or `all`."""

    def __post_init__(self) -> None:
        if not _is_known(self.object):
            expected = f"can, box, a mesh file ({', '.join(MESHES)}) or an object of the library"
            raise InvalidInput(f"object: expected {expected}, got {self.object!r:.80}")
        checks.integer(self.seed, "seed", 2**63)
        choices = {
            "motion": get_args(Motion),
            "sensors": get_args(SensorKind),
            "depth_camera": get_args(DepthCamera),
            "joints": get_args(Published),
            "images": (True, False),
            "skin": (True, False),
        }
        for name, values in choices.items():
            value = getattr(self, name)
            if value not in values:
                raise InvalidInput(
                    f"{name}: expected one of {', '.join(map(str, values))}, got {value!r:.80}"
                )
        if not isinstance(self.nuisances, Nuisances):
            raise InvalidInput(f"nuisances: expected Nuisances, got {type(self.nuisances).__name__}")
        if self.skin and self.object == "box":
            raise InvalidInput(
                "skin: expected can or a mesh, got box, which the hand cannot press on its palm"
            )
        if self.rig is not None and (self.skin or self.sensors != "wrench"):
            raise InvalidInput("sensors: expected wrench, without skin, for a rig's own hand, got taxels")
        rate = checks.positive(self.rate, "rate")
        steps = STEPS_PER_SECOND / rate
        if rate < 1e-3 or steps < 1 or abs(steps - round(steps)) > 1e-9 * steps:
            raise InvalidInput(f"rate: expected a divisor of {STEPS_PER_SECOND} per second, got {rate:g}")

    @property
    def fingers(self) -> tuple[str, ...]:
        """Names of the hand's fingers."""
        return FINGERS if self.rig is None else tuple(self.rig.fingers)

    def stream(self, number: int) -> np.random.Generator:
        """Returns one of the random streams of the seed, which no other one changes."""
        return np.random.default_rng((int(self.seed), number))


def _is_known(name: object) -> bool:
    """Returns whether a scenario's object is built in, a mesh file, or in the library."""
    if not isinstance(name, str):
        return False
    if name in ("can", "box") or Path(name).suffix.lower() in MESHES:
        return True
    try:
        Library().entry(name)
    except HandsightError:
        return False
    return True


@dataclass(frozen=True, slots=True, eq=False)
class TipContact:
    """A contact of a fingertip in the simulator: ground truth for tests, unknown to the robot."""

    finger: str
    point_palm: Array  # (3,) on the tip's surface [m]
    force_palm: Array  # (3,) of the other body on the tip [N]
    other: str  # the geom that touches the tip: `object`, `table`, or one of the hand's
    normal_palm: Array  # (3,) unit; the direction in which the other body pushes the tip
    velocity_palm: Array
    """(6,) twist of the other body relative to the tip: velocity of its point there [m/s], angular velocity [rad/s]."""
    torque: float = 0.0  # of the other body on the tip, about the normal [N m]
    depth: float = 0.0  # by which both overlap, as MuJoCo's contacts are soft [m]

    @property
    def speed(self) -> float:
        """Speed at which the other body slips along the tip [m/s]; rotation about the normal counts with an arm of
        `TORSION_ARM`."""
        along = self.velocity_palm[:3] - (self.velocity_palm[:3] @ self.normal_palm) * self.normal_palm
        return math.hypot(*along, TORSION_ARM * (self.velocity_palm[3:] @ self.normal_palm))


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One instant: the robot's observation, and the truth."""

    observation: Observation
    T_palm_object: Array  # (4, 4) true
    T_world_object: Array  # (4, 4) true
    contacts_truth: tuple[TipContact, ...]  # all contacts of fingertips
    phase: Phase
    """`touch`: a finger searches for the object, which stands free; `close`: the fingers close and the object is held
    in place; `hold`: the object is free and the palm is still; `move`: the palm moves; `pull`: the palm is still and
    the object is pulled."""
    dropped: bool
    """Whether the object has left the grasp: by more than 3 cm or half a radian in the palm since it became free."""
    configuration: Array  # the simulator's generalized positions, for `render`

    @property
    def touches(self) -> Mapping[str, TipContact]:
        """Contact with the largest force between the object and each finger that it touches, by name."""
        found = [contact for contact in self.contacts_truth if contact.other == "object"]
        by_force = sorted(found, key=lambda contact: float(np.linalg.norm(contact.force_palm)))
        return {c.finger: c for c in (*found, *by_force)}
