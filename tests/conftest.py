"""What every test shares, and what the workers of a run share: compiled kernels, distance fields, simulations."""

import contextlib
import os
import socket
import warnings
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import numpy as np
import pytest

import shared
from handsight import cache_folder

# Before anything compiles: kernels are kept from run to run, apart from the user's, by what they are made of; not in a
# checkout that others can write to.
with warnings.catch_warnings(action="ignore", category=cache_folder.CacheWarning):
    os.environ.setdefault(
        "NUMBA_CACHE_DIR", str(cache_folder.private_folder(Path(__file__).parents[1] / ".kernel_cache"))
    )
cache_folder._warn_once.cache_clear()


# The same examples every time, however busy the machine; other ones with --hypothesis-profile=explore.
hypothesis.settings.register_profile(
    "handsight", derandomize=True, deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.register_profile("explore", deadline=None)
hypothesis.settings.load_profile("handsight")


NEEDED = {"tracking": ("gymnasium_robotics",), "viewer": ("gymnasium_robotics", "mujoco", "rosbags")}
"""Packages without which a folder's tests are left out."""


def pytest_ignore_collect(collection_path):
    """Leaves out a folder whose packages are not installed; None leaves the others to pytest."""
    absent = [name for name in NEEDED.get(collection_path.name, ()) if find_spec(name) is None]
    if absent:
        warnings.warn(
            pytest.PytestWarning(f"{collection_path} is left out without {', '.join(absent)}"), stacklevel=1
        )
        return True
    return None


def pytest_sessionstart(session):
    """Workers compile different kernels at the same time, each of them once, and wait for each other's."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return  # a few tests need few kernels, and compile those
    from handsight._compiled.jit import FOLDER
    from handsight.tracking import warm

    count, k = int(worker["workercount"]), int(worker["workerid"].removeprefix("gw"))
    names = list(warm.GROUPS)
    for name in sorted(names, key=lambda name: (names.index(name) % count != k, names.index(name))):
        done = FOLDER / f"{name}.done"
        with shared.locked(done.with_suffix(".lock")):
            if not done.exists():
                warm.GROUPS[name]()
                done.touch()


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory):
    """A folder of this run that all its workers have."""
    mine = tmp_path_factory.getbasetemp()
    folder = (mine.parent if "PYTEST_XDIST_WORKER" in os.environ else mine) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(autouse=True, scope="session")
def fields_are_cached_apart(shared_folder):
    """Tests neither read nor fill the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDSIGHT_CACHE", str(shared_folder / "cache"))
        patch.setenv(shared.FOLDER, str(shared_folder))
        yield


@pytest.fixture(scope="session")
def made_once():
    """`made_once(key, make)`: what `make()` answers, made by one worker of a run."""
    return shared.made_once


@pytest.fixture(scope="session")
def simulated():
    """`simulated(scenario)`: all its samples, simulated once in a run."""
    return shared.simulated


@pytest.fixture
def rng():
    return np.random.default_rng(7)


# Commands


@pytest.fixture
def asked(monkeypatch, capsys, tmp_path):
    """`asked(*arguments)`: stdout and stderr of a command that runs in this process and ends as expected."""
    from cli.commands import called

    def ask(*arguments, cwd=tmp_path, expect=0, columns=100):
        assert called(monkeypatch, cwd, *arguments, columns=columns) == expect
        return capsys.readouterr()

    return ask


# Hands


@pytest.fixture(scope="session")
def shadow_hand():
    from hand.hands import shadow

    return shadow()


@pytest.fixture
def robot_file(tmp_path):
    from hand.hands import ROBOT

    path = tmp_path / "two_fingers.urdf"
    path.write_text(ROBOT)
    return path


@pytest.fixture
def robot(robot_file):
    pytest.importorskip("mujoco")
    from hand.hands import ROBOT_TIPS
    from handsight.hand import Hand

    return Hand.from_file(robot_file, palm="palm", tips=ROBOT_TIPS)


# Short grasps, simulated once for all tests and all workers


class Grasp:
    """A scenario's samples, with the robot's rig and the object's model."""

    def __init__(self, scenario, samples):
        from handsight.simulation import model_of, rig_of

        self.samples = samples
        self.rig, self.model = rig_of(scenario), model_of(scenario)
        self.observations = [sample.observation for sample in self.samples]
        self.held = [sample.observation for sample in self.samples if sample.phase == "hold"]
        self.T_palm_object = self.samples[-1].T_palm_object


@pytest.fixture(scope="session")
def grasped(simulated):
    """`grasped(**scenario)`: the Grasp of a scenario of the Shadow hand, which ends when the object is held."""
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    from handsight.simulation import Scenario

    def made(**fields):
        scenario = Scenario(motion="grasp", **fields)
        return Grasp(scenario, simulated(scenario))

    return made


@pytest.fixture(scope="session")
def grasp(grasped):
    """A short grasp of the can: its rig, and its samples."""
    can = grasped(rate=20)
    return can.rig, can.samples


@pytest.fixture(scope="session")
def can(grasped):
    return grasped(object="can", seed=11, rate=50)


@pytest.fixture(scope="session")
def box(grasped):
    return grasped(object="box", seed=12, rate=50)


# A second of a built-in recording, tracked, and a page to show it on


OBSERVATIONS = 120


@pytest.fixture(scope="session")
def tracked():
    """The can's rig, model, first observations, their moments and the truth."""
    import handsight
    from handsight.recording import open_recording
    from handsight.rig import Rig
    from handsight.tracking import Tally, Tracker
    from handsight.tracking.replay import replay
    from handsight.viewer.moment import Timeline

    data = Path(handsight.__file__).parent / "data"
    rig = Rig.from_file(data / "can.rig.yaml")
    model = rig.objects["can"].model()
    timeline = Timeline(rig, model)
    with open_recording(data / "can.mcap", rig) as recording:
        observations = list(islice(recording.observations(), OBSERVATIONS))
        timeline.truth = list(recording.truth)
    tracker = Tracker(rig, model)
    for _ in replay(observations, tracker, Tally()):
        timeline.add(tracker.track_state)
    return SimpleNamespace(rig=rig, model=model, observations=observations, timeline=timeline)


@pytest.fixture
def free_port():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        return held.getsockname()[1]


@pytest.fixture
def viser():
    """The package that serves the page; a test is skipped without it."""
    if find_spec("viser") is None:
        pytest.skip("the page needs handsight[view]: viser is not installed")


@pytest.fixture
def player(viser, tracked, free_port):
    """The page of the recording, paused."""
    from handsight.viewer.player import Player

    with contextlib.closing(Player(tracked.rig, tracked.model, port=free_port, title="can")) as made:
        made.timeline = tracked.timeline
        made.playing = False
        made.finish()
        yield made


@pytest.fixture
def watched(viser, monkeypatch):
    """Somebody looks at every page."""
    from handsight.viewer.player import Player

    monkeypatch.setattr(Player, "watched", True)
