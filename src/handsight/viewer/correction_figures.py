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
from handsight.files import binary_file
from handsight.objects import ObjectModel
from handsight.viewer.shapes import creases, middle, open_direction

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D


MM = 1000  # in a metre


class CorrectionPanel(NamedTuple):
    """A correction problem and its answer."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    answer: dict[str, Any]  # in the form of the answers of `handsight correct`


def new_figure(width: float = 1, height: float = 1) -> "Figure":
    """Returns an empty figure of that size [in], which needs no screen; raises MissingExtra where matplotlib is absent.

    Without pyplot, which reads files of styles when it loads.
    """
    with needing("plotting needs matplotlib", "plot"):
        from matplotlib.figure import Figure
    return Figure((width, height), layout="constrained")


def draw_corrections(panels: Sequence[CorrectionPanel], path: Path) -> None:
    """Writes the panels to an image file; raises MissingExtra, HandsightError."""
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = new_figure(6 * columns, 6 * rows)
    for i, panel in enumerate(panels):
        _draw(figure.add_subplot(rows, columns, i + 1, projection="3d"), panel)
    save(figure, path)


def save(figure: "Figure", path: Path) -> None:
    """Writes a figure with one legend to an image file, whose suffix is its format; raises HandsightError."""
    labelled = dict[str, Any]()
    for axes in figure.axes:
        labelled |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    handles = list(labelled.values())
    labels = list(labelled)
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 7))
    with binary_file(path) as file:
        try:
            figure.savefig(file, dpi=130, format=path.suffix[1:] or None)
        except ValueError as error:
            raise HandsightError(f"{path}: {error}") from None


def _draw(axes: "Axes3D", panel: CorrectionPanel) -> None:
    """Draws a problem and its answer in the palm's frame [mm]."""
    model = panel.model
    answer = panel.answer
    red, blue = "#c2185b", "#1565c0"
    T = se3.from_position_quaternion(answer["position"], answer["quaternion_xyzw"])
    _draw_object(axes, model, T, "#e0a100", "corrected")
    if panel.vision is not None:
        _draw_object(axes, model, panel.vision.T_palm_object, "grey", "vision")
    points = MM * panel.contacts.points_palm
    arrows = MM / 5 * model.diameter * panel.contacts.normals_palm
    outliers = np.isin(np.arange(len(points)), answer["outliers"])
    axes.scatter(*points[~outliers].T, color=red, depthshade=False, label="contact, its normal")
    if outliers.any():
        axes.scatter(*points[outliers].T, color="k", marker="x", depthshade=False, label="rejected")
    axes.quiver(*points.T, *arrows.T, color=red)
    # Directions that touch leaves open: two arrows for a slide, an arc with a dot at its end for a turn.
    center = middle(model, T)
    for direction in answer["unobservable"]:
        straight, arc = open_direction(np.asarray(direction), center, model)
        starts, ends = MM * straight.swapaxes(0, 1)
        axes.quiver(*starts.T, *(ends - starts).T, color=blue, linewidth=2)
        axes.plot(*(MM * arc).T, color=blue, linewidth=2, marker="o", markevery=[-1], label="open to touch")
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.set(xlabel="palm x [mm]", ylabel="palm y [mm]", zlabel="palm z [mm]")
    fit = "fits" if answer["consistent"] else "does NOT fit"
    axes.set_title(f"{model.name or 'object'}: {len(points)} contacts, {fit}")


def _draw_object(axes: "Axes3D", model: ObjectModel, T_palm_object: Array, color: str, label: str) -> None:
    """Draws the object's sharp edges, and points of its surface."""
    cloud, _ = model.sample(900)
    cloud = MM * se3.apply(T_palm_object, cloud)
    axes.scatter(*cloud.T, s=2, color=color, alpha=0.5, depthshade=False)
    segments = MM * se3.apply(T_palm_object, creases(model).reshape(-1, 3)).reshape(-1, 2, 3)
    if len(segments):  # matplotlib refuses an empty collection
        from mpl_toolkits.mplot3d.art3d import Line3DCollection

        axes.add_collection3d(Line3DCollection(segments, colors=color))
    axes.plot([], [], [], color=color, label=label)
