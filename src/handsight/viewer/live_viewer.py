"""A tracker watched as it runs: `view(tracker)`, and a viewer that shows nothing with the same methods."""

import contextlib
import math
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np

from handsight.errors import HandsightError
from handsight.forces import Slip
from handsight.observation import Observation
from handsight.tracking import State, Tracker
from handsight.viewer import viewer_process
from handsight.viewer.curves import Curves, slips_of
from handsight.viewer.moment import Moment
from handsight.viewer.page import PAGE


class LiveViewerOptions(NamedTuple):
    """`LiveViewerOptions` say how often a live view is drawn."""

    curve_period: float = 0.25  # between two plots [s]
    idle_pause: float = 0.1  # how long a tracker is given nothing while it rests [s]
    end_timeout: float = 5.0  # with a page that is to end [s]
    note_period: float = 0.1  # between notes of the past [s]
    max_notes: int = 600  # notes that are kept: a minute


LIVE_VIEWER = LiveViewerOptions()


def view(tracker: Tracker, *, port: int = PAGE.port, say: Callable[[str], None] = print) -> "Viewer":
    """Returns a page that shows a tracker at work to any browser of this machine; `Viewer.update` gives it what is new.

    ```
    tracker = hs.Tracker(rig, model)
    viewer = hs.view(tracker)
    for observation in robot:
        tracker.update(observation)
        viewer.update(observation, tracker)
    ```

    `say` is told its address; where `port` is taken, the next free one is. Raises MissingExtra without viser.
    """
    viewer = Viewer(tracker, port=port)
    say(f"handsight: look at {viewer.address}")
    return viewer


class NullViewer:
    """A `NullViewer` is a viewer that shows nothing, at no cost: for a program that may be told to show nothing."""

    @property
    def address(self) -> str:
        """Nowhere."""
        return ""

    @property
    def watched(self) -> bool:
        """Never."""
        return False

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Does nothing."""

    def close(self) -> None:
        """Does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Viewer(NullViewer):
    """Shows the newest answer of a tracker, 30 times a second at most; while nobody looks nothing is done.

    It may be updated at any rate, and draws in a process of its own.
    """

    def __init__(self, tracker: Tracker, *, port: int = PAGE.port) -> None:
        """See `view`."""
        self._pipe, self._process = viewer_process.begin()
        self._changed, self._sending = threading.Event(), threading.Lock()
        self._shown = tracker.rig, tracker.model
        self._address = self._started(port)
        self._watched = self._closed = False
        self._newest: tuple[Tracker, Moment | None] | None = None
        """What is to be shown; its moment, if somebody looks."""
        self._shot: viewer_process.Shot | None = None
        self._sent: tuple[object, object] = None, None
        """The newest and the shot that the page has."""
        self._past = deque[tuple[float, float, State, Slip]](maxlen=LIVE_VIEWER.max_notes)
        self._noted = self._plotted = -math.inf
        self._thread = threading.Thread(target=self._run, name="handsight viewer", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return self._address

    @property
    def watched(self) -> bool:
        """Whether anybody looks."""
        return self._watched

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Shows what a tracker knows after an observation that it was just given.

        The observation's arrays must not be changed afterwards. It may be another tracker than before, of another
        object too: the page then begins anew.
        """
        if observation.stamp != tracker.stamp:
            return  # it came late: the tracker has not taken it
        now = time.monotonic()
        if now - self._noted >= LIVE_VIEWER.note_period:
            self._noted = now
            self._past.append((tracker.stamp, tracker.sigma, tracker.state, tracker.slip))
        if observation.color is not None or observation.depth is not None:
            self._shot = viewer_process.Shot(
                observation, tracker.vision.camera_from_palm, tracker.T_world_palm
            )
        self._newest = tracker, Moment.now(tracker) if self._watched else None
        if self._watched:
            self._changed.set()

    def close(self) -> None:
        """Ends the page."""
        self._closed = True
        self._changed.set()
        self._send(None)
        self._thread.join(LIVE_VIEWER.end_timeout)
        _end(self._process)

    def _started(self, port: int) -> str:
        """Returns the page's address; raises what it was refused for."""
        self._send((*self._shown, port))
        try:
            found: str | HandsightError = self._pipe.recv()
        except (EOFError, OSError):
            found = HandsightError("the viewer's process ended before it had a page")
        if isinstance(found, HandsightError):
            _end(self._process)
            raise found
        return found

    def _send(self, message: object) -> None:
        """Sends to the page; where it is gone nothing is."""
        with self._sending, contextlib.suppress(OSError):
            self._pipe.send(message)

    def _run(self) -> None:
        """Sends a frame each time that the page asks for one, until it is gone."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                self._watched = self._pipe.recv()
                frame = self._next() if self._watched else None
                if frame is not None:
                    self._send(frame)
        self._watched = False

    def _next(self) -> viewer_process.Frame | None:
        """Returns what the page does not have, once there is something; None: it is the end."""
        while not self._closed:
            self._changed.wait(LIVE_VIEWER.idle_pause)
            self._changed.clear()
            newest, shot = self._newest, self._shot
            if newest is None or newest is self._sent[0]:
                continue
            (tracker, moment), shown = newest, self._shown
            self._shown = tracker.rig, tracker.model
            frame = viewer_process.Frame(
                begins=None if self._shown == shown else self._shown,
                # That of a robot that rests was not made: nobody looked.
                moment=moment or Moment.now(tracker),
                shot=None if shot is self._sent[1] else shot,
                curves=self._curves(),
            )
            self._sent = newest, shot
            return frame
        return None

    def _curves(self) -> Curves | None:
        """Returns the last minute, of the newest track: a clock that was set back begins anew. None: it was just
        plotted."""
        now = time.monotonic()
        if now - self._plotted < LIVE_VIEWER.curve_period:
            return None
        self._plotted = now
        notes = list(self._past)
        stamps = np.array([note[0] for note in notes])
        begin = int(np.flatnonzero(np.diff(stamps, prepend=math.inf) < 0)[-1]) if len(stamps) else 0
        known, times = notes[begin:], stamps[begin:] - stamps[-1]
        sigmas = 1e3 * np.array([note[1] for note in known])
        sigmas[~np.isfinite(sigmas)] = np.nan
        slips = [
            (first - stamps[-1], last - stamps[-1]) for first, last in slips_of(note[::3] for note in known)
        ]
        return Curves(times, sigmas, None, [note[2] for note in known], slips)


def _end(process: "subprocess.Popen[bytes] | None") -> None:
    """Has a process end, if there is one."""
    if process is None:
        return
    try:
        process.wait(LIVE_VIEWER.end_timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
