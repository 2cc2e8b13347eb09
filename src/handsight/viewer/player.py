"""Playback of a recording's moments, with pause, seeking and a choice of speed."""

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.panel import CONTROLS
from handsight.viewer.timeline import TIMELINE_FRAME, Curves, Timeline

if TYPE_CHECKING:
    from viser import GuiEvent


PLOT_PERIOD = 0.5  # between two plots [s]
PLAYER_STEP = 0.1  # by which a key goes back or ahead [s]
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")


class Player:
    """Shows the moments of a timeline, which may still grow, while a browser is open on the page."""

    def __init__(self, page: Page, timeline: Timeline, curves: Callable[[], Curves]) -> None:
        """`curves` computes what is plotted of the timeline so far."""
        self._page = page
        self._timeline = timeline
        self._curves = curves
        self.time = 0.0  # since the first moment [s]
        self.speed = 1.0  # seconds of the recording that are played in a second
        self.playing = True
        self._growing = True
        self._drawn: Moment | None = None
        self._plotted: tuple[float, float] | None = None  # time and length of the last plot [s]
        self._next_plot = 0.0  # time of day at which there may be another [s]
        self._closed = threading.Event()
        gui = page.server.gui
        self._button = gui.add_button("Pause", order=CONTROLS)
        self._button.on_click(lambda _: self.play(not self.playing))
        self._slider = gui.add_slider("time [s]", 0, 1, step=0.01, initial_value=0, order=CONTROLS + 1)
        self._slider.on_update(self._slid)
        speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x", order=CONTROLS + 2)
        speed.on_update(self._chosen)
        play = gui.add_command("play or pause", hotkey="K")
        play.on_trigger(lambda _: self.play(not self.playing))
        back = gui.add_command(f"{PLAYER_STEP} s back", hotkey="J")
        back.on_trigger(lambda _: self._step(-PLAYER_STEP))
        ahead = gui.add_command(f"{PLAYER_STEP} s ahead", hotkey="L")
        ahead.on_trigger(lambda _: self._step(PLAYER_STEP))
        self._thread = threading.Thread(target=self._run, name="handsight player", daemon=True)

    def start(self) -> None:
        """Begins to play."""
        self._thread.start()

    def finish(self) -> None:
        """Must be called when the timeline no longer grows."""
        self._growing = False

    def play(self, playing: bool) -> None:
        """Plays, from the beginning if the end was reached, or pauses."""
        if playing and not self._growing and self.time >= self._timeline.length:
            self.time = 0.0
        self.playing = playing

    def seek(self, time: float) -> None:
        """Goes to a time since the first moment [s]."""
        self.time = min(max(time, 0.0), self._timeline.length)

    def close(self) -> None:
        """Ends the player."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()

    def _step(self, by: float) -> None:
        """Pauses, and goes ahead by some seconds."""
        self.playing = False
        self.seek(self.time + by)

    def _slid(self, event: "GuiEvent") -> None:
        """Goes where a person has moved the slider, which the player moves too."""
        if event.client is not None:
            self._next_plot = time.monotonic() + PLOT_PERIOD  # until then the slider is that person's
            self.seek(self._slider.value)

    def _chosen(self, event: "GuiEvent") -> None:
        """Plays at the speed that a person has chosen."""
        self.speed = float(event.target.value.rstrip("x"))

    def _run(self) -> None:
        """Plays until the player is closed, while a browser is open."""
        last = time.monotonic()
        while not self._closed.wait(TIMELINE_FRAME):
            now = time.monotonic()
            passed = now - last
            last = now
            if not self._timeline.moments or not self._page.watched:
                continue
            if self.playing:
                self.seek(self.time + self.speed * passed)
                self.playing = self._growing or self.time < self._timeline.length
            self._show(now)

    def _show(self, clock: float) -> None:
        """Shows the moment at the current time, the curves, and where the slider is; `clock` is the time of day [s]."""
        now = self.time
        moment = self._timeline.at(self.time)
        if moment is not self._drawn:
            self._page.origin = self._timeline.begin
            self._drawn = moment
            self._page.draw(moment)
        label = "Pause" if self.playing else "Play"
        if self._button.label != label:
            self._button.label = label
        length = self._timeline.length
        if clock < self._next_plot or self._plotted == (now, length):
            return
        self._next_plot = clock + PLOT_PERIOD
        self._plotted = now, length
        self._page.draw_curves(self._curves(), now)
        self._slider.max = max(round(length, 2), 0.01)
        self._slider.value = round(now, 2)
