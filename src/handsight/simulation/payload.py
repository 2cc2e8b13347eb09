"""What an object weighs, where its centre of mass is, and what else presses on it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from handsight.checks import Array
from handsight.simulation.scenario import SCENARIO, Scenario
from handsight.simulation.scene import PALM, Scene, scene

if TYPE_CHECKING:
    from mujoco import MjData


OUTERMOST = 1 / 3
"""Of the object's size each way: so far off its middle a centre of mass may be."""


@dataclass(frozen=True, slots=True, eq=False)
class Payload:
    """A `Payload` is a scene whose object weighs what a scenario says."""

    scene: Scene
    force_palm: Array
    """(3,) on the object, by what no sensor feels [N]."""
    point_object: Array
    """(3,) where [m]."""
    support: float
    """Upwards in the world, by what else bears the object [N]."""
    base_object: Array
    """(3,) where [m]."""

    @classmethod
    def of(cls, scenario: Scenario) -> "Payload":
        """Draws by the scenario's seed; raises as `scene` does."""
        n, rng = scenario.nuisances, np.random.default_rng((int(scenario.seed), 10))
        friction = float(n.friction)
        usual, off, force = scene(scenario.object, friction=friction), rng.normal(size=3), rng.normal(size=3)
        low, high = usual.bounds_object
        point = (low + high) / 2 + rng.uniform(-0.5, 0.5, 3) * (high - low)
        force *= n.unsensed_force / np.linalg.norm(force)
        # Underneath as it stands when it is grasped: the lowest of its own axes.
        base = np.array([*((low + high) / 2 + rng.uniform(-0.5, 0.5, 3) * (high - low))[:2], low[2]])
        presses = force, point, n.support_force, base
        mass = n.object_mass or SCENARIO.object_mass
        if mass == SCENARIO.object_mass and not n.object_off_center:
            return cls(usual, *presses)
        most = OUTERMOST * (high - low)
        shift = np.clip(n.object_off_center * off / np.linalg.norm(off), -most, most)
        weighing = scene(scenario.object, mass, tuple(shift.tolist()), friction=friction)
        return cls(weighing, *presses)

    def press(self, data: "MjData") -> None:
        """Lets what no sensor feels press on the object, from now to the next step."""
        if not self.force_palm.any() and not self.support:
            return
        palm, body = data.body(PALM), data.body("object")
        R = body.xmat.reshape(3, 3)
        forces = palm.xmat.reshape(3, 3) @ self.force_palm, np.array([0.0, 0.0, self.support])
        levers = (R @ point + body.xpos - body.xipos for point in (self.point_object, self.base_object))
        body_torque = sum(np.cross(lever, force) for lever, force in zip(levers, forces, strict=True))
        body.xfrc_applied[:3], body.xfrc_applied[3:] = sum(forces), body_torque


def center_of_mass(scene: Scene) -> Array:
    """Returns (3,) of the object, in its frame [m]."""
    return np.asarray(scene.model.body("object").ipos).copy()
