"""A scenario to what the robot measures and what is true, instant by instant."""

from collections.abc import Callable, Iterator

from handsight.simulation.scenario import STEPS_PER_SECOND, Sample, Scenario
from handsight.simulation.sensors import Sensors
from handsight.simulation.world import World


def simulate(scenario: Scenario, progress: Callable[[float], None] | None = None) -> Iterator[Sample]:
    """Samples at the scenario's rate, from the open hand on; the same scenario gives the same ones.

    The fingers close (1 s, the object held in place), the object is let go, and the palm holds still or moves: 1.9 s
    for a grasp, 18.4 s for a manipulation. `progress` is told the share that is done, 0 to 1. Raises MissingExtra
    without mujoco or gymnasium-robotics (`handsight[sim]`), or where images are asked for and nothing can draw them;
    InvalidFile or InvalidObject for a mesh that cannot be used.
    """
    world = World(scenario)
    sensors = Sensors(scenario, world)
    every, steps = round(STEPS_PER_SECOND / scenario.rate), round(world.duration * STEPS_PER_SECOND)
    try:
        for step in range(steps + 1):
            if step:
                world.step()
            if step % every == 0:
                world.refresh()
                yield _sample(world, sensors)
                if progress is not None:
                    progress(step / steps)
    finally:
        sensors.close()


def _sample(world: World, sensors: Sensors) -> Sample:
    return Sample(
        observation=sensors.observe(),
        T_palm_object=world.T_palm_object(),
        T_world_object=sensors.T_world_scene @ world.pose("object"),
        contacts_truth=world.tip_contacts(),
        phase=world.phase,
        dropped=world.dropped(),
        configuration=world.data.qpos.copy(),
    )
