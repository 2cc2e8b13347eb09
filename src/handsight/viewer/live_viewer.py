"""The page of a tracker that runs, by `view(tracker)`; and a viewer with the same methods that shows nothing.

The page is in a process of its own, so that drawing does not delay the tracker, in whose process it would hold Python's
lock for a fifth of the time, for milliseconds each. Estimates go through a pipe, one whenever the page asks for it: at
most 30 a second, fewer on a busy machine, and none while no browser is open.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Self

from handsight.errors import HandsightError
from handsight.objects import ObjectModel
from handsight.observation import Observation
from handsight.rig import Rig
from handsight.tracking import Tracker
from handsight.viewer.moment import Moment
from handsight.viewer.page import PAGE_PORT, Page
from handsight.viewer.picture import Shot, picture
from handsight.viewer.timeline import TIMELINE_FRAME, curves


class PageUpdate(NamedTuple):
    """One frame for the page to draw."""

    begins: tuple[Rig, ObjectModel] | None  # the rig and the object, if they have changed; else None
    moment: Moment
    shot: Shot | None  # the newest image, if there is a new one; else None


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
from handsight.viewer.live_viewer import main
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
    past = deque[Moment](maxlen=MINUTE)
    last: Moment | None = None
    drawn = 0
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
        moment = frame.moment
        if frame.begins is not None:
            rig, model = frame.begins
            last = None
            page.begin(rig, model, model.name)
        if last is None or moment.stamp < last.stamp:  # another object, or the clock was set back
            past.clear()
            page.origin = moment.stamp
        last = moment.after(last, None if frame.shot is None else picture(rig, frame.shot))
        past.append(moment)
        page.draw(last)
        if drawn % 8 == 0:
            page.draw_curves(curves(past, page.origin), moment.stamp - page.origin)
        drawn += 1
        time.sleep(max(0.0, TIMELINE_FRAME - (time.monotonic() - began)))


END_TIMEOUT = 5  # given to a page to end [s]
MINUTE = 1800  # frames of which the curves are plotted


def view(tracker: Tracker, *, port: int = PAGE_PORT, say: Callable[[str], None] = print) -> "Viewer":
    """Returns a page that shows a tracker at work in any browser of this machine; `Viewer.update` shows its newest
    estimate.

    ```
    tracker = hs.Tracker(rig, model)
    viewer = hs.view(tracker)
    for observation in robot:
        tracker.update(observation)
        viewer.update(observation, tracker)
    ```

    `say` is called with a sentence that has the page's address; if `port` is taken, the next free one is used. Raises
    MissingExtra without viser.
    """
    viewer = Viewer(tracker, port=port)
    say(f"handsight: look at {viewer.address}")
    return viewer


class NullViewer:
    """Has the methods of a `Viewer` and does nothing, for a program that is to show nothing."""

    address = ""  # address of the page for a browser; empty: there is no page
    watched = False  # whether a browser is open on the page

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Does nothing."""

    def close(self) -> None:
        """Does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Viewer(NullViewer):
    """Shows the newest estimate of a tracker, at most 30 times a second, and nothing while nobody watches.
    It may be updated at any rate, and draws in a process of its own."""

    def __init__(self, tracker: Tracker, *, port: int = PAGE_PORT) -> None:
        """See `view`."""
        self._pipe, self._process = begin()
        self._changed = threading.Event()
        self._sending = threading.Lock()
        self._shown = tracker.rig, tracker.model
        self._send((*self._shown, port))
        try:
            answer: str | HandsightError = self._pipe.recv()
        except (EOFError, OSError):
            answer = HandsightError("the viewer's process ended before it had a page")
        if isinstance(answer, HandsightError):
            self._end_process()
            raise answer
        self.address = answer
        self._closed = False
        self._tracker = tracker
        self._shots = deque[Shot](maxlen=1)  # the newest image that the page does not have
        self._thread = threading.Thread(target=self._run, name="handsight viewer", daemon=True)
        self._thread.start()

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Shows a tracker's estimate after an observation that it has just processed.

        The observation's arrays must not be changed afterwards. The tracker may be another one than before, of another
        object too: the page is then cleared.
        """
        if observation.stamp != tracker.stamp:
            return  # the observation came late, and the tracker has ignored it
        shot = Shot.now(tracker)
        if shot is not None:
            self._shots.append(shot)
        self._tracker = tracker
        self._changed.set()

    def close(self) -> None:
        """Ends the page."""
        self._closed = True
        self._changed.set()
        self._send(None)
        self._thread.join(END_TIMEOUT)
        self._end_process()

    def _end_process(self) -> None:
        """Waits until the page's process ends, and kills it if that takes too long."""
        if self._process is None:
            return
        try:
            self._process.wait(END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send(self, message: object) -> None:
        """Sends a message to the page, if it is still there."""
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(message)

    def _run(self) -> None:
        """Sends what the page does not show yet each time that it asks for a frame, until the page is gone."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                self.watched = self._pipe.recv()
                if not self.watched:
                    continue
                self._changed.wait()
                if self._closed:
                    continue
                self._changed.clear()
                tracker = self._tracker
                shown = self._shown
                self._shown = tracker.rig, tracker.model
                begins = None if self._shown == shown else self._shown
                shot = self._shots.pop() if self._shots else None
                self._send(PageUpdate(begins, Moment.now(tracker), shot))
        self.watched = False
