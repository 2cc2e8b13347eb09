"""What stands beside the scene: the state and its reason, the camera's image, how errors went, what is shown."""

import base64
import html
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight.checks import Array
from handsight.tracking import State
from handsight.viewer.curves import Curves
from handsight.viewer.moment import Moment
from handsight.viewer.picture import jpeg
from handsight.viewer.scene import LAYERS
from handsight.viewer.sentence import sentence
from handsight.vision.pixels import Color

if TYPE_CHECKING:
    from viser import GuiApi


STATES: dict[State, str] = {"tracking": "#2e7d32", "uncertain": "#c77800", "lost": "#b71c1c"}
SIGMA, ERROR, NOW, SLIP = "#1565c0", "#d81b60", "#111111", "#6a1b9a"
MOST_CHANGES = 200
"""Of the state, that are drawn."""
STATUS, CONTROLS, STRIP, CURVES, IMAGE, SHOWN = range(0, 60, 10)
"""Places in the panel, from its top."""


class Panel:
    """A `Panel` is the control panel of a page."""

    def __init__(
        self, gui: "GuiApi", title: str, layers: dict[str, bool], redraw: Callable[[], None]
    ) -> None:
        """`gui`: viser's, of the server; `layers`: which are wanted, changed in place before `redraw` is called."""
        from viser import uplot

        self._gui, self._title, self._uplot = gui, title, uplot
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self.status = gui.add_html("", order=STATUS)
        gui.add_html(_legend(), order=STATUS + 1)
        self.strip = gui.add_html("", order=STRIP)
        self.curves: Any = None
        self.image = gui.add_html("", order=IMAGE)
        with gui.add_folder("What is shown", order=SHOWN, expand_by_default=False):
            for name, (label, _) in LAYERS.items():
                self._box(name, label, layers, redraw)

    def _box(self, name: str, label: str, layers: dict[str, bool], redraw: Callable[[], None]) -> None:
        box = self._gui.add_checkbox(label, layers[name])

        def chosen(_: object) -> None:
            layers[name] = box.value
            redraw()

        box.on_update(chosen)

    def draw(self, moment: Moment, forces: dict[str, Array]) -> None:
        """Says how it is at a moment."""
        color = STATES[moment.state]
        _, _, why = sentence(moment).partition(": ")
        fingers = "".join(_chips(moment, forces))
        self.status.content = (
            f'<div style="padding:0 .8em;font-size:.86em;line-height:1.4">'
            f'<div style="color:#666">{html.escape(self._title)} · {moment.stamp:.2f} s</div>'
            f'<div><b style="color:{color}">{moment.state.upper()}</b> {html.escape(why)}</div>'
            f'<div style="margin:.3em 0">{fingers}</div></div>'
        )

    def draw_image(self, image: Color) -> None:
        """Shows an image."""
        # viser's own element encodes it in five times the time.
        data = base64.b64encode(jpeg(image)).decode()
        self.image.content = (
            '<div style="padding:0 .8em"><img alt="camera" style="width:100%;border-radius:.3em" '
            f'src="data:image/jpeg;base64,{data}"></div>'
        )

    def draw_curves(self, curves: Curves, now: float) -> None:
        """Plots curves, with a mark at a time [s] of theirs."""
        if len(curves.times) < 2:
            return
        self.strip.content = _strip(curves, now)
        marked = np.full(len(curves.times), np.nan)
        k = int(np.searchsorted(curves.times, now, side="right")) - 1
        marked[max(k, 0)] = curves.sigmas[max(k, 0)]
        lines = [(curves.sigmas, "σ [mm]", SIGMA)]
        if curves.errors is not None:
            lines.append((curves.errors, "error [mm]", ERROR))
        data = (curves.times, *(values for values, _, _ in lines), marked)
        if self.curves is not None and len(self.curves.series) == len(data):
            self.curves.data = data
            return
        if self.curves is not None:
            self.curves.remove()
        series = [self._uplot.Series(label=label, stroke=color, width=2) for _, label, color in lines]
        dot = self._uplot.Series_Points(show=True, size=11, fill=NOW, stroke=NOW)
        self.curves = self._gui.add_uplot(
            data,
            (self._uplot.Series(label="time [s]"), *series, self._uplot.Series(label="now", points=dot)),
            scales={"x": self._uplot.Scale(time=False), "y": self._uplot.Scale(distr=3)},
            height=200,
            padding=(12, 16, 0, 0),
            order=CURVES,
        )


def _chips(moment: Moment, forces: dict[str, Array]) -> Iterator[str]:
    """Yields a label for each finger: how hard it is pushed, or why it has no contact."""
    touching, wrong = moment.fingertips.fingers, moment.outliers
    for name in (*touching, *moment.fingertips.reasons):
        color, label = "#9e9e9e", moment.fingertips.reasons.get(name, "")
        if name in touching:
            color = "#222" if name in wrong else "#c2185b"
            label = f"{np.linalg.norm(forces[name]):.1f} N" if name in forces else "touches"
            label = f"{label}, rejected" if name in wrong else label
        yield (
            f'<span style="display:inline-block;background:{color};color:#fff;border-radius:.7em;'
            f'padding:0 .6em;margin:0 .3em .2em 0"><b>{html.escape(name)}</b> {html.escape(label)}</span>'
        )


def _legend() -> str:
    dots = "".join(
        f'<span style="white-space:nowrap;margin-right:.9em"><span style="color:rgb{color}">&#9679;</span> '
        f"{html.escape(label)}</span> "
        for label, color in LAYERS.values()
    )
    return f'<div style="padding:0 .8em;color:#555;font-size:.74em">{dots}</div>'


def _strip(curves: Curves, now: float) -> str:
    """Returns the states over time in their colours, with a mark."""
    begin, end = curves.times[0], curves.times[-1]
    changes = [k for k, state in enumerate(curves.states) if k == 0 or state != curves.states[k - 1]]
    changes = changes[:: max(1, -(-len(changes) // MOST_CHANGES))]
    ends = [*(curves.times[k] for k in changes[1:]), end]
    spans = [
        f"{STATES[curves.states[k]]} {share(curves.times[k], begin, end)} {share(until, begin, end)}"
        for k, until in zip(changes, ends, strict=True)
    ]
    names = " ".join(f'<span style="color:{color}">&#9632; {name}</span>' for name, color in STATES.items())
    slips = [slip for slip in curves.slips if slip[1] >= begin][-MOST_CHANGES:]
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
    """Returns the place of a time between two others, as CSS has it."""
    return f"{100 * min(max((time - begin) / max(end - begin, 1e-9), 0.0), 1.0):.2f}%"
