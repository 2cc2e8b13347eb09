"""Figures of objects found in pictures: outlines over colour or depth, the hand tinted, and residuals of the depth.

They need matplotlib.
"""

import textwrap
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handsight.camera import Depth
from handsight.recording.detections import Located, LocatedAll
from handsight.recording.frames import Frame
from handsight.viewer.correction_figures import new_figure, save
from handsight.viewer.shapes import grey, silhouette

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = "#ffb300", "#00b8d4", "#e91e63", "#7cb342", "#8e5cd9", "#ff7043", "#26a69a", "#5c6bc0"
"""Of the objects in a picture, one after another."""
HAND = "#2d8cff"
MOST = 15  # residual at the ends of the colours [mm]


def draw_located(rows: Sequence[Located | LocatedAll], path: Path) -> None:
    """Writes a row for each picture to an image file: the picture with the poses, and the residuals of its depth.
    Raises MissingExtra, HandsightError."""
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


def _draw_image(axes: "Axes", frame: Frame) -> None:
    """Draws a picture, the hand in it tinted."""
    from matplotlib.colors import to_rgb

    image = grey(frame.depth) if frame.color is None else frame.color / 255
    if frame.hand is not None and frame.hand.any():
        image = np.where(frame.hand[..., None], (image + to_rgb(HAND)) / 2, image)
        axes.plot([], [], color=HAND, label="hand, masked")
    axes.imshow(image, interpolation="nearest")


def _draw_poses(axes: "Axes", found: Sequence[Located]) -> Depth:
    """Draws the outline of each object at its best pose; returns the depth (h, w) of all of them [m]."""
    depths = []
    for each, color in zip(found, cycle(COLORS), strict=False):
        depth = silhouette(each.frame.camera, each.model, each.found.Ts_camera_object[0])
        depths.append(depth)
        if np.isfinite(depth).any():
            axes.contour(np.isfinite(depth), [0.5], colors=[color])
        axes.plot([], [], color=color, label=f"{each.model.name or 'object'} {each.found.probability:.2f}")
    nearest: Depth = np.min(depths, axis=0)
    return nearest


def _residual(axes: "Axes", frame: Frame, drawn: Depth) -> None:
    """Draws the measured depth less the depth `drawn` (h, w) of the objects, around them; grey where the hand is."""
    axes.set(title="measured depth less the best pose's", facecolor="lightgrey")
    inside = np.isfinite(drawn)
    if not inside.any():
        return
    known = inside & np.isfinite(frame.depth) & (frame.depth > 0)
    if frame.hand is not None:
        known &= ~frame.hand
    off = np.full(drawn.shape, np.nan)
    off[known] = 1000 * (frame.depth[known] - drawn[known])
    shown = axes.imshow(off, cmap="RdBu", vmin=-MOST, vmax=MOST, interpolation="nearest")
    rows, columns = np.nonzero(inside)
    around = 10  # pixels
    axes.set(xlim=(columns.min() - around, columns.max() + around))
    axes.set(ylim=(rows.max() + around, rows.min() - around))
    bar = axes.figure.colorbar(shown, ax=axes, extend="both")
    bar.set_label("nearer  ←  [mm]  →  farther")
