"""A page that shows moments to all browsers that are open on it."""

import contextlib
import io
import logging
import threading
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.errors import HandsightError, InvalidInput, needing
from handsight.objects import ObjectModel
from handsight.rig import Rig
from handsight.viewer.guard import Guard
from handsight.viewer.moment import Moment
from handsight.viewer.panel import Panel
from handsight.viewer.picture import Picture
from handsight.viewer.scene import LAYERS, Color, MomentScene
from handsight.viewer.timeline import Curves


class PageOptions(NamedTuple):
    """`PageOptions` say where the page is served, and how often it is drawn."""

    host: str = "127.0.0.1"  # this machine alone
    port: int = 8080  # the default
    max_port: int = 65535  # the largest port
    min_change: float = 1e-3  # change of a pose, in any number, from which its outline on an image is redrawn
    image_period: float = 0.1  # between two outlines on the same image [s]
    distance: float = 2.4  # of the camera from object and palm, relative to half their span


PAGE = PageOptions()


def require_viser() -> ModuleType:
    """Returns the package viser; raises MissingExtra where it is absent."""
    with needing("the viewer needs viser", "view"):
        return import_module("viser")


class Page:
    """A `Page` is a server for this machine alone, with the scene and the panel on its page."""

    def __init__(
        self, rig: Rig, model: ObjectModel, *, port: int = PAGE.port, title: str = "handsight"
    ) -> None:
        """Serves the page at `port`, or at the next free one; raises MissingExtra, or HandsightError where none is."""
        viser = require_viser()
        if not 1 <= port <= PAGE.max_port:  # viser would wait for ever
            raise InvalidInput(f"port: expected a number from 1 to {PAGE.max_port}, got {port}")
        self.on_open: Callable[[dict[str, list[str]]], None] | None = None
        """Called with the fields of the URL when a browser opens the page; None: moments have no addresses."""
        self.guard = Guard(lambda fields: None if self.on_open is None else self.on_open(fields))
        # What is no message of a browser ends its connection, and needs no traceback.
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        try:
            # viser prints a banner.
            with contextlib.redirect_stdout(io.StringIO()), self.guard.installed():
                self.server = viser.ViserServer(host=PAGE.host, port=port, label="handsight", verbose=False)
        except OSError as error:
            raise HandsightError(f"port: expected one that is free from {port} on, got {error}") from None
        self.port: int = self.server.get_port()  # the port at which the page is served
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self.begin(rig, model, title)
            undo.pop_all()

    def begin(self, rig: Rig, model: ObjectModel, title: str) -> None:
        """Clears the page, to show another hand or another object."""
        self._rig, self._model = rig, model
        self.origin = 0.0
        """Stamp from which the page counts time, in the title, the plot and links [s]."""
        self._lock = threading.Lock()  # both the player and the panel's checkboxes draw
        self._aimed = False
        self._drawn: tuple[Picture | None, float, dict[Color, Array]] = None, 0.0, {}
        """The image on the page, the stamp of its moment [s], and T_camera_object (4, 4) of each outline by colour."""
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
        return f"http://{PAGE.host}:{self.port}/?token={self.guard.token}"

    @property
    def watched(self) -> bool:
        """Whether a browser is open on it."""
        return bool(self.server.get_clients())

    def draw(self, moment: Moment) -> None:
        """Shows a moment in place of the last one."""
        with self._lock, self.server.atomic():
            self._aim(moment)
            forces = moment.forces()
            self.scene.draw(moment, forces)
            time = f"{moment.stamp - self.origin:.2f}"
            when = f'<span title="stamp {moment.stamp:.6f} s">{time} s</span>'
            if self.on_open is not None:
                when += f' · <a href="?token={self.guard.token}&amp;t={time}">link to it</a>'
            self.panel.draw(moment, forces, when)
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
        shown, estimate = moment.picture, moment.estimate
        if shown is None:
            return
        outlines = {}
        # Vision's pose was brought into the palm by the calibrated camera; the same brings it back.
        for name, known, T_camera_palm in (
            ("vision", moment.vision, shown.T_camera_palm_calibrated),
            ("object", estimate, shown.T_camera_palm),
        ):
            if known is not None and T_camera_palm is not None and self.scene.layers[name]:
                outlines[LAYERS[name][1]] = T_camera_palm @ known.T_palm_object
        before, stamp, drawn = self._drawn
        if shown is before and outlines.keys() == drawn.keys():
            moved = max((np.abs(T - drawn[color]).max() for color, T in outlines.items()), default=0.0)
            if moved < PAGE.min_change or abs(moment.stamp - stamp) < PAGE.image_period:
                return
        self._drawn = shown, moment.stamp, outlines
        self.panel.draw_image(shown.with_outlines(self._model, outlines))

    def _aim(self, moment: Moment) -> None:
        """Aims all cameras at the hand from the side, the world's vertical upright, when the first moment is drawn."""
        if self._aimed:
            return
        self._aimed = True
        places = [T[:3, 3] for T in moment.links(self._rig).values()] or [np.zeros(3)]
        if moment.estimate is not None:
            places.append(moment.estimate.T_palm_object[:3, 3])
        low, high = np.min(places, axis=0), np.max(places, axis=0)
        center, span = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 0.05)
        up = np.array([0.0, 0.0, 1.0]) if moment.T_world_palm is None else moment.T_world_palm[2, :3]
        # The view is across the line from palm to object, from above and the palm's side: the hand is in front.
        along = places[-1] - places[0]
        across = np.cross(up, along)
        if np.linalg.norm(across) < 0.2 * np.linalg.norm(along):
            across = se3.perpendicular(up)
        across = across / np.linalg.norm(across)
        view = across - 0.45 * np.cross(across, up) + 0.4 * up
        position = center + PAGE.distance * span * np.asarray(view / np.linalg.norm(view))
        self.server.scene.set_up_direction(up)
        self.server.initial_camera.up = up
        for camera in (self.server.initial_camera, *(c.camera for c in self.server.get_clients().values())):
            for name, value in (("position", position), ("look_at", center)):  # viser asks for this order
                setattr(camera, name, value)
