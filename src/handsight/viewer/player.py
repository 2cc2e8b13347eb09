"""The page: a server that shows a timeline to all browsers that are open on it, with pause, seeking and speed."""

import atexit
import contextlib
import io
import logging
import threading
import time
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.errors import HandsightError, InvalidInput, needing
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.viewer.guard import Guard
from handsight.viewer.moment import MOMENT_PERIOD, Moment, Timeline
from handsight.viewer.panel import CONTROLS, Panel
from handsight.viewer.scene import MomentScene

if TYPE_CHECKING:
    from viser import GuiEvent

PAGE_HOST = "127.0.0.1"  # this machine alone
PAGE_PORT = 8080  # the default
MAX_PORT = 65535  # the largest port
DISTANCE = 0.25  # of the camera from object and palm, about [m]
PLOT_PERIOD = 0.5  # between two plots [s]
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x")
LIVE_MOMENTS = 1800  # that are kept of a running robot: a minute


def require_viser() -> ModuleType:
    """Returns the package viser; raises MissingExtra where it is absent."""
    with needing("the viewer needs viser", "view"):
        return import_module("viser")


class Player:
    """Serves the page of a timeline, which may still grow, to this machine alone; while no browser is open on it,
    nothing is drawn."""

    def __init__(
        self, rig: Rig, model: ObjectModel, *, port: int = PAGE_PORT, title: str = "", live: bool = False
    ) -> None:
        """Serves the page at `port`, or at the next free one; raises MissingExtra, or HandsightError where none is.

        `live`: the newest moment is shown rather than all one after another, and the last minute is kept.
        """
        viser = require_viser()
        if not 1 <= port <= MAX_PORT:  # viser would wait for ever
            raise InvalidInput(f"port: expected a number from 1 to {MAX_PORT}, got {port}")
        self.guard = Guard()
        # What is no message of a browser ends its connection, and needs no traceback.
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        try:
            # viser prints a banner.
            with contextlib.redirect_stdout(io.StringIO()), self.guard.installed():
                self.server = viser.ViserServer(host=PAGE_HOST, port=port, label="handsight", verbose=False)
        except OSError as error:
            raise HandsightError(f"port: expected one that is free from {port} on, got {error}") from None
        self.port: int = self.server.get_port()  # the port at which the page is served
        self.speed = 1.0  # seconds of the recording that are played in a second
        self.playing = True
        self._live = live
        self._growing = True
        self._closed = threading.Event()
        self._lock = threading.Lock()  # both the thread and the panel's checkboxes draw
        self._thread = threading.Thread(target=self._run, name="handsight viewer", daemon=True)
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self.begin(rig, model, title)
            undo.pop_all()

    def begin(self, rig: Rig, model: ObjectModel, title: str) -> None:
        """Clears the page, to show another hand or another object."""
        self.timeline = Timeline(rig, model, LIVE_MOMENTS if self._live else None)
        self.time = 0.0  # since the timeline's origin [s]
        self.last: Moment | None = None  # the moment that is shown
        self._plotted: tuple[float, float] | None = None  # time and end of the last plot [s]
        self._next_plot = 0.0  # time of day at which there may be another [s]
        with self.server.atomic():
            self.server.scene.reset()
            self.server.gui.reset()
            self.server.scene.configure_default_lights(cast_shadow=False)
            self.scene = MomentScene(self.server.scene, rig, model)
            gui = self.server.gui
            self.panel = Panel(gui, model, title or "object", self.scene.layers, self.redraw)
            self._button = gui.add_button("Pause", order=CONTROLS)
            self._button.on_click(lambda _: self.play(not self.playing))
            self._slider = gui.add_slider("time [s]", 0, 1, step=0.01, initial_value=0, order=CONTROLS + 1)
            self._slider.on_update(self._slid)
            if not self._live:
                speed = gui.add_dropdown("speed", SPEEDS, initial_value="1x", order=CONTROLS + 2)
                speed.on_update(self._chosen)

    @property
    def address(self) -> str:
        """Address of the page for a browser, with the token without which nobody may read it."""
        return f"http://{PAGE_HOST}:{self.port}/?token={self.guard.token}"

    @property
    def watched(self) -> bool:
        """Whether a browser is open on it."""
        return bool(self.server.get_clients())

    def start(self) -> None:
        """Begins to play."""
        atexit.register(self.close)  # before viser's own end, which says farewell
        self._thread.start()

    def finish(self) -> None:
        """Must be called when the timeline no longer grows."""
        self._growing = False

    def play(self, playing: bool) -> None:
        """Plays, from the beginning if the end was reached, or pauses."""
        if playing and not self._growing and self.time >= self.timeline.end:
            self.time = 0.0
        self.playing = playing

    def seek(self, time: float) -> None:
        """Goes to a time since the timeline's origin [s]."""
        self.time = min(max(time, self.timeline.begin), self.timeline.end)

    def close(self) -> None:
        """Ends the page; browsers keep what they show."""
        atexit.unregister(self.close)
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join()
        with contextlib.redirect_stdout(io.StringIO()):  # viser says farewell
            self.server.stop()

    def take(self) -> None:
        """Called before each frame; may add to the timeline."""

    def draw(self, moment: Moment) -> None:
        """Shows a moment in place of the last one."""
        with self._lock, self.server.atomic():
            if self.last is None:
                self._aim(moment)
            forces = moment.forces()
            self.scene.draw(moment, forces)
            self.panel.draw(moment, forces, moment.stamp - self.timeline.origin)
            self.panel.draw_image(moment)
            self.last = moment

    def redraw(self) -> None:
        """Shows the same moment again, after a person has chosen other layers."""
        if self.last is not None:
            self.draw(self.last)

    def _slid(self, event: "GuiEvent") -> None:
        """Goes where a person has moved the slider, which the player moves too."""
        if event.client is not None:
            self._next_plot = time.monotonic() + PLOT_PERIOD  # until then the slider is that person's
            self.playing = self.playing and not self._live
            self.seek(self._slider.value)

    def _chosen(self, event: "GuiEvent") -> None:
        """Plays at the speed that a person has chosen."""
        self.speed = float(event.target.value.rstrip("x"))

    def _run(self) -> None:
        """Plays until the player is closed, while a browser is open."""
        last = time.monotonic()
        while not self._closed.wait(MOMENT_PERIOD):
            now = time.monotonic()
            passed = now - last
            last = now
            if not self.watched:
                continue
            self.take()
            if not self.timeline.moments:
                continue
            if self.playing:
                self.seek(np.inf if self._live else self.time + self.speed * passed)
                self.playing = self._growing or self.time < self.timeline.end
            self._show(now)

    def _show(self, clock: float) -> None:
        """Shows the moment at the current time, the curves, and where the slider is; `clock` is the time of day [s]."""
        now = self.time
        moment = self.timeline.at(now)
        if moment is not self.last:
            self.draw(moment)
        label = "Pause" if self.playing else "Play"
        if self._button.label != label:
            self._button.label = label
        end = self.timeline.end
        if clock < self._next_plot or self._plotted == (now, end):
            return
        self._next_plot = clock + PLOT_PERIOD
        self._plotted = now, end
        with self.server.atomic():
            self.panel.draw_curves(self.timeline.curves(), now)
            self._slider.max = max(round(end, 2), 0.01)
            self._slider.min = round(self.timeline.begin, 2)
            self._slider.value = round(now, 2)

    def _aim(self, moment: Moment) -> None:
        """Aims all cameras at hand and object from the side, the world's vertical upright."""
        up = np.array([0.0, 0.0, 1.0]) if moment.T_world_palm is None else moment.T_world_palm[2, :3]
        # The view is across the line from palm to object, from above and the palm's side: the hand is in front.
        along = np.zeros(3) if moment.estimate is None else moment.estimate.T_palm_object[:3, 3]
        across = np.cross(up, along)
        if not across.any():
            across = se3.perpendicular(up)
        across = across / np.linalg.norm(across)
        view = across + (up - np.cross(across, up)) / 2
        self.server.scene.set_up_direction(up)
        self.server.initial_camera.up = up
        for camera in (self.server.initial_camera, *(c.camera for c in self.server.get_clients().values())):
            camera.position = along / 2 + DISTANCE * view
            camera.look_at = along / 2  # viser asks for this order
