"""What the page costs: CPU of a frame while a browser is open, and of the tracker's process that feeds it.

Synthetic: the built-in recording of a can, and a grasp with colour and depth of 640 x 480 pixels. Frames are drawn one
after the other, 30 a second, for a reader in another process that receives all that is sent; the CPU is that of the
complete process: computing, packing and sending. Tracking is not included; images are reduced while tracking.
"""

import argparse
import contextlib
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import psutil

import handsight as hs
from handsight.evaluation import Truths
from handsight.observation import Observation
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.simulation import Scenario
from handsight.tracking import Tally
from handsight.viewer import Viewer
from handsight.viewer.live_viewer import PageUpdate
from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.player import PLAYER
from handsight.viewer.timeline import TIMELINE, Timeline, curves, follow
from testbed import report
from testbed.recordings import record

READER = """
import sys
from importlib.metadata import version
from websockets.sync.client import connect
with connect(sys.argv[1], subprotocols=["viser-v" + version("viser")], max_size=None) as socket:
    print("reads", flush=True)
    while socket.recv():
        pass
"""
OBSERVATIONS = 600
DATA = Path(hs.__file__).parent / "data"
"""The built-in recordings."""


@dataclass
class Tracked:
    """A `Tracked` is a recording and its moments."""

    rig: Rig
    model: hs.ObjectModel
    observations: list[Observation]
    timeline: Timeline
    truths: Truths


def tracked(path: Path) -> Tracked:
    """Tracks the first seconds of a recording."""
    rig = Rig.from_file(path.with_name(f"{path.stem}.rig.yaml"))
    model, timeline = rig.objects["can"].model(), Timeline()
    with open_recording(path, rig) as recording:
        observations = list(islice(recording.observations(), OBSERVATIONS))
        truths = Truths(recording.truth)
    for _ in follow(observations, hs.Tracker(rig, model), Tally(), timeline):
        pass
    return Tracked(rig, model, observations, timeline, truths)


@contextlib.contextmanager
def read(page: Page) -> Iterator[None]:
    """Reads all that the page sends, as a browser would."""
    address = page.address.replace("http", "ws")
    with subprocess.Popen([sys.executable, "-c", READER, address], stdout=subprocess.PIPE) as reader:
        assert reader.stdout is not None
        reader.stdout.readline()
        time.sleep(1)
        yield
        reader.kill()


def frames(name: str, seen: Tracked) -> list[str]:
    """Returns a row: CPU time of a frame."""
    with contextlib.closing(Page(seen.rig, seen.model)) as page, read(page):
        shown = curves(seen.timeline.moments, seen.model, seen.truths)
        page.draw(seen.timeline.moments[0])  # what is done once is no frame's
        time.sleep(1)
        began, plotted = time.process_time(), 0.0
        for moment in seen.timeline.moments[1:]:
            begin = time.monotonic()
            page.draw(moment)
            if begin - plotted > PLAYER.plot_period:
                plotted = begin
                page.draw_curves(shown, moment.stamp)
            time.sleep(max(0.0, TIMELINE.frame - (time.monotonic() - begin)))
        count = len(seen.timeline.moments) - 1
        return [name, str(count), f"{1e3 * (time.process_time() - began) / count:.1f}"]


def updates(seen: Tracked, count: int) -> list[str]:
    """Returns a row: CPU time of the tracker's process for its viewer, and of the page's while nobody watches."""
    tracker = hs.Tracker(seen.rig, seen.model)
    for observation in seen.observations:
        tracker.update(observation)
    with Viewer(tracker) as viewer:
        began = time.process_time()
        for _ in range(count):
            viewer.update(observation, tracker)
        unwatched = 1e6 * (time.process_time() - began) / count
        page = psutil.Process(viewer._process.pid)  # of the page alone
        before = sum(page.cpu_times()[:2])
        time.sleep(5)
        idle = 20 * (sum(page.cpu_times()[:2]) - before)
    began = time.process_time()
    for _ in range(count):
        moment = Moment.now(tracker)
    watched = 1e6 * (time.process_time() - began) / count
    began = time.process_time()
    for _ in range(count // 10):
        pickle.dumps(PageUpdate(None, moment, 0.0, None, None))
    sent = 1e7 * (time.process_time() - began) / count
    return [f"{unwatched:.1f}", f"{unwatched + watched:.1f}", f"{sent:.0f}", f"{idle:.2f}"]


def main() -> None:
    """Prints the tables."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--no-images", action="store_true", help="without the grasp that has images")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = {"no images": tracked(DATA / "can.mcap")}
        if not given.no_images:
            path = Path(folder) / "can.mcap"
            record(Scenario(object="can", seed=1, motion="grasp", images=True), path)
            found["with RGB-D"] = tracked(path)
    rows = [frames(name, seen) for name, seen in found.items()]
    columns = ["", "frames", "CPU ms a frame"]
    report.print_table("A page that is looked at, 30 frames a second", columns, rows, report.machine())
    rows = [updates(found["no images"], 20_000)]
    columns = ["µs an update", "looked at", "µs a frame", "page unwatched, % of a core"]
    report.print_table("What a viewer takes of its tracker's process", columns, rows, report.machine())


if __name__ == "__main__":
    main()
