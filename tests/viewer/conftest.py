"""A second of a built-in recording, tracked, and a page to show it on."""

import contextlib
import socket
from importlib.util import find_spec
from itertools import islice
from multiprocessing import Pipe
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest

import handsight
from handsight.evaluation import Truths
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.tracking import Tally, Tracker
from handsight.viewer.timeline import Timeline, follow

for name, extra in (("mujoco", "robot"), ("rosbags", "robot"), ("gymnasium_robotics", "sim")):
    if find_spec(name) is None:
        pytest.skip(f"needs handsight[{extra}]: {name} is not installed", allow_module_level=True)

DATA = Path(handsight.__file__).parent / "data"
OBSERVATIONS = 120


def needs_viser():
    if find_spec("viser") is None:
        pytest.skip("the page needs handsight[view]: viser is not installed")


@pytest.fixture(scope="session")
def tracked():
    """The can's rig, model, first observations, their moments and the truth."""
    rig = Rig.from_file(DATA / "can.rig.yaml")
    model, timeline = rig.objects["can"].model(), Timeline()
    with open_recording(DATA / "can.mcap", rig) as recording:
        observations = list(islice(recording.observations(), OBSERVATIONS))
        truths = Truths(recording.truth)
    list(follow(observations, Tracker(rig, model), Tally(), timeline))
    return SimpleNamespace(rig=rig, model=model, observations=observations, timeline=timeline, truths=truths)


@pytest.fixture
def free_port():
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        return held.getsockname()[1]


@pytest.fixture
def page(tracked, free_port):
    needs_viser()
    from handsight.viewer.page import Page

    with contextlib.closing(Page(tracked.rig, tracked.model, port=free_port, title="can")) as made:
        yield made


@pytest.fixture
def pages(monkeypatch):
    """The pages of viewers, newest last: served in a thread of this process, where a test can look at them."""
    needs_viser()
    from handsight.viewer import live_viewer

    made = []

    def begin():
        ours, theirs = Pipe()
        Thread(target=live_viewer.serve, args=(theirs,), daemon=True).start()
        return ours, None

    class Kept(live_viewer.Page):
        def __init__(self, *given, **options):
            super().__init__(*given, **options)
            made.append(self)

    monkeypatch.setattr(live_viewer, "begin", begin)
    monkeypatch.setattr(live_viewer, "Page", Kept)
    return made


@pytest.fixture
def watched(monkeypatch):
    """Somebody looks at every page."""
    needs_viser()
    from handsight.viewer.page import Page

    monkeypatch.setattr(Page, "watched", True)
