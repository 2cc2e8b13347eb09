"""The panel beside the scene: the state and its reason, the camera's image, curves of the errors, choice of layers."""

import base64
import html
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight.checks import Array
from handsight.errors import printable
from handsight.tracking import State
from handsight.viewer.moment import Moment
from handsight.viewer.picture import jpeg
from handsight.viewer.scene import LAYERS
from handsight.viewer.timeline import Curves
from handsight.vision.pixels import Color

if TYPE_CHECKING:
    from viser import GuiApi, GuiCheckboxHandle

STATES: dict[State, str] = {"tracking": "#2e7d32", "uncertain": "#c77800", "lost": "#b71c1c"}
SLIP = "#6a1b9a"
COLORS = {f"σ {state} [mm]": color for state, color in STATES.items()}
COLORS |= {"error [mm]": "#d81b60", "slips": SLIP, "now": "#111111"}
"""Of the plotted curves."""
CONTROLS = 10  # position of a player's controls in the panel: after the status, 0, before the curves, 30


class Panel:
    """The control panel of a page."""

    def __init__(
        self, gui: "GuiApi", title: str, layers: dict[str, bool], redraw: Callable[[], None]
    ) -> None:
        """Adds the panel to viser's `gui`; a person's choice changes `layers` in place and calls `redraw`."""
        self._gui = gui
        self._title = title
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self.status = gui.add_html("", order=0)
        legend = ""
        for label, color in LAYERS.values():
            legend += (
                '<span style="white-space:nowrap;margin-right:.9em">'
                f'<span style="color:rgb{color}">&#9679;</span> {html.escape(label)}</span> '
            )
        gui.add_html(f'<div style="padding:0 .8em;color:#555;font-size:.74em">{legend}</div>', order=1)
        self.curves: Any = None
        self.image = gui.add_html("", order=40)

        def choose(name: str, box: "GuiCheckboxHandle") -> None:
            layers[name] = box.value
            redraw()

        with gui.add_folder("What is shown", order=50, expand_by_default=False):
            for name, (label, _) in LAYERS.items():
                box = gui.add_checkbox(label, layers[name])
                box.on_update(lambda _, name=name, box=box: choose(name, box))

    def draw(self, moment: Moment, forces: dict[str, Array], time: float) -> None:
        """Writes the time since the origin [s], the state, why, and each finger's force, or why it has no contact."""
        labels = ""
        for name in moment.fingertips.fingers:
            label = f"{np.linalg.norm(forces[name]):.1f} N" if name in forces else "touches"
            if name in moment.outliers:
                labels += _pill("#222", name, f"{label}, rejected")
            else:
                labels += _pill("#c2185b", name, label)
        for name, reason in moment.fingertips.reasons.items():
            labels += _pill("#9e9e9e", name, reason)
        _, _, why = printable(moment.sentence).partition(": ")
        self.status.content = (
            f'<div style="padding:0 .8em;font-size:.86em;line-height:1.4">'
            f'<div style="color:#666">{html.escape(printable(self._title))} · '
            f'<span title="stamp {moment.stamp:.6f} s">{time:.2f} s</span></div>'
            f'<div><b style="color:{STATES[moment.state]}">{moment.state.upper()}</b> {html.escape(why)}</div>'
            f'<div style="margin:.3em 0">{labels}</div></div>'
        )

    def draw_image(self, image: Color) -> None:
        """Shows an image (h, w, 3)."""
        # viser's own element takes five times as long to encode it.
        data = base64.b64encode(jpeg(image)).decode()
        self.image.content = (
            '<div style="padding:0 .8em"><img alt="camera" style="width:100%;border-radius:.3em" '
            f'src="data:image/jpeg;base64,{data}"></div>'
        )

    def draw_curves(self, curves: Curves, now: float) -> None:
        """Plots curves, with a mark at one of their times [s]."""
        times = curves.times
        if len(times) < 2:
            return
        sigmas = {f"σ {state} [mm]": curves.states == state for state in STATES}
        sigmas["slips"] = curves.slipping
        sigmas["now"] = np.arange(len(times)) == np.searchsorted(times[1:], now, side="right")
        lines = {"time [s]": times, "error [mm]": curves.errors}
        lines |= {name: np.where(there, curves.sigmas, np.nan) for name, there in sigmas.items()}
        data = tuple(lines.values())
        if self.curves is None:
            series = []
            for name in lines:
                points = {"show": name in ("slips", "now"), "size": 6}
                series.append({"label": name, "stroke": COLORS.get(name), "width": 2, "points": points})
            scales: Any = {"x": {"time": False}, "y": {"distr": 3}}
            style: Any = {"height": 240, "padding": (12, 16, 0, 0), "order": 30}
            self.curves = self._gui.add_uplot(data, tuple(series), scales=scales, **style)
        self.curves.data = data


def _pill(color: str, name: str, label: str) -> str:
    return (
        f'<span style="display:inline-block;background:{color};color:#fff;border-radius:.7em;'
        f'padding:0 .6em;margin:0 .3em .2em 0"><b>{html.escape(name)}</b> {html.escape(label)}</span>'
    )
