"""What is simulated, what spoils it, and what comes out: the values of this room."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.observation import Observation
from handsight.rig.rig import DepthCamera

Profile = Literal["ramp", "steps", "sine"]
Motion = Literal["grasp", "manipulate", "weigh", Profile]
Phase = Literal["touch", "close", "hold", "move", "pull"]


class ScenarioLimits(NamedTuple):
    """`ScenarioLimits` are what a scenario may be."""

    torsion: float = 0.005
    """Torque about the normal that a tip holds, in parts of the force that it holds sideways [m]."""
    steps_per_second: int = 500  # of the simulator: two milliseconds are as accurate as one
    object_mass: float = 0.15  # as usual [kg]
    max_extent: float = 0.5  # of a mesh [m]; a larger one is not in metres, and in no hand
    max_nuisance: float = 100.0  # of any nuisance, in its unit; no robot is off by as much
    min_rate: float = 1e-3  # observations per second; a run lasts seconds


SCENARIO = ScenarioLimits()

MESHES = (".stl", ".obj", ".ply", ".off")


@dataclass(frozen=True, slots=True, kw_only=True)
class Nuisances:
    """`Nuisances` are all that a real robot's readings are wrong by; zero switches one off, `none` all of them.

    Each sigma is one standard deviation per axis. What is called constant is drawn once from the scenario's seed, and
    a setting changes the size of its own error only, never the draws of another.
    """

    joint_offset: float = float(np.deg2rad(1.0))
    """Constant, of each joint: sigma [rad]."""
    joint_noise: float = float(np.deg2rad(0.1))
    """From reading to reading: sigma [rad]."""
    force_noise: float = 0.01
    """Sigma [N]."""
    torque_noise: float = 5e-5
    """Sigma [N m]."""
    force_bias: float = 0.0
    """Constant: what calibration has left, sigma [N]."""
    torque_bias: float = 0.0
    """[N m]"""
    force_drift: float = 1e-4
    """A constant rate at which the bias grows from the first sample on: sigma [N/s]."""
    torque_drift: float = 5e-7
    """[N m/s]"""
    object_mass: float = SCENARIO.object_mass
    """Of the object, evenly in it [kg]; 0: as usual."""
    object_off_center: float = 0.0
    """Constant: how far its centre of mass is off the middle of its bounds, in a direction that is drawn, at most a
    third of the object's size each way [m]."""
    unsensed_force: float = 0.0
    """Constant, while the palm moves: what presses on the object, as a link without a sensor would, fixed in the palm,
    at a point and in a direction that are drawn [N]."""
    support_force: float = 0.0
    """Constant, while the palm moves: what a table, or another hand, bears of the object, upwards at a point of its
    underside that is drawn [N]."""
    tip_bias: float = 0.0
    """Constant: what one tip reads too much, of those that grip can and box, in a direction that is drawn [N]."""
    tip_compliance: float = 2e-5
    """How far a tip gives way to the force on it, which the joints do not tell [m/N]."""
    camera_position: float = 0.08
    """Constant: by how much the extrinsic calibration displaces the scene in the table's plane, on average [m]."""
    camera_height: float = 0.064
    """Constant: the same along the vertical, sigma [m]; 0 leaves the error in the plane."""
    camera_rotation: float = float(np.deg2rad(6.0))
    """Constant: by how much it turns the scene, about the scene's middle, sigma [rad]."""
    vision_position: float = 0.005
    """From one pose measurement to the next: sigma [m]."""
    vision_rotation: float = float(np.deg2rad(3.0))
    """[rad]"""
    vision_delay: float = 0.02
    """How much older a pose measurement, or an image, is than its stamp says [s]."""
    table_height: float = 0.003
    """Constant: how much higher the table is than the robot has it, sigma [m]."""
    table_tilt: float = float(np.deg2rad(1.0))
    """Constant: by how much it is tilted, about each of its sides, sigma [rad]."""
    depth_noise: float = 1.0
    """Noise, quantisation, dropout and lost edges of a Kinect's depth, in multiples of what is usual."""
    object_scale: float = 1.0
    """Size of the object the robot believes in, in parts of the true one."""
    skin_noise: float = 0.1
    """Of a taxel's reading, in parts of what it feels: sigma."""
    skin_offset: float = 0.02
    """Constant, of each taxel: what it reads untouched, sigma [N]."""
    skin_uneven: float = 5e-5
    """Constant, of each taxel: how far it is off the flat array, sigma [m]."""
    object_dent: float = 0.0
    """Depth of a dent that only the robot's model has [m]."""
    object_scan: float = 0.0
    """Above zero, the robot's model is a scanned cloud of 4 000 points with that noise: sigma [m]."""
    friction: float = 1.0
    """Of fingertips: how much they hold sideways in parts of what presses on them, and of torque in parts of what a
    patch of 5 mm holds."""
    pull_force: float = 9.0
    """How hard the object is pulled at the most [N], where the motion is a pull."""
    pull_torque: float = 0.0
    """And twisted [N m]."""

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = float(checks.finite(getattr(self, item.name), item.name, ()))
            if value < 0:
                raise InvalidInput(f"{item.name}: expected a number of at least 0, got {value:g}")
            if value > SCENARIO.max_nuisance:
                raise InvalidInput(f"{item.name}: expected at most {SCENARIO.max_nuisance:g}, got {value:g}")
        if not 0.5 <= self.object_scale <= 2:
            raise InvalidInput(f"object_scale: expected 0.5 to 2, got {self.object_scale:g}")
        if not 0.1 <= self.friction <= 2:
            raise InvalidInput(f"friction: expected 0.1 to 2, got {self.friction:g}")

    @classmethod
    def none(cls) -> "Nuisances":
        """Returns everything as it is."""
        off = {item.name: 0.0 for item in dataclasses.fields(cls)}
        return cls(**{**off, "object_scale": 1.0, "object_mass": SCENARIO.object_mass, "friction": 1.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A `Scenario` is one grasp or manipulation: what, which draw of it, how it is recorded."""

    object: str = "can"
    """`can` (large-diameter grasp), `box` (tripod grasp), or a mesh file in metres: its convex hull is what is
    simulated, as it rests in the file, or on a side where only that can be held, in a grasp that is searched."""
    seed: int = 0
    """Of everything that is drawn."""
    motion: Motion = "grasp"
    """`grasp`: close, let go of the object, hold for half a second; `manipulate`: then move it over the table, lift it,
    turn it; `weigh`: then lift it, tilt it by 20° about two axes, holding still between, and shake it; `ramp`, `steps`,
    `sine`: then lift it, hold still while something pulls it out of its place, as the nuisances say how hard, with a
    force that grows so, and tilt it."""
    rate: float = 100.0
    """Observations per second; 500 must be a multiple of it."""
    images: bool = False
    """Whether the camera's images come too, 30 a second."""
    skin: bool = False
    """Whether the palm has a tactile array; the can is then held against it, in a power grasp, its upper end on it."""
    depth_camera: DepthCamera = "structured_light"
    """How the camera measures depth, and so what is wrong with it."""
    nuisances: Nuisances = dataclasses.field(default_factory=Nuisances)

    def __post_init__(self) -> None:
        known = isinstance(self.object, str) and (
            self.object in ("can", "box") or Path(self.object).suffix.lower() in MESHES
        )
        if not known:
            raise InvalidInput(
                f"object: expected can, box or a mesh file ({', '.join(MESHES)}), got {self.object!r:.80}"
            )
        if isinstance(self.seed, bool) or not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise InvalidInput(f"seed: expected a whole number of at least 0, got {self.seed!r:.60}")
        if self.motion not in get_args(Motion):
            raise InvalidInput(f"motion: expected one of {', '.join(get_args(Motion))}, got {self.motion!r}")
        if self.depth_camera not in get_args(DepthCamera):
            kinds = ", ".join(get_args(DepthCamera))
            raise InvalidInput(f"depth_camera: expected one of {kinds}, got {self.depth_camera!r:.80}")
        if not isinstance(self.nuisances, Nuisances):
            raise InvalidInput(f"nuisances: expected Nuisances, got {type(self.nuisances).__name__}")
        for name in ("images", "skin"):
            if not isinstance(value := getattr(self, name), bool):
                raise InvalidInput(f"{name}: expected true or false, got {value!r:.60}")
        if self.skin and self.object == "box":
            raise InvalidInput(
                "skin: expected can or a mesh, got box, which the hand cannot press on its palm"
            )
        rate = checks.positive(self.rate, "rate")
        steps = SCENARIO.steps_per_second / rate
        if rate < SCENARIO.min_rate or steps < 1 or abs(steps - round(steps)) > 1e-9 * steps:
            raise InvalidInput(
                f"rate: expected a divisor of {SCENARIO.steps_per_second} per second, got {rate:g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class TipContact:
    """A `TipContact` is a contact of a fingertip as the simulator has it: truth to test with, nothing a robot knows."""

    finger: str
    point_palm: Array
    """(3,) on the tip's surface [m]."""
    force_palm: Array
    """(3,) of the other body on the tip [N]."""
    other: str
    """The geom that touches it: `object`, `table`, or one of the hand's."""
    normal_palm: Array
    """(3,) unit; the way the other body pushes the tip."""
    velocity_palm: Array
    """(6,) of the other body relative to the tip: of its point there [m/s], and of its turn [rad/s]."""

    @property
    def speed(self) -> float:
        """How fast the other body slips along the tip [m/s]; a turn about the normal is that of a point
        `SCENARIO.torsion` off."""
        along = self.velocity_palm[:3] - (self.velocity_palm[:3] @ self.normal_palm) * self.normal_palm
        return math.hypot(*along, SCENARIO.torsion * (self.velocity_palm[3:] @ self.normal_palm))


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A `Sample` is one instant: what the robot measured, and what is true."""

    observation: Observation
    T_palm_object: Array
    """(4, 4) true."""
    T_world_object: Array
    """(4, 4) true."""
    contacts_truth: tuple[TipContact, ...]
    """Of all fingertips, with whatever they touch."""
    phase: Phase
    """`touch`: a finger searches the object, which stands free; `close`: the fingers close and the object is held in
    place; `hold`: it is free and the palm is still; `move`; `pull`: the palm is still and the object is pulled."""
    dropped: bool
    """Whether the object has left the grasp: by more than 3 cm or half a radian in the palm since it became free."""
    configuration: Array
    """The simulator's generalized positions, for `render`."""

    @property
    def forces_object(self) -> Mapping[str, float]:
        """By finger: how hard the object pushes it [N]."""
        total: dict[str, Array] = {}
        for contact in self.contacts_truth:
            if contact.other == "object":
                total[contact.finger] = total.get(contact.finger, np.zeros(3)) + contact.force_palm
        return {finger: float(np.linalg.norm(force)) for finger, force in total.items()}

    @property
    def touches(self) -> Mapping[str, TipContact]:
        """By finger that touches the object: its contact with it, the hardest."""
        hardest: dict[str, TipContact] = {}
        for contact in self.contacts_truth:
            if contact.other == "object":
                kept = hardest.get(contact.finger, contact)
                harder = np.linalg.norm(contact.force_palm) >= np.linalg.norm(kept.force_palm)
                hardest[contact.finger] = contact if harder else kept
        return hardest
