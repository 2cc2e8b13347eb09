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
NOW, SLIP = "#111111", "#6a1b9a"
CONTROLS = 10  # position of a player's controls in the panel: after the status, 0, before the strip, 20


class Panel:
    """A `Panel` is the control panel of a page."""

    def __init__(
        self, gui: "GuiApi", title: str, layers: dict[str, bool], redraw: Callable[[], None]
    ) -> None:
        """Adds the panel to viser's `gui`; a person's choice changes `layers` in place and calls `redraw`."""
        from viser import uplot

        self._gui, self._title, self._uplot = gui, title, uplot
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self.status = gui.add_html("", order=0)
        legend = "".join(
            f'<span style="white-space:nowrap;margin-right:.9em"><span style="color:rgb{color}">&#9679;</span> '
            f"{html.escape(label)}</span> "
            for label, color in LAYERS.values()
        )
        legend = f'<div style="padding:0 .8em;color:#555;font-size:.74em">{legend}</div>'
        gui.add_html(legend, order=1)
        self.strip = gui.add_html("", order=20)
        self.curves: Any = None
        self.image = gui.add_html("", order=40)

        def choose(name: str, box: "GuiCheckboxHandle") -> None:
            layers[name] = box.value
            redraw()

        with gui.add_folder("What is shown", order=50, expand_by_default=False):
            for name, (label, _) in LAYERS.items():
                box = gui.add_checkbox(label, layers[name])
                box.on_update(lambda _, name=name, box=box: choose(name, box))

    def draw(self, moment: Moment, forces: dict[str, Array], when: str) -> None:
        """Writes the time as HTML, the state, its reason, and for each finger its force, or why it has no contact."""
        labels = ""
        for name in (*moment.fingertips.fingers, *moment.fingertips.reasons):
            color, label = "#9e9e9e", moment.fingertips.reasons.get(name, "")
            if name in moment.fingertips.fingers:
                rejected = name in moment.outliers
                color = "#222" if rejected else "#c2185b"
                label = f"{np.linalg.norm(forces[name]):.1f} N" if name in forces else "touches"
                label = f"{label}, rejected" if rejected else label
            labels += (
                f'<span style="display:inline-block;background:{color};color:#fff;border-radius:.7em;'
                f'padding:0 .6em;margin:0 .3em .2em 0"><b>{html.escape(name)}</b> {html.escape(label)}</span>'
            )
        _, _, why = printable(moment.sentence).partition(": ")
        self.status.content = (
            f'<div style="padding:0 .8em;font-size:.86em;line-height:1.4">'
            f'<div style="color:#666">{html.escape(printable(self._title))} · {when}</div>'
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
        if len(curves.times) < 2:
            return
        self.strip.content = _strip(curves, now)
        marked = np.full(len(curves.times), np.nan)
        k = int(np.searchsorted(curves.times, now, side="right")) - 1
        marked[max(k, 0)] = curves.sigmas[max(k, 0)]
        lines = [(curves.sigmas, "σ [mm]", "#1565c0")]
        if curves.errors is not None:
            lines.append((curves.errors, "error [mm]", "#d81b60"))
        data = (curves.times, *(values for values, _, _ in lines), marked)
        if self.curves is not None and len(self.curves.series) == len(data):
            self.curves.data = data
            return
        if self.curves is not None:
            self.curves.remove()
        series = [self._uplot.Series(label=label, stroke=color, width=2) for _, label, color in lines]
        dot = self._uplot.Series_Points(show=True, size=11, fill=NOW, stroke=NOW)
        shown = (self._uplot.Series(label="time [s]"), *series, self._uplot.Series(label="now", points=dot))
        scales = {"x": self._uplot.Scale(time=False), "y": self._uplot.Scale(distr=3)}
        size = {"height": 200, "padding": (12, 16, 0, 0)}
        self.curves = self._gui.add_uplot(data, shown, scales=scales, **size, order=30)


def _strip(curves: Curves, now: float) -> str:
    """Returns HTML of a strip of the states over time, in their colours, with slips and a mark at `now` [s]."""
    most = 200  # changes of the state, and slips, that are drawn
    begin, end = curves.times[0], curves.times[-1]
    changes = [k for k, state in enumerate(curves.states) if k == 0 or state != curves.states[k - 1]]
    changes = changes[:: max(1, -(-len(changes) // most))]
    ends = [share(time, begin, end) for time in (*(curves.times[k] for k in changes), end)]
    spans = [f"{STATES[curves.states[k]]} {ends[i]} {ends[i + 1]}" for i, k in enumerate(changes)]
    names = " ".join(f'<span style="color:{color}">&#9632; {name}</span>' for name, color in STATES.items())
    slips = [slip for slip in curves.slips if slip[1] >= begin][-most:]
    marks = "".join(
        f'<div title="slips" style="position:absolute;bottom:-.2em;height:.4em;min-width:3px;background:{SLIP};'
        f'left:{share(first, begin, end)};width:{share(begin + last - max(first, begin), begin, end)}"></div>'
        for first, last in slips
    )
    if slips:
        names += f' <span style="color:{SLIP}">&#9632; slips</span>'
    return (
        '<div style="padding:0 .8em"><div style="position:relative;height:.9em;border-radius:.2em;'
        f'background:linear-gradient(to right,{",".join(spans)})"><div style="position:absolute;top:-.15em;'
        f'height:1.2em;width:3px;background:{NOW};left:{share(now, begin, end)}"></div>{marks}</div>'
        f'<div style="font-size:.75em">{names}</div></div>'
    )


def share(time: float, begin: float, end: float) -> str:
    """Returns the position of a time between two others as a CSS percentage."""
    return f"{100 * min(max((time - begin) / max(end - begin, 1e-9), 0.0), 1.0):.2f}%"
