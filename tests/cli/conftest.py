import pytest

from cli.commands import called


@pytest.fixture
def asked(monkeypatch, capsys, tmp_path):
    """`asked(*arguments)`: stdout and stderr of a command that runs in this process and ends as expected."""

    def ask(*arguments, cwd=tmp_path, expect=0, columns=100):
        assert called(monkeypatch, cwd, *arguments, columns=columns) == expect
        return capsys.readouterr()

    return ask


@pytest.fixture(scope="session")
def grasp(simulated):
    """A short grasp of the can: its rig, and its samples."""
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    from handsight.simulation import Scenario, rig_of

    scenario = Scenario(rate=20, motion="grasp")
    return rig_of(scenario), simulated(scenario)
