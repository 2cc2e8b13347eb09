import pytest


@pytest.fixture(scope="session")
def grasp():
    """A short grasp of the can: its rig, and its samples."""
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    from handsight.simulation import Scenario, rig_of, simulate

    scenario = Scenario(rate=20, motion="grasp")
    return rig_of(scenario), list(simulate(scenario))
