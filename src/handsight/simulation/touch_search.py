"""The complete task without a camera: a search by touch, then a grasp at the estimated pose."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import InvalidInput, NotFound
from handsight.objects import ObjectModel
from handsight.observation import PoseMeasurement
from handsight.rig import MountedCamera, Rig, Table
from handsight.search import Area, Belief, best_sweep, open_text, with_symmetries_of_touch
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.motion import Grasp
from handsight.simulation.probe import PROBE, Probe
from handsight.simulation.robot import model_of, rig_of
from handsight.simulation.scenario import Sample, Scenario
from handsight.simulation.simulate import Sensors, samples
from handsight.simulation.world import World


class TouchSearchOptions(NamedTuple):
    """`TouchSearchOptions` configure the search for an object on a table by touch."""

    area_side: float = 0.3  # of the square that contains the object [m]
    max_touches: int = 12  # before the search gives up


TOUCH_SEARCH = TouchSearchOptions()

TABLE_PROBES = np.kron([[0.2], [0.32]], [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""(8, 2) places outside the searched square where the table is touched [m]. Some may be beside it: the table ends near
the object."""


def touch_search_rig(scenario: Scenario) -> Rig:
    """Returns the robot's rig for a search by touch; raises as `rig_of`.

    Its camera represents the search, whose pose is in the world and has no constant error.
    """
    search = MountedCamera(sigma_position_constant=0.0, sigma_rotation_constant=0.0)
    return replace(rig_of(scenario), camera=search)


def start_search(
    scenario: Scenario, model: ObjectModel, R_scene_object: Array | None = None, *, recording: bool = False
) -> tuple[Probe, Belief]:
    """Returns the hand above the table, whose height it has measured, and the belief before the first touch.

    The object is where the scenario's seed puts it, at rotation `R_scene_object` (3, 3), by default that of its file.
    With `recording` the hand keeps all its samples. Raises as `simulate`.
    """
    R = np.eye(3) if R_scene_object is None else R_scene_object
    seed, sides = int(scenario.seed), np.ptp(model.vertices @ R.T, axis=0)
    half = TOUCH_SEARCH.area_side / 2 - min(sides[:2]) / 2
    if not half > 0:
        size, most = " x ".join(f"{1000 * side:.0f}" for side in sides), 1000 * TOUCH_SEARCH.area_side
        raise InvalidInput(f"object: expected one within {most:.0f} mm, got {size} mm")
    x, y, turn = np.random.default_rng((seed, 11)).uniform([-half, -half, -np.pi], [half, half, np.pi])
    T_world_table = se3.compose(se3.rotation_exp(np.array([0.0, 0.0, turn])), np.array([x, y, 0.0]))
    probe = Probe(scenario, R, T_world_table, recording=recording)
    height, R_world_table = probe.measure_table(TABLE_PROBES)
    sigma_height, sigma_tilt = 0.0015, float(np.deg2rad(0.5))
    table = Table(height=height, sigma_height=sigma_height, sigma_tilt=sigma_tilt)
    area = Area(np.full(2, -half), np.full(2, half), table, R[None], R_world_table)
    return probe, Belief(with_symmetries_of_touch(model, PROBE.sigma), area, seed)


def simulate_touch_search(
    scenario: Scenario, grasp: Grasp | None = None, watch: Callable[[Belief, Array], None] | None = None
) -> Iterator[Sample]:
    """Yields samples of a search by touch, until the object is found, and then of the scenario's own motion.

    No sample has data of a camera. The first sample after the search carries the pose that was found, in the world and
    with its covariance, as vision's. The hand's way from there to the object is not simulated. `grasp` replaces the
    object's own, or the one that is searched. `watch` is called before the first touch and after each one, with the
    belief and the object's true pose T_world_object (4, 4). Raises as `simulate`, and NotFound where
    `TOUCH_SEARCH.max_touches` are too few.
    """
    grasp = grasp or grasp_for(scenario.object, int(scenario.seed))
    R_scene_object = grasp.R_world_palm @ grasp.T_palm_middle[:3, :3]
    probe, belief = start_search(scenario, model_of(scenario), R_scene_object, recording=True)
    while not belief.modes[0].is_certain:
        if watch is not None:
            watch(belief, probe.T_world_object)
        if len(belief.touches) == TOUCH_SEARCH.max_touches:
            raise NotFound(f"the object was not found by {len(belief.touches)} touches: {open_text(belief)}")
        belief = belief.after(probe.touch(best_sweep(belief, probe.heights, PROBE.radius)))
        yield from probe.recorded
        probe.recorded.clear()
    if watch is not None:
        watch(belief, probe.T_world_object)
    # The hand closes at the estimated pose, the object is at the true one.
    found, begins = belief.pose, probe.time + 0.5  # [s]; the hand's way to the object is not simulated
    T_object_middle = se3.compose(np.eye(3), belief.model.center_object)
    off = se3.inverse(found.T_a_b @ T_object_middle) @ probe.T_world_object @ T_object_middle
    T_palm_middle = grasp.T_palm_middle @ off
    # The scene has the object upright at its origin, and the hand on the side on which its table ends.
    R_scene_palm = R_scene_object @ T_palm_middle[:3, :3].T
    away = grasp.R_world_palm @ R_scene_palm.T
    turn = np.arctan2(away[1, 0] - away[0, 1], away[0, 0] + away[1, 1])
    R_scene_palm = se3.rotation_exp(np.array([0.0, 0.0, turn])) @ R_scene_palm
    world = World(scenario, replace(grasp, T_palm_middle=T_palm_middle, R_world_palm=R_scene_palm))
    sensors = Sensors(scenario, world)
    sensors.T_world_scene = probe.T_world_object @ se3.inverse(world.pose("object"))
    vision: PoseMeasurement | None = PoseMeasurement(found.T_a_b, "world", found.covariance)
    for (sample,) in samples(scenario, world, [sensors]):
        if sample is None:
            continue
        stamp = begins + sample.observation.stamp
        yield replace(sample, observation=replace(sample.observation, stamp=stamp, vision=vision))
        vision = None
