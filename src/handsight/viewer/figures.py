"""One figure each of corrections, of detections and of a track. They need matplotlib."""

import textwrap
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from handsight import se3
from handsight.camera import Depth
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import PosePrior
from handsight.correction.estimate import point_uncertainty
from handsight.errors import HandsightError, needing
from handsight.files import binary_file
from handsight.objects import ObjectModel
from handsight.viewer.shapes import SLIP, STATES, grey, middle, open_direction, silhouette

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

    from handsight.evaluation import Truths
    from handsight.recording.detections import Located, LocatedAll
    from handsight.recording.frames import Frame
    from handsight.tracking.replay import Step

MM = 1000  # in a metre
AMBER, PINK, BLUE = "#e0a100", "#c2185b", "#1565c0"
MAX_FACES = 20_000  # of an object that is drawn with its surface; matplotlib takes seconds for more
FOUND = AMBER, "#00b8d4", "#e91e63", "#7cb342", "#8e5cd9", "#ff7043", "#26a69a", "#5c6bc0"
"""Colours of the objects in a picture, one after another."""
HAND = "#2d8cff"
MOST = 15  # residual at the ends of the colours [mm]


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


def save(figure: "Figure", path: Path) -> None:
    """Writes a figure with one legend to an image file, whose suffix is its format; raises HandsightError."""
    labelled = dict[str, Any]()
    for axes in figure.axes:
        labelled |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    handles = list(labelled.values())
    labels = list(labelled)
    columns = 7 if max(map(len, labels), default=0) < 20 else 4
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), columns))
    with binary_file(path) as file:
        try:
            figure.savefig(file, dpi=130, format=path.suffix[1:] or None)
        except ValueError as error:
            raise HandsightError(f"{path}: {error}") from None


def draw_corrections(panels: Sequence[CorrectionPanel], path: Path) -> None:
    """Writes the object before and after corrections, its contacts, and the directions that touch leaves open, to an
    image file; raises MissingExtra, HandsightError."""
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = new_figure(6 * columns, 6 * rows)
    for i, panel in enumerate(panels):
        _draw(figure.add_subplot(rows, columns, i + 1, projection="3d"), panel)
    save(figure, path)


def _draw(axes: "Axes3D", panel: CorrectionPanel) -> None:
    """Draws a problem and its answer in the palm's frame [mm]."""
    model = panel.model
    answer = panel.answer
    axes.computed_zorder = False  # contacts and arrows are drawn over the objects
    T = se3.from_position_quaternion(answer["position"], answer["quaternion_xyzw"])
    if panel.vision is not None:
        _draw_object(axes, model, panel.vision.T_palm_object, "grey", "vision")
    _draw_object(axes, model, T, AMBER, "corrected")
    points = MM * panel.contacts.points_palm
    arrows = MM / 5 * model.diameter * panel.contacts.normals_palm
    outliers = np.isin(np.arange(len(points)), answer["outliers"])
    axes.scatter(*points[~outliers].T, color=PINK, depthshade=False, label="contact, its normal")
    if outliers.any():
        axes.scatter(*points[outliers].T, color="k", marker="x", depthshade=False, label="rejected")
    axes.quiver(*points.T, *arrows.T, color=PINK)
    # Directions that touch leaves open: two arrows for a slide, an arc with a dot at its end for a turn.
    center = middle(model, T)
    for direction in answer["unobservable"]:
        straight, arc = open_direction(np.asarray(direction), center, model)
        starts, ends = MM * straight.swapaxes(0, 1)
        axes.quiver(*starts.T, *(ends - starts).T, color=BLUE, linewidth=2)
        axes.plot(*(MM * arc).T, color=BLUE, linewidth=2, marker="o", markevery=[-1], label="open to touch")
    axes.set_aspect("equal")
    axes.locator_params(nbins=5)
    axes.set(xlabel="palm x [mm]", ylabel="palm y [mm]", zlabel="palm z [mm]")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.labelpad = 7
    fit = "fits" if answer["consistent"] else "does NOT fit"
    axes.set_title(f"{model.name or 'object'}: {len(points)} contacts, {fit}")


def _draw_object(axes: "Axes3D", model: ObjectModel, T_palm_object: Array, color: str, label: str) -> None:
    """Draws the object's surface, or points of it."""
    axes.plot([], [], [], color=color, label=label)
    if 0 < len(model.faces) <= MAX_FACES:
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        triangles = MM * se3.apply(T_palm_object, model.vertices)[model.faces]
        axes.add_collection3d(Poly3DCollection(triangles, facecolors=color, alpha=0.3, shade=True))
        return
    cloud = MM * se3.apply(T_palm_object, model.sample(2000)[0])
    axes.scatter(*cloud.T, s=2, color=color, alpha=0.5, depthshade=False)


def draw_located(rows: "Sequence[Located | LocatedAll]", path: Path) -> None:
    """Writes a row for each picture to an image file: the picture with the outlines of what was found, and the
    residuals of its depth. Raises MissingExtra, HandsightError."""
    from handsight.recording.detections import Located

    figure = new_figure(12, 5 * len(rows))
    axes = figure.subplots(len(rows), 2, squeeze=False, width_ratios=[3, 2])
    for (left, right), row in zip(axes, rows, strict=True):
        left.set(xticks=[], yticks=[], title=row.frame.name)
        right.set(xticks=[], yticks=[])
        _draw_image(left, row.frame)
        if row.reason is None:
            found = [row] if isinstance(row, Located) else row.instances
            _residual(right, row.frame, _draw_poses(left, found))
        else:
            reason = textwrap.fill(f"not here: {row.reason}", 45)
            right.text(0.5, 0.5, reason, ha="center", va="center", transform=right.transAxes)
            right.set_frame_on(False)
    save(figure, path)


