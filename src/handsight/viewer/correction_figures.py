"""Figures of corrections: the object before and after, contacts, and the directions that touch leaves open.

They need matplotlib.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PosePrior
from handsight.errors import HandsightError, needing
from handsight.files import write_errors
from handsight.objects import ObjectModel
from handsight.viewer.shapes import creases, direction_line, middle

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D


class CorrectionPanel(NamedTuple):
    """A `CorrectionPanel` is a correction problem and its answer."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    answer: dict[str, Any]  # in the form of the answers of `handsight correct`


def new_figure(width: float = 1, height: float = 1) -> "Figure":
    """Returns an empty figure of that size [in], which needs no screen; raises MissingExtra where matplotlib is absent.

    Without pyplot, which reads files of styles when it loads.
    """
    with needing("plotting needs matplotlib", "plot"):
        from matplotlib import artist
    # It writes a page of documentation for each of its classes when it loads, which takes a third of that time.
    documented, artist.kwdoc = artist.kwdoc, lambda artist: ""
    try:
        from matplotlib.figure import Figure
    finally:
        artist.kwdoc = documented
    return Figure((width, height), layout="constrained")


def draw_corrections(panels: Sequence[CorrectionPanel], path: Path) -> None:
    """Writes the panels to an image file; raises MissingExtra, HandsightError."""
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = new_figure(5.6 * columns, 5.4 * rows)
    for i, panel in enumerate(panels):
        _draw(figure.add_subplot(rows, columns, i + 1, projection="3d"), panel)
    save(figure, path)


def save(figure: "Figure", path: Path) -> None:
    """Writes a figure with one legend to an image file, whose suffix is its format; raises HandsightError."""
    legends = [axes.get_legend_handles_labels() for axes in figure.axes]
    labelled = {label: handle for legend in legends for handle, label in zip(*legend, strict=True)}
    below: Any = {"loc": "outside lower center", "ncols": min(len(labelled), 7), "frameon": False}
    figure.legend(labelled.values(), labelled, **below)
    with write_errors(path):
        try:
            figure.savefig(path, dpi=130)
        except ValueError as error:
            raise HandsightError(f"{path}: {error}") from None


def _draw(axes: "Axes3D", panel: CorrectionPanel) -> None:
    """Draws a problem and its answer in the palm's frame."""
    model, answer, red, blue = panel.model, panel.answer, "#c2185b", "#1565c0"
    T = se3.from_position_quaternion(answer["position"], answer["quaternion_xyzw"])
    shown = [draw_object(axes, model, T, "#e0a100", "corrected")]
    if panel.vision is not None:
        shown.append(draw_object(axes, model, panel.vision.T_palm_object, "0.55", "vision"))
    points, normals = panel.contacts.points_palm, panel.contacts.normals_palm
    arrow = 0.22 * model.diameter
    outliers = np.isin(np.arange(len(points)), answer["outliers"])
    axes.scatter(*points[~outliers].T, color=red, s=28, depthshade=False, label="contact, its normal")
    if outliers.any():
        axes.scatter(*points[outliers].T, color="k", marker="x", s=50, depthshade=False, label="rejected")
    axes.quiver(*points.T, *(arrow * normals).T, color=red, linewidth=1.4)
    # Directions that touch leaves open: a double arrow for a slide, an arc with one arrowhead for a turn.
    center = middle(model, T)
    for k, direction in enumerate(answer["unobservable"]):
        line, turn = direction_line(np.asarray(direction), center, model)
        axes.plot(*line.T, color=blue, linewidth=2.2, label=None if k else "open to touch")
        ends = [(line[-2], 4 * (line[-1] - line[-2]))] if turn else [(center, end - center) for end in line]
        for start, shift in ends:
            axes.quiver(*start, *shift, color=blue, linewidth=2.2, arrow_length_ratio=1.0 if turn else 0.12)
    # Equal limits around everything, and labels in millimetres.
    everything = np.vstack([*shown, points])
    low, high = everything.min(axis=0), everything.max(axis=0)
    half = (high - low).max() / 2
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=22, azim=-58)
    for name, value in zip("xyz", (low + high) / 2, strict=True):
        axes.set(**{f"{name}lim": (value - half, value + half)})
        axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(lambda value, _: f"{1000 * value:.0f}")
        axis.set_tick_params(labelsize=7)
        axis.set_label_text(f"palm {name} [mm]", fontsize=8)
    fit = "fits" if answer["consistent"] else "does NOT fit"
    axes.set_title(f"{model.name or 'object'}: {len(points)} contacts, {fit}", fontsize=11)


def draw_object(axes: "Axes3D", model: ObjectModel, T_palm_object: Array, color: str, label: str) -> Array:
    """Draws the object's sharp edges and points of its surface; returns the points (n, 3) in the palm [m]."""
    cloud, _ = model.sample(900)
    cloud = se3.apply(T_palm_object, cloud)
    axes.scatter(*cloud.T, s=1.6, color=color, alpha=0.45, depthshade=False)
    segments = se3.apply(T_palm_object, creases(model).reshape(-1, 3)).reshape(-1, 2, 3)
    if len(segments):  # matplotlib refuses an empty collection
        from mpl_toolkits.mplot3d.art3d import Line3DCollection

        axes.add_collection3d(Line3DCollection(segments, colors=color, linewidths=1.3))
    axes.plot([], [], [], color=color, linewidth=3, label=label)
    return cloud
