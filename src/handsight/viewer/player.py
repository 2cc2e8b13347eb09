"""Playback of a recording's moments, with pause, seeking and a choice of speed."""

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from handsight.viewer.moment import Moment
from handsight.viewer.page import Page
from handsight.viewer.panel import CONTROLS
from handsight.viewer.timeline import TIMELINE, Curves, Timeline

if TYPE_CHECKING:
    from viser import GuiEvent


class PlayerOptions(NamedTuple):
    """`PlayerOptions` say how a recording is played."""

    plot_period: float = 0.2  # between two plots [s]
    poll_period: float = 1.0  # between two checks of a timeline that grows [s]
    step: float = 0.1  # by which a key goes back or ahead [s]
    min_hold: float = 0.6  # for which playing leaves the slider to the person who has moved it [s]


PLAYER = PlayerOptions()


class Player:
    """A `Player` shows the moments of a timeline, which may still grow, while a browser is open on the page."""

    def __init__(self, page: Page, timeline: Timeline, curves: Callable[[], Curves]) -> None:
        """`curves` computes what is plotted of the timeline so far."""
        self._page, self._timeline, self._curves = page, timeline, curves
        self.time, self.speed, self.playing = 0.0, 1.0, True
        """Time since the first moment [s], and seconds of the recording that are played in a second."""
        self._growing = True
        self._drawn: Moment | None = None
        self._plot: Curves | None = None
        self._moved = self._plotted = self._curves_at = -math.inf
        """When a person last moved the slider, when curves were last plotted, and when they were last computed [s]; the
        last is infinite once they no longer change."""
        self._wake, self._closed = threading.Event(), False
        gui = page.server.gui
        self._button = gui.add_button("Pause", order=CONTROLS)
        self._slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0, order=CONTROLS + 1)
        speeds = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")
        speed = gui.add_dropdown("speed", speeds, initial_value="1x", order=CONTROLS + 2)

        def moved(event: "GuiEvent") -> None:
            if event.client is not None:  # else the player itself has moved it
                self._moved = time.monotonic()
                self.seek(self._slider.value)

        def chosen(_: object) -> None:
            self.speed = float(speed.value.rstrip("x"))

        def opened(fields: dict[str, list[str]]) -> None:
            with contextlib.suppress(KeyError, ValueError):
                self._stop_at(float(fields["t"][0]))

        keys: dict[Any, tuple[str, Callable[[], None]]] = {
            "K": ("play or pause", lambda: self.play(not self.playing)),
            "J": (f"{PLAYER.step} s back", lambda: self._stop_at(self.time - PLAYER.step)),
            "L": (f"{PLAYER.step} s ahead", lambda: self._stop_at(self.time + PLAYER.step)),
            "home": ("to the beginning", lambda: self._stop_at(0.0)),
            "end": ("to the end", lambda: self._stop_at(math.inf)),
        }
        for key, (label, act) in keys.items():
            gui.add_command(label, hotkey=key).on_trigger(lambda _, act=act: act())
        page.on_open = opened
        self._button.on_click(lambda _: self.play(not self.playing))
        self._slider.on_update(moved)
        speed.on_update(chosen)
        page.server.on_client_connect(lambda _: self._wake.set())
        self._thread = threading.Thread(target=self._run, name="handsight player", daemon=True)

    def start(self) -> None:
        """Begins to play."""
        self._thread.start()

    def finish(self) -> None:
        """Must be called when the timeline no longer grows."""
        self._growing = False
        self._wake.set()

    def play(self, playing: bool) -> None:
        """Plays, from the beginning if the end was reached, or pauses."""
        if playing and not self._growing and self.time >= self._timeline.length:
            self.time = 0.0
        self.playing = playing
        self._wake.set()

    def seek(self, time: float) -> None:
        """Goes to a time since the first moment [s]."""
        self.time = min(max(time, 0.0), self._timeline.length)
        self._wake.set()

    def _stop_at(self, time: float) -> None:
        """Pauses at a time since the first moment [s]."""
        self.playing = False
        self.seek(0.0 if math.isnan(time) else time)

    def close(self) -> None:
        """Ends the player."""
        self._closed = True
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        """Plays until the player is closed, and waits while there is nothing to do."""
        last = time.monotonic()
        while not self._closed:
            if not (self.playing and self._watched):
                self._wake.wait(PLAYER.poll_period if self._growing else None)
                self._wake.clear()
                last = time.monotonic()
            if self._closed or not self._watched:
                continue
            now = time.monotonic()
            if self.playing:
                self.time = min(self.time + self.speed * (now - last), self._timeline.length)
                if self.time >= self._timeline.length and not self._growing:
                    self.playing = False
            last = now
            self._show()
            if self.playing:
                time.sleep(max(0.0, TIMELINE.frame - (time.monotonic() - now)))

    @property
    def _watched(self) -> bool:
        """Whether there is a moment to show, and a browser that shows it."""
        return bool(self._timeline.moments) and self._page.watched

    def _show(self) -> None:
        """Shows the moment at the current time, the curves, and where the slider is."""
        now, moment = self.time, self._timeline.at(self.time)
        if moment is not self._drawn:
            self._page.origin = self._timeline.begin
            self._drawn = moment
            self._page.draw(moment)
        label = "Pause" if self.playing else "Play"
        if self._button.label != label:
            self._button.label = label
        clock = time.monotonic()
        if self.playing and clock - self._plotted < PLAYER.plot_period:
            return
        self._plotted = clock
        if clock - self._curves_at > PLAYER.poll_period:
            self._curves_at = clock if self._growing else math.inf
            self._plot = self._curves()
            self._slider.max = max(round(self._timeline.length, 2), 0.01)
        if self._plot is not None:
            self._page.draw_curves(self._plot, now)
        if clock - self._moved > PLAYER.min_hold:
            self._slider.value = round(now, 2)
