"""A page that shows moments to all browsers that are open on it."""

import contextlib
import io
import logging
import threading
from collections.abc import Set
from importlib import import_module
from types import ModuleType

import numpy as np

from handsight import se3
from handsight.errors import HandsightError, InvalidInput, needing
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.viewer.guard import Guard
from handsight.viewer.moment import Moment
from handsight.viewer.panel import Panel
from handsight.viewer.picture import Picture
from handsight.viewer.scene import LAYERS, Color, MomentScene
from handsight.viewer.timeline import Curves

PAGE_HOST = "127.0.0.1"  # this machine alone
PAGE_PORT = 8080  # the default
MAX_PORT = 65535  # the largest port
DISTANCE = 0.25  # of the camera from object and palm, about [m]


def require_viser() -> ModuleType:
    """Returns the package viser; raises MissingExtra where it is absent."""
    with needing("the viewer needs viser", "view"):
        return import_module("viser")


class Page:
    """A server for this machine alone, with the scene and the panel on its page."""

    def __init__(
        self, rig: Rig, model: ObjectModel, *, port: int = PAGE_PORT, title: str = "handsight"
    ) -> None:
        """Serves the page at `port`, or at the next free one; raises MissingExtra, or HandsightError where none is."""
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
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self.begin(rig, model, title)
            undo.pop_all()

    def begin(self, rig: Rig, model: ObjectModel, title: str) -> None:
        """Clears the page, to show another hand or another object."""
        self._rig = rig
        self._model = model
        self.origin = 0.0
        """Stamp from which the page counts time, in the title and the plot [s]."""
        self._lock = threading.Lock()  # both the player and the panel's checkboxes draw
        self._drawn: tuple[Picture | None, Set[Color]] = None, set()
        """The image on the page, and the colours of its outlines."""
        self.last: Moment | None = None  # the moment that is shown
        with self.server.atomic():
            self.server.scene.reset()
            self.server.gui.reset()
            self.server.scene.configure_default_lights(cast_shadow=False)
            self.scene = MomentScene(self.server.scene, rig, model)
            self.panel = Panel(self.server.gui, title or "object", self.scene.layers, self.redraw)

    @property
    def address(self) -> str:
        """Address of the page for a browser, with the token without which nobody may read it."""
        return f"http://{PAGE_HOST}:{self.port}/?token={self.guard.token}"

    @property
    def watched(self) -> bool:
        """Whether a browser is open on it."""
        return bool(self.server.get_clients())

    def draw(self, moment: Moment) -> None:
        """Shows a moment in place of the last one."""
        with self._lock, self.server.atomic():
            if self.last is None:
                self._aim(moment)
            forces = moment.forces()
            self.scene.draw(moment, forces)
            self.panel.draw(moment, forces, moment.stamp - self.origin)
            self._draw_picture(moment)
            self.last = moment

    def draw_curves(self, curves: Curves, now: float) -> None:
        """Plots curves, with a mark at one of their times [s]."""
        with self.server.atomic():
            self.panel.draw_curves(curves, now)

    def redraw(self) -> None:
        """Shows the same moment again, after a person has chosen other layers."""
        if self.last is not None:
            self.draw(self.last)

    def close(self) -> None:
        """Ends the server; browsers keep what they show."""
        with contextlib.redirect_stdout(io.StringIO()):  # and a farewell
            self.server.stop()

    def _draw_picture(self, moment: Moment) -> None:
        """Draws the image with the outlines of vision's pose and of the corrected one."""
        shown = moment.picture
        if shown is None:
            return
        outlines = {}
        # Vision's pose was brought into the palm by the calibrated camera; the same brings it back.
        for name, known, T_camera_palm in (
            ("vision", moment.vision, shown.T_camera_palm_calibrated),
            ("object", moment.estimate, shown.T_camera_palm),
        ):
            if known is not None and T_camera_palm is not None and self.scene.layers[name]:
                outlines[LAYERS[name][1]] = T_camera_palm @ known.T_palm_object
        drawn = shown, outlines.keys()
        if drawn != self._drawn:
            self._drawn = drawn
            self.panel.draw_image(shown.with_outlines(self._model, outlines))

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
