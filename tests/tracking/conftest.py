"""Short grasps, simulated once for all tests of tracking and all workers."""

from importlib.util import find_spec

import pytest

if find_spec("gymnasium_robotics") is None:  # it is not imported: only its files are used
    pytest.skip("the simulated hand needs handsight[sim]", allow_module_level=True)

from handsight.simulation import Scenario, model_of, rig_of


class Grasp:
    """A scenario's samples, with the robot's rig and the object's model."""

    def __init__(self, scenario, samples):
        self.samples = samples
        self.rig, self.model = rig_of(scenario), model_of(scenario)
        self.observations = [sample.observation for sample in self.samples]
        self.held = [sample.observation for sample in self.samples if sample.phase == "hold"]
        self.T_palm_object = self.samples[-1].T_palm_object


@pytest.fixture(scope="session")
def can(simulated):
    scenario = Scenario(object="can", seed=11, motion="grasp", rate=50)
    return Grasp(scenario, simulated(scenario))


@pytest.fixture(scope="session")
def box(simulated):
    scenario = Scenario(object="box", seed=12, motion="grasp", rate=50)
    return Grasp(scenario, simulated(scenario))