def _draw_image(axes: "Axes", frame: "Frame") -> None:
    """Draws a picture, the hand in it tinted."""
    from matplotlib.colors import to_rgb

    image = grey(frame.depth) if frame.color is None else frame.color / 255
    if frame.hand is not None and frame.hand.any():
        image = np.where(frame.hand[..., None], (image + to_rgb(HAND)) / 2, image)
        axes.plot([], [], color=HAND, label="hand, masked")
    axes.imshow(image, interpolation="nearest")


def _draw_poses(axes: "Axes", found: "Sequence[Located]") -> Depth:
    """Draws the outline of each object at its best pose; returns the depth (h, w) of all of them [m]."""
    depths = []
    for each, color in zip(found, cycle(FOUND), strict=False):
        depth = silhouette(each.frame.camera, each.model, each.found.Ts_camera_object[0])
        depths.append(depth)
        if np.isfinite(depth).any():
            axes.contour(np.isfinite(depth), [0.5], colors=[color])
        name = each.model.name or "object"
        axes.plot([], [], color=color, label=f"{name}, probability {each.found.probability:.2f}")
    nearest: Depth = np.min(depths, axis=0)
    return nearest


def _residual(axes: "Axes", frame: "Frame", drawn: Depth) -> None:
    """Draws the measured depth less the depth `drawn` (h, w) of the objects, around them; grey where the hand is."""
    axes.set(title="measured depth less the best pose's", facecolor="lightgrey")
    inside = np.isfinite(drawn)
    if not inside.any():
        return
    known = inside & np.isfinite(frame.depth) & (frame.depth > 0)
    if frame.hand is not None:
        known &= ~frame.hand
    off = np.full(drawn.shape, np.nan)
    off[known] = MM * (frame.depth[known] - drawn[known])
    shown = axes.imshow(off, cmap="RdBu", vmin=-MOST, vmax=MOST, interpolation="nearest")
    rows, columns = np.nonzero(inside)
    around = 10  # pixels
    axes.set(xlim=(columns.min() - around, columns.max() + around))
    axes.set(ylim=(rows.max() + around, rows.min() - around))
    bar = axes.figure.colorbar(shown, ax=axes, extend="both")
    bar.set_label("nearer  ←  [mm]  →  farther")


def draw_track(name: str, model: ObjectModel, steps: "Sequence[Step]", truths: "Truths", path: Path) -> None:
    """Writes x, y and z of the object's middle over time, as in figure 8 of the paper: by vision, tracked, and true, to
    an image file; raises MissingExtra, HandsightError."""
    figure = new_figure(9, 9)
    begin = steps[0].stamp
    times = np.array([step.stamp - begin for step in steps])
    axes = figure.subplots(4, 1, sharex=True, height_ratios=[6, 6, 6, 1])
    curves = _curves(model, steps, truths)
    for plot, axis, (tracked, vision, true, sigma) in zip(axes, "xyz", curves, strict=False):
        plot.fill_between(times, tracked - sigma, tracked + sigma, color="#f0c5d6", label="tracked, ± 1 σ")
        plot.plot(times, vision, "o", mfc="none", mec="grey", ms=4, label="vision")
        plot.plot(times, tracked, color=PINK, label="tracked")
        known = np.flatnonzero(np.isfinite(true))[::10]
        plot.plot(times[known], true[known], "k.", ms=4, label="truth")
        # The limits ignore sigma: vision's alone would flatten everything else.
        drawn = np.concatenate([tracked, vision, true])
        plot.set_ylim(np.nanmin(drawn) - 1, np.nanmax(drawn) + 1)
        plot.grid(visible=True)
        plot.set_ylabel(f"{axis} [cm]")
    for state, color in STATES.items():
        here = [step.state == state for step in steps]
        axes[3].plot(times[here], np.zeros(sum(here)), "s", ms=9, color=color, label=state)
    axes[3].set(yticks=[], ylabel="state", xlabel="time [s]")
    for first, last in _slips(steps):
        for plot in axes:
            plot.axvspan(first - begin, last - begin, color=SLIP, alpha=0.25, label="slips")
    world = any(step.T_world_palm is not None for step in steps)
    axes[0].set_title(f"{name}: the object's middle in the {'world' if world else 'palm'}'s frame")
    save(figure, path)


def _curves(model: ObjectModel, steps: "Sequence[Step]", truths: "Truths") -> Array:
    """Returns (3, 4, n) [cm] for x, y, z: the middle as tracked, by vision and true, and the tracked one's sigma; NaN
    where it is not known."""
    curves = np.full((3, 4, len(steps)), np.nan)
    center = model.center_object
    for i, step in enumerate(steps):
        T_world_palm = np.eye(4) if step.T_world_palm is None else step.T_world_palm
        poses = step.estimate.T_palm_object, step.T_palm_object_vision, truths.at(step.stamp)
        for k, T_palm_object in enumerate(poses):
            if T_palm_object is not None:
                curves[:, k, i] = 100 * middle(model, T_world_palm @ T_palm_object)
        R = T_world_palm[:3, :3]
        variance = (R @ point_uncertainty(step.estimate, model, center)[0] @ R.T).diagonal()
        curves[:, 3, i] = 100 * np.sqrt(variance.clip(min=0.0))
    return curves


def _slips(steps: "Sequence[Step]") -> list[tuple[float, float]]:
    """Returns the first and the last stamp of each time that the object slipped [s]."""
    found: dict[float, float] = {}
    for step in steps:
        if step.slip.slipping:
            found[step.slip.began] = step.stamp
    return list(found.items())
