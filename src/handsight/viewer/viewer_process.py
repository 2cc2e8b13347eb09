"""The page of a tracker that runs, in a process of its own, so that drawing does not delay the tracker.

In the tracker's own process the page would hold Python's lock for a fifth of the time, for milliseconds each. Instead,
estimates go through a pipe, one whenever the page asks for it: at most 30 a second, fewer on a busy machine, and none
while no browser is open.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

from handsight.checks import Array
from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking.camera_from_palm import CameraFromPalm
from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.picture import picture
from handsight.viewer.timeline import TIMELINE, Curves


class Shot(NamedTuple):
    """A `Shot` is an observation with images, and the camera's pose as estimated then."""

    observation: Observation
    from_palm: CameraFromPalm
    T_world_palm: Array | None


class PageUpdate(NamedTuple):
    """A `PageUpdate` is one frame for the page to draw."""

    begins: tuple[Rig, ObjectModel] | None  # the rig and the object, if they have changed; else None
    moment: Moment
    origin: float  # stamp from which the page counts time [s]
    shot: Shot | None  # the newest image, if there is a new one; else None
    curves: Curves | None  # the curves, if they have changed; else None


def begin() -> tuple[Connection, "subprocess.Popen[bytes] | None"]:
    """Starts the process in which `main` runs; returns the pipe to it, and the process."""
    ours, theirs = Pipe()
    with theirs:
        handle = theirs.fileno()
        # A process of multiprocessing would run the user's program again.
        code = f"""
import sys
from multiprocessing.connection import Connection
pipe = Connection({handle})
sys.path[:] = pipe.recv()
from handsight.viewer.viewer_process import main
main(pipe)
"""
        process = subprocess.Popen([sys.executable, "-c", code], pass_fds=[handle], stdin=subprocess.DEVNULL)
    ours.send(sys.path)
    return ours, process


def main(pipe: "Connection[Any, Any]") -> None:
    """Serves the page until the process at the other end of the pipe ends, to which Ctrl-C is left."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(5)  # a robot's own work goes first
    serve(pipe)


def serve(pipe: "Connection[Any, Any]") -> None:
    """Receives a rig, an object and a port, sends the page's address or a HandsightError, and draws frames."""
    with contextlib.suppress(EOFError, OSError):
        rig, model, port = pipe.recv()
        try:
            page = Page(rig, model, port=port, title=model.name)
        except HandsightError as error:
            pipe.send(error)
            return
        with contextlib.closing(page):
            pipe.send(page.address)
            _draw(page, rig, pipe)
    pipe.close()


def _draw(page: Page, rig: Rig, pipe: "Connection[Any, Any]") -> None:
    """Draws frames until one is None, or until a message arrives that was not asked for. It asks for each frame with
    True, and sends False when no browser is open."""
    last: Moment | None = None
    while True:
        if not page.watched:
            pipe.send(False)
            while not page.watched:
                if pipe.poll(0.2):
                    return
        pipe.send(True)
        frame: PageUpdate | None = pipe.recv()
        if frame is None:
            return
        began = time.monotonic()
        if frame.begins is not None:
            (rig, model), last = frame.begins, None
            page.begin(rig, model, model.name)
        last = frame.moment.after(last, None if frame.shot is None else picture(rig, *frame.shot))
        page.origin = frame.origin
        page.draw(last)
        if frame.curves is not None:
            page.draw_curves(frame.curves, last.stamp - frame.origin)
        time.sleep(max(0.0, TIMELINE.frame - (time.monotonic() - began)))
