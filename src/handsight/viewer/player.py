"""A recording's moments played, paused, sought and shown at another speed."""

import bisect
import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from handsight.viewer.curves import Curves
from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.panel import CONTROLS

if TYPE_CHECKING:
    from viser import GuiApi, GuiEvent, GuiSliderHandle


class PlayerOptions(NamedTuple):
    """`PlayerOptions` say how a recording is played."""

    frame: float = 1 / 30  # between two moments that are kept or drawn [s]
    plot_period: float = 0.2  # between two plots [s]
    poll_period: float = 1.0  # between two looks at a timeline that grows [s]
    time_tolerance: float = 1e-3  # stamps nearer to each other are the same [s]
    min_hold: float = 0.6  # how long after a person moves the slider playing does not move it [s]


PLAYER = PlayerOptions()

SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")


class Timeline:
    """A `Timeline` is moments in order of stamp; another thread may read while one appends."""

    def __init__(self) -> None:
        self.moments = list[Moment]()
        self._stamps = list[float]()

    def append(self, moment: Moment) -> bool:
        """Keeps a moment, if there is none just before it, whether there is one; one that goes back is left out."""
        last = self._stamps[-1] if self._stamps else -math.inf
        # What a person can see, and with it bounded memory.
        if moment.stamp - last < PLAYER.frame - PLAYER.time_tolerance:
            return False
        self.moments.append(moment)
        self._stamps.append(moment.stamp)
        return True

    @property
    def begin(self) -> float:
        """Stamp of the first [s]."""
        return self._stamps[0]

    @property
    def length(self) -> float:
        """From the first to the last [s]; 0 of none."""
        return self._stamps[-1] - self._stamps[0] if self._stamps else 0.0

    def at(self, time: float) -> Moment:
        """Returns the last one that is not later than a time since the first [s]; else the first."""
        # The sum of a difference may be below the stamp it was made of: seconds since 1970 have a quarter of a µs.
        return self.moments[
            max(0, bisect.bisect_right(self._stamps, self.begin + time + PLAYER.time_tolerance) - 1)
        ]


class Player:
    """Shows the moments of a timeline that may still grow, while somebody looks."""

    def __init__(self, page: Page, timeline: Timeline, curves: Callable[[], Curves]) -> None:
        """`curves`: what is plotted of the timeline so far."""
        self._page, self._timeline, self._curves = page, timeline, curves
        self.time, self.speed, self.playing = 0.0, 1.0, True
        """Since the first moment [s], and seconds of the recording in one."""
        self._growing = True
        self._drawn: Moment | None = None
        self._plot: Curves | None = None
        self._moved = self._plotted = self._curves_at = -math.inf
        """When a person moved the slider, and when there was a plot and a look at the timeline's curves last; infinite:
        they change no more."""
        self._wake, self._closed = threading.Event(), False
        self._slider = self._build(page.server.gui)
        page.server.on_client_connect(lambda _: self._wake.set())
        self._thread = threading.Thread(target=self._run, name="handsight player", daemon=True)

    def start(self) -> None:
        """Begins to play."""
        self._thread.start()

    def finish(self) -> None:
        """Ends: the timeline grows no more."""
        self._growing = False
        self._wake.set()

    def play(self, playing: bool) -> None:
        """Goes on, from the beginning where the end was reached; or stops."""
        if playing and not self._growing and self.time >= self._timeline.length:
            self.time = 0.0
        self.playing = playing
        self._wake.set()

    def seek(self, time: float) -> None:
        """Goes to a time since the first moment [s]."""
        self.time = min(max(time, 0.0), self._timeline.length)
        self._wake.set()

    def close(self) -> None:
        """Stops."""
        self._closed = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _build(self, gui: "GuiApi") -> "GuiSliderHandle":
        """Returns the slider and its buttons."""
        self._button = gui.add_button("Pause", order=CONTROLS)
        slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0, order=CONTROLS + 1)
        speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x", order=CONTROLS + 2)
        self._button.on_click(lambda _: self.play(not self.playing))

        def moved(event: "GuiEvent") -> None:
            if event.client is not None:  # else it is ours
                self._moved = time.monotonic()
                self.seek(slider.value)

        def chosen(_: object) -> None:
            self.speed = float(speed.value.rstrip("x"))

        slider.on_update(moved)
        speed.on_update(chosen)
        return slider

    def _run(self) -> None:
        last = time.monotonic()
        while not self._closed:
            if not (self.playing and self._watched):
                # A timeline that grows makes its plots longer.
                self._wake.wait(PLAYER.poll_period if self._growing else None)
                self._wake.clear()
                last = time.monotonic()
            if self._closed or not self._watched:
                continue
            now = time.monotonic()
            if self.playing:
                self._advance(now - last)
            last = now
            self._show()
            if self.playing:
                time.sleep(max(0.0, PLAYER.frame - (time.monotonic() - now)))

    @property
    def _watched(self) -> bool:
        """Whether there is something to show, and somebody to show it to."""
        return bool(self._timeline.moments) and self._page.watched

    def _advance(self, seconds: float) -> None:
        self.time = min(self.time + self.speed * seconds, self._timeline.length)
        if self.time >= self._timeline.length and not self._growing:
            self.playing = False

    def _show(self) -> None:
        """Shows the moment of now, and what is beside it."""
        now, moment = self.time, self._timeline.at(self.time)
        if moment is not self._drawn:
            self._drawn = moment
            self._page.draw(moment)
        label = "Pause" if self.playing else "Play"
        if self._button.label != label:
            self._button.label = label
        clock = time.monotonic()
        if self.playing and clock - self._plotted < PLAYER.plot_period:
            return
        self._plotted = clock
        if self._curves_at == -math.inf or (
            self._curves_at != math.inf and clock - self._curves_at > PLAYER.poll_period
        ):
            self._curves_at = clock if self._growing else math.inf
            self._plot = self._curves()
            self._slider.max = max(round(self._timeline.length, 2), 0.01)
        if self._plot is not None:
            self._page.draw_curves(self._plot, now)
        if clock - self._moved > PLAYER.min_hold:
            self._slider.value = round(now, 2)
