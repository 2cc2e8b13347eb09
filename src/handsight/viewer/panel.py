"""The panel beside the scene: the state and its reason, the camera's image, curves of the errors, choice of layers."""

import base64
import html
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from handsight.checks import Array
from handsight.errors import printable
from handsight.objects import ObjectModel
from handsight.viewer.moment import Curves, Moment
from handsight.viewer.picture import jpeg
from handsight.viewer.scene import LAYERS
from handsight.viewer.shapes import SLIP, STATES

if TYPE_CHECKING:
    from viser import GuiApi, GuiCheckboxHandle

CURVES = {"error [mm]": "#d81b60"} | {f"σ {state} [mm]": color for state, color in STATES.items()}
CURVES |= {"slips": SLIP, "now": "#808080"}
"""What is plotted over time, with its colour. The error and now are lines, as what is not known is drawn far below."""
CONTROLS = 10  # position of a player's controls in the panel: after the status, 0, before the curves, 30


class Panel:
    """The control panel of a page."""

    def __init__(
        self,
        gui: "GuiApi",
        model: ObjectModel,
        title: str,
        layers: dict[str, bool],
        redraw: Callable[[], None],
    ) -> None:
        """Adds the panel to viser's `gui`; a person's choice changes `layers` in place and calls `redraw`."""
        self._model = model
        self._title = title
        self._layers = layers
        self._redraw = redraw
        gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        self.status = gui.add_html("", order=0)
        legend = ""
        for label, rgb in LAYERS.values():
            dot = f'<span style="color:rgb{rgb}">&#9679;</span>'
            name = f'<span style="opacity:.75">{label}</span>'
            legend += f'<span style="white-space:nowrap;margin-right:.9em">{dot} {name}</span> '
        gui.add_html(f'<div style="padding:0 .8em;font-size:.74em">{legend}</div>', order=1)
        series: list[dict[str, Any]] = [{"label": "time [s]"}]
        for name, color in CURVES.items():
            line = name in ("error [mm]", "now")
            points = {"show": not line, "size": 9 if name == "slips" else 4, "fill": color}
            series.append({"label": name, "stroke": color, "width": 2 if line else 0, "points": points})
        scales = {"x": {"time": False}, "y": {"distr": 3}}
        plain = {"ticks": {"show": False}, "labelSize": 18}
        axes = (
            {"label": "time [s]", "size": 30} | plain,
            {"label": "position: error, σ [mm]"} | plain,
        )
        style = {"scales": scales, "axes": axes, "height": 240, "padding": (12, 16, 0, 0), "order": 30}
        self.curves: Any = gui.add_uplot((np.zeros(1),) * len(series), tuple(series), **style, visible=False)
        self.image = gui.add_html("", order=40)
        self._drawn: object = None  # the picture on the page, and the layers of its outlines
        with gui.add_folder("What is shown", order=50, expand_by_default=False):
            for name, (label, _) in LAYERS.items():
                box = gui.add_checkbox(label, layers[name])
                box.on_update(lambda _, name=name, box=box: self._choose(name, box))

    def _choose(self, name: str, box: "GuiCheckboxHandle") -> None:
        self._layers[name] = box.value
        self._redraw()

    def draw(self, moment: Moment, forces: dict[str, Array], time: float) -> None:
        """Writes the time since the origin [s], the state, why, and each finger's force, or why it has no contact."""
        labels = ""
        for name in moment.fingertips.fingers:
            label = f"{np.linalg.norm(forces[name]):.1f} N" if name in forces else "touches"
            rejected = name in moment.outliers
            labels += _pill("#222", name, f"{label}, rejected") if rejected else _pill("#c2185b", name, label)
        for name, reason in moment.fingertips.reasons.items():
            labels += _pill("#757575", name, reason)
        if moment.skin.bears:
            labels += _pill("#c2185b", "skin", "touches")
        self.status.content = (
            f'<div style="padding:0 .8em;font-size:.86em;line-height:1.4">'
            f'<div style="opacity:.75">{html.escape(printable(self._title))} · '
            f'<span title="stamp {moment.stamp:.6f} s">{time:.2f} s</span></div>'
            f'<div><b style="color:{STATES[moment.state]}">{moment.state.upper()}</b> '
            f"{html.escape(printable(moment.why))}</div>"
            f'<div style="margin:.3em 0">{labels}</div></div>'
        )

    def draw_image(self, moment: Moment) -> None:
        """Draws the moment's image with the outlines of vision's pose and of the corrected one."""
        shown = moment.picture
        drawn = shown, dict(self._layers)
        if shown is None or drawn == self._drawn:
            return
        self._drawn = drawn
        outlines = {}
        # Vision's pose was brought into the palm by the calibrated camera; the same brings it back.
        for name, known, T_camera_palm in (
            ("vision", moment.vision, shown.T_camera_palm_calibrated),
            ("object", moment.estimate, shown.T_camera_palm),
        ):
            if known is not None and T_camera_palm is not None and self._layers[name]:
                outlines[LAYERS[name][1]] = T_camera_palm @ known.T_palm_object
        # viser's own element takes five times as long to encode it.
        data = base64.b64encode(jpeg(shown.with_outlines(self._model, outlines))).decode()
        self.image.content = (
            '<div style="padding:0 .8em"><img alt="camera" style="width:100%;border-radius:.3em" '
            f'src="data:image/jpeg;base64,{data}"></div>'
        )

    def draw_curves(self, curves: Curves, now: float) -> None:
        """Plots curves, with a mark at one of their times [s]."""
        times = curves.times
        if len(times) < 2:
            return
        where = [curves.states == state for state in STATES]
        where.append(curves.slipping)
        where.append(np.arange(len(times)) == np.searchsorted(times[1:], now, side="right"))
        self.curves.data = (times, curves.errors, *np.where(where, curves.sigmas, np.nan))
        self.curves.visible = True


def _pill(color: str, name: str, label: str) -> str:
    return (
        f'<span style="display:inline-block;background:{color};color:#fff;border-radius:.7em;'
        f'padding:0 .6em;margin:0 .3em .2em 0"><b>{html.escape(name)}</b> {html.escape(label)}</span>'
    )
