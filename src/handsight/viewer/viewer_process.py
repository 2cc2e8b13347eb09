"""The page of a tracker that runs, in a process of its own: what is drawn takes nothing of the tracker's time.

In the tracker's own process Python's lock would be the page's for a fifth of the time, for milliseconds each. So what a
tracker knows goes through a pipe, a frame each time that the page asks for one: 30 times a second at most, less where
the machine has other things to do, and never while nobody looks.
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
from handsight.viewer.curves import Curves
from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.picture import picture


class ViewerProcessOptions(NamedTuple):
    """`ViewerProcessOptions` say how often the viewer's process works."""

    frame: float = 1 / 30  # between two frames [s]
    poll_period: float = 0.2  # between two looks whether a page is open [s]
    niceness: int = 5  # a robot's own work goes first


VIEWER_PROCESS = ViewerProcessOptions()

BEGIN = """
import sys
from multiprocessing.connection import Connection
pipe = Connection({})
sys.path[:] = pipe.recv()
from handsight.viewer.viewer_process import main
main(pipe)
"""
"""What the process does; one of multiprocessing's would run the user's program again."""


class Shot(NamedTuple):
    """A `Shot` is an image, and where the camera was by what was known then."""

    observation: Observation
    from_palm: CameraFromPalm
    T_world_palm: Array | None


class Frame(NamedTuple):
    """A `Frame` is what there is to draw."""

    begins: tuple[Rig, ObjectModel] | None
    """The hand and the object; None: those of before."""
    moment: Moment
    shot: Shot | None
    """The newest; None: that of before, if any."""
    curves: Curves | None
    """None: not now."""


def begin() -> tuple[Connection, "subprocess.Popen[bytes] | None"]:
    """Returns the process in which `main` runs, and the way to it."""
    ours, theirs = Pipe()
    with theirs:
        handle = theirs.fileno()
        process = subprocess.Popen(
            [sys.executable, "-c", BEGIN.format(handle)], pass_fds=[handle], stdin=subprocess.DEVNULL
        )
    ours.send(sys.path)
    return ours, process


def main(pipe: "Connection[Any, Any]") -> None:
    """Serves until whoever began it is gone, however that was: Ctrl-C is for them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(VIEWER_PROCESS.niceness)
    serve(pipe)


def serve(pipe: "Connection[Any, Any]") -> None:
    """Takes a rig, an object and a port, says where the page is, and draws what it asks for."""
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
    """Asks with True; False says that nobody looks. What comes unasked, or is None, is the end."""
    last: Moment | None = None
    while True:
        if not page.watched:
            pipe.send(False)
            while not page.watched:
                if pipe.poll(VIEWER_PROCESS.poll_period):
                    return
        pipe.send(True)
        frame: Frame | None = pipe.recv()
        if frame is None:
            return
        began = time.monotonic()
        if frame.begins is not None:
            (rig, model), last = frame.begins, None
            page.begin(rig, model, model.name)
        last = frame.moment.after(last, None if frame.shot is None else picture(rig, *frame.shot))
        page.draw(last)
        if frame.curves is not None:
            page.draw_curves(frame.curves, 0.0)
        time.sleep(max(0.0, VIEWER_PROCESS.frame - (time.monotonic() - began)))
