"""The object's mass, and the forces on it that no sensor of the hand measures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np

from handsight.checks import Array
from handsight.simulation.scenario import SCENARIO, Nuisances, Profile, Scenario
from handsight.simulation.scene import SimulatedScene, TipErrors, scene

if TYPE_CHECKING:
    from mujoco import MjData


class PullOptions(NamedTuple):
    """`PullOptions` describe a pull at the object, as by a person who lets go once it has slipped."""

    begin: float = 3.4  # when `motion.PULLED` has the object lifted and at rest [s]
    duration: float = 3.0  # of the pull [s]
    step: float = 0.5  # duration of a step of the force [s]
    rise: float = 0.05  # how long the force takes to rise to a step [s]
    frequency: float = 1.5  # of a sine [1/s]
    jerk: float = 0.06  # duration of a jerk; one begins with each step [s]
    creep: float = 0.1  # factor on the speed at which a creeping pull no longer follows the object
    min_speed: float = 0.03
    """Smallest draw of the speed along the tips at which the pull no longer follows the object [m/s]."""
    max_speed: float = 0.1  # largest draw of that speed [m/s]
    flying_speed: float = 0.3  # speed of the object, in any direction, that also ends the pull [m/s]
    min_travel: float = 0.005  # smallest draw of how far the object slips before it is let go [m]
    max_travel: float = 0.02  # largest draw of that distance [m]
    normal_share: float = 0.03
    """Variance of the pull's direction across all tips, relative to that along all of them: it pulls along the surfaces
    of the tips, not off them."""


PULL = PullOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A `Payload` is the scene with the scenario's mass and centre of mass, and the constant loads on its object."""

    scene: SimulatedScene
    force_palm: Array  # (3,) on the object, which no sensor measures [N]
    point_object: Array  # (3,) where that force acts [m]
    support: float  # upward force in the world by which something else bears the object [N]
    base_object: Array  # (3,) where the support acts [m]

    @classmethod
    def of(cls, scenario: Scenario) -> "Payload":
        """Returns the payload drawn by the scenario's seed; raises as `scene` does."""
        n, rng = scenario.nuisances, np.random.default_rng((int(scenario.seed), 10))
        off, force = rng.normal(size=3), rng.normal(size=3)
        errors = tip_errors(n, int(scenario.seed), scenario.fingers)
        touch: dict[str, Any] = {"friction": float(n.friction), "pyramidal": bool(n.pyramidal_friction)}
        touch |= {"softness": float(n.contact_softness), "tip_errors": errors, "rig": scenario.rig}
        usual = scene(scenario.object, **touch)
        low, high = usual.bounds_object
        point = (low + high) / 2 + rng.uniform(-0.5, 0.5, 3) * (high - low)
        force *= n.unsensed_force / np.linalg.norm(force)
        # The underside is the lower end of the object's z axis, which is vertical when it is grasped.
        base = np.array([*((low + high) / 2 + rng.uniform(-0.5, 0.5, 3) * (high - low))[:2], low[2]])
        mass = n.object_mass or SCENARIO.object_mass
        if mass != SCENARIO.object_mass or n.object_off_center:
            most = (high - low) / 3
            shift = np.clip(n.object_off_center * off / np.linalg.norm(off), -most, most)
            usual = scene(scenario.object, mass, tuple(shift.tolist()), **touch)
        return cls(usual, force, point, n.support_force, base)

    def press(self, data: "MjData") -> None:
        """Applies the unsensed force and the support to the object for the next step."""
        if not self.force_palm.any() and not self.support:
            return
        palm, body = data.body(self.scene.hand.palm), data.body("object")
        R = body.xmat.reshape(3, 3)
        forces = palm.xmat.reshape(3, 3) @ self.force_palm, np.array([0.0, 0.0, self.support])
        levers = (R @ point + body.xpos - body.xipos for point in (self.point_object, self.base_object))
        torque = sum(np.cross(lever, force) for lever, force in zip(levers, forces, strict=True))
        body.xfrc_applied[:3], body.xfrc_applied[3:] = sum(forces), torque


def tip_errors(nuisances: Nuisances, seed: int, fingers: Sequence[str]) -> TipErrors:
    """Returns by how much each finger's true radius and length differ from the rig's [m]."""
    draws = np.clip(np.random.default_rng((seed, 14)).normal(size=(len(fingers), 2)), -2, 2)
    return tuple((float(wider), float(longer)) for wider, longer in nuisances.tip_size * draws)


class Pull:
    """A `Pull` draws the direction, speed and distance of one pull; `wrench` gives its load on the object over time."""

    def __init__(self, scenario: Scenario, normals_palm: Array) -> None:
        """Draws by the scenario's seed; `normals_palm` (n, 3) are those of the tips' contacts with the object."""
        rng = np.random.default_rng((int(scenario.seed), 11))
        direction, axis = rng.normal(size=(2, 3))
        across = normals_palm.T @ normals_palm / max(len(normals_palm), 1)
        direction = np.linalg.solve(np.linalg.cholesky(across + PULL.normal_share * np.eye(3)).T, direction)
        self._force = scenario.nuisances.pull_force * direction / np.linalg.norm(direction)
        self._torque = scenario.nuisances.pull_torque * axis / np.linalg.norm(axis)
        self._max_speed = rng.uniform(PULL.min_speed, PULL.max_speed)
        self._max_speed *= PULL.creep if scenario.motion == "creep" else 1.0
        self._max_travel = rng.uniform(PULL.min_travel, PULL.max_travel)
        self._profile, self._slipped = scenario.motion, 0.0

    def wrench(self, time: float, slip_speed: float, speed: float) -> Array:
        """Returns force [N] and torque [N m], (6,) along the palm's axes, for the simulator's next step. `slip_speed`
        is how fast the object slips along the tips, `speed` how fast it moves at all [m/s]."""
        since = time - PULL.begin
        self._slipped += slip_speed / SCENARIO.steps_per_second
        if not 0 <= since <= PULL.duration or self._slipped > self._max_travel:
            return np.zeros(6)
        # The pull fades as the object gets away from it.
        share = max(0.0, 1 - max(slip_speed / self._max_speed, speed / PULL.flying_speed) ** 4)
        return share * pull_share(self._profile, since) * np.concatenate([self._force, self._torque])


def pull_share(profile: str, since: float) -> float:
    """Returns the strength of a pull as a share of its greatest force, at a time after its beginning [s]."""
    share = since / PULL.duration
    steps, within = divmod(since, PULL.step)
    if profile in ("ramp", "creep"):
        return share
    if profile == "steps":
        return min(1.0, (steps + min(within / PULL.rise, 1.0)) * PULL.step / PULL.duration)
    if profile == "jerks":
        height = min(1.0, (steps + 1) * PULL.step / PULL.duration)
        return height * math.sin(math.pi * within / PULL.jerk) ** 2 if within < PULL.jerk else 0.0
    return share * (1 - math.cos(2 * math.pi * PULL.frequency * since)) / 2


def pulls(motion: str) -> bool:
    """Returns whether the object is pulled in that motion."""
    return motion in get_args(Profile)
