"""Whole commands on hands with each kind of sensor, while the object is held, lifted and weighed."""

from typing import get_args

import pytest

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

from handsight.cli.simulate import record, search
from handsight.simulation import Scenario
from handsight.simulation.scenario import SensorKind


@pytest.fixture(scope="session", params=get_args(SensorKind))
def weighed(request, tmp_path_factory):
    """A recording of a can that is lifted and tilted, with its rig beside it."""
    path = tmp_path_factory.mktemp("weighed") / f"{request.param}.mcap"
    scenario = Scenario(object="can", motion="weigh", rate=20, sensors=request.param)
    record(scenario, path, search(scenario).grasp, blind=False)
    return path


def test_what_every_kind_of_sensor_records_is_tracked_to_its_end(weighed, asked):
    _, said = asked("track", weighed)
    assert "poses of" in said


def test_what_every_kind_of_sensor_records_is_right_to_rig_check(weighed, asked):
    out, _ = asked("rig", "check", weighed.with_suffix(".rig.yaml"), weighed)
    assert f"{weighed.name} has everything that this rig listens to." in out
