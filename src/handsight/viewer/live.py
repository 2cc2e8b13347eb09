"""A tracker watched as it runs: `view(tracker)`, and a viewer that shows nothing with the same methods."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np

from handsight.checks import Array
from handsight.observation import Observation
from handsight.tracking import State, Tracker
from handsight.tracking.seen_camera import SeenCamera
from handsight.viewer.curves import Curves
from handsight.viewer.moment import Moment
from handsight.viewer.page import PORT, Page
from handsight.viewer.picture import picture

FRAME, CURVES_EVERY = 1 / 30, 0.25
"""Between two frames, and two plots [s]."""
NOTE_EVERY, MOST_NOTES = 0.1, 600
"""How often the past is taken note of [s], and how many notes are kept: a minute."""


def view(tracker: Tracker, *, port: int = PORT, say: Callable[[str], None] = print) -> "Viewer":
    """A page that shows a tracker at work to any browser of this machine; `Viewer.update` gives it what is new.

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
    """A viewer that shows nothing, at no cost: for a program that may be told to show nothing."""

    @property
    def address(self) -> str:
        """Nowhere."""
        return ""

    @property
    def watched(self) -> bool:
        """Never."""
        return False

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Shot(NamedTuple):
    """An image, and where the camera was by what was known then."""

    observation: Observation
    seen: SeenCamera
    T_world_palm: Array | None


class Viewer(NullViewer):
    """Shows the newest answer of a tracker, 30 times a second at most; while nobody looks nothing is done.

    It may be updated at any rate, and draws in a thread of its own.
    """

    def __init__(self, tracker: Tracker, *, port: int = PORT) -> None:
        """See `view`."""
        self._shown = tracker.rig, tracker.model
        self._page = Page(*self._shown, port=port, title=tracker.model.name)
        self._newest: Tracker | None = None
        self._moment: Moment | None = None
        """Of the newest, if anybody looked."""
        self._shot: Shot | None = None
        self._past = deque[tuple[float, float, State]](maxlen=MOST_NOTES)
        self._noted = -math.inf
        self._changed, self._closed = threading.Event(), False
        self._page.server.on_client_connect(lambda _: self._changed.set())
        self._thread = threading.Thread(target=self._run, name="handsight viewer", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return self._page.address

    @property
    def watched(self) -> bool:
        """Whether anybody looks."""
        return self._page.watched

    def update(self, observation: Observation, tracker: Tracker) -> None:
        """Shows what a tracker knows after an observation that it was just given.

        The observation's arrays must not be changed afterwards. It may be another tracker than before, of another
        object too: the page then begins anew.
        """
        if observation.stamp != tracker.stamp:
            return  # it came late: the tracker has not taken it
        self._newest, self._moment = tracker, None
        now = time.monotonic()
        if now - self._noted >= NOTE_EVERY:
            self._noted = now
            self._past.append((tracker.stamp, tracker.sigma, tracker.state))
        if observation.color is not None or observation.depth is not None:
            self._shot = Shot(observation, tracker.vision.seen_camera, tracker.T_world_palm)
        if self._page.watched:
            self._moment = Moment.now(tracker)
            self._changed.set()

    def close(self) -> None:
        """Ends the page."""
        self._closed = True
        self._changed.set()
        self._thread.join()
        self._page.close()

    def _run(self) -> None:
        """Draws what is newest, each time that it has changed and somebody looks."""
        plotted, made, last = -math.inf, None, None
        while True:
            self._changed.wait()
            self._changed.clear()
            if self._closed:
                return
            tracker, moment, shot = self._newest, self._moment, self._shot
            if tracker is None or not self._page.watched:
                continue
            began = time.monotonic()
            if self._shown != (tracker.rig, tracker.model):
                self._shown, last = (tracker.rig, tracker.model), None
                self._page.begin(*self._shown, tracker.model.name)
            image = picture(tracker.rig, *shot) if shot is not None and shot is not made else None
            made = shot
            last = (moment or Moment.now(tracker)).after(last, image)
            self._page.draw(last)
            if began - plotted >= CURVES_EVERY:
                plotted = began
                self._plot()
            time.sleep(max(0.0, FRAME - (time.monotonic() - began)))

    def _plot(self) -> None:
        """The last minute, of the newest track: a clock that was set back begins anew."""
        notes = list(self._past)
        stamps = np.array([note[0] for note in notes])
        begin = int(np.flatnonzero(np.diff(stamps, prepend=math.inf) < 0)[-1]) if len(stamps) else 0
        known, times = notes[begin:], stamps[begin:] - stamps[-1]
        sigmas = 1e3 * np.array([note[1] for note in known])
        sigmas[~np.isfinite(sigmas)] = np.nan
        self._page.draw_curves(Curves(times, sigmas, None, [note[2] for note in known]), 0.0)
