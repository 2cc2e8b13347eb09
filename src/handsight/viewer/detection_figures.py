"""Figures of objects found in pictures: outlines over colour or depth, the hand tinted, and residuals of the depth.

They need matplotlib.
"""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from handsight import se3
from handsight.camera import Depth
from handsight.checks import Array
from handsight.recording.detections import Located, LocatedAll
from handsight.recording.frames import Frame
from handsight.viewer.correction_figures import new_figure, save
from handsight.viewer.shapes import creases, grey, silhouette

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = "#ffb300", "#00b8d4", "#e91e63", "#7cb342", "#8e5cd9", "#ff7043", "#26a69a", "#5c6bc0"
"""Of the objects in a picture, one after another."""
BEST, HAND = COLORS[0], np.array([0.15, 0.55, 1.0])
ASPECT = 1.35  # width of the part of a picture that is shown, relative to its height


def draw_located(rows: Sequence[Located | LocatedAll], path: Path) -> None:
    """Writes a row for each picture to an image file: the picture with the poses, and the residuals of its depth.
    Raises MissingExtra, HandsightError."""
    figure = new_figure(11.5, 4.6 * len(rows) + 0.5)
    axes = figure.subplots(len(rows), 2, squeeze=False, width_ratios=[1.5, 1])
    for (left, right), row in zip(axes, rows, strict=True):
        _draw(left, right, row)
    save(figure, path)


def _draw(left: "Axes", right: "Axes", row: Located | LocatedAll) -> None:
    """Draws a picture with its poses on the left; on the right residuals, or the reason why there is no pose."""
    frame, scores = row.frame, ""
    each: list[Located] = [row] if isinstance(row, Located) else row.instances
    if isinstance(row, Located) and row.recognition is not None:
        likeliest = list(row.recognition.scores.items())[:3]
        shares = [*likeliest, ("none", row.recognition.none)]
        scores = "\n" + ", ".join(f"{label} {share:.2f}" for label, share in shares)
    image = grey(frame.depth) if frame.color is None else frame.color / 255
    if frame.hand is not None:
        image = np.where(frame.hand[..., None], 0.55 * image + 0.45 * HAND, image)
    left.imshow(image, interpolation="nearest")
    for axes in (left, right):
        axes.set(xticks=[], yticks=[])
    if row.reason is not None:
        one = isinstance(row, Located) and row.recognition is None
        text = f"{each[0].model.name or 'object'} is not here" if one else "none of them is here"
        left.set_title(f"{frame.name}: {text}{scores}", fontsize=11)
        reason = textwrap.fill(row.reason, 45)
        right.text(0.5, 0.5, reason, ha="center", va="center", transform=right.transAxes)
        right.set_frame_on(False)
        return
    if isinstance(row, Located):
        likely = row.found.weights[1:2].sum() >= 0.01
        poses = [(row, T) for T in row.found.Ts_camera_object[: 2 if likely else 1]]
        styles = [(BEST, "-", "best pose"), ("#00b8d4", "--", "second")]
    else:
        poses = [(one, one.found.Ts_camera_object[0]) for one in each]
        names = [f"{one.model.name} {one.found.probability:.2f}" for one in each]
        styles = [(COLORS[k % len(COLORS)], "-", name) for k, name in enumerate(names)]
    for color, style, label in styles[: len(poses)]:
        left.plot([], [], color=color, linestyle=style, lw=2.5, label=label)
    if frame.hand is not None and frame.hand.any():
        left.plot([], [], color=HAND, lw=6, alpha=0.6, label="hand, masked")
    for (one, T), (color, style, _) in reversed([*zip(poses, styles, strict=False)]):
        _outline(left, one, T, color, style)
    alone = [silhouette(frame.camera, one.model, one.found.Ts_camera_object[0]) for one in each]
    drawn: Depth = np.min(alone, axis=0)
    rows, columns = np.nonzero(np.isfinite(drawn))
    if len(rows):  # the picture is limited to the object and its surroundings
        height, width = drawn.shape
        across = max(float(np.ptp(rows)), float(np.ptp(columns)) / ASPECT, 60.0)
        tall = min(max((1 + 2 * 0.35) * across, 0.45 * height), height, width / ASPECT)
        sides = np.array([ASPECT * tall, tall])
        middle = np.array([columns.min() + columns.max(), rows.min() + rows.max()]) / 2
        low = np.clip(middle - sides / 2, -0.5, np.array([width, height]) - 0.5 - sides)
        left.set(xlim=(low[0], low[0] + sides[0]), ylim=(low[1] + sides[1], low[1]))
    _residual(right, frame, drawn)
    if isinstance(row, Located):
        x, y, z = ((1e3 * row.found.Ts_camera_object[0, :3, 3]).round() + 0.0).tolist()  # no -0
        place = f"{row.model.name or 'object'} at {x:.0f}, {y:.0f}, {z:.0f} mm"
        place += f", weight {row.found.weights[0]:.2f}"
    else:
        place = f"{len(each)} object{'s' * (len(each) > 1)}"
    left.set_title(f"{frame.name}: {place}{scores}", fontsize=11)


def _outline(axes: "Axes", row: Located, T: Array, color: str, style: str) -> None:
    """Draws the silhouette's outline and the visible edges of the object at T_camera_object (4, 4)."""
    from matplotlib.colors import to_rgba

    drawn = silhouette(row.frame.camera, row.model, T)
    inside = np.isfinite(drawn)
    if not inside.any():
        return
    axes.contour(inside, [0.5], colors=[color], linewidths=1.8, linestyles=style)
    if style == "-":
        tint = np.zeros((*inside.shape, 4))
        tint[inside] = to_rgba(color, 0.22)
        axes.imshow(tint, interpolation="nearest")
    edges = creases(row.model)
    # Shorter ones are noise of a scan.
    long = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1) > 0.04 * row.model.diameter
    lines = se3.apply(T, edges[long].reshape(-1, 3)).reshape(-1, 2, 3)
    lines = lines[(lines[..., 2] > 0).all(axis=1)][:2000]
    pixels = row.frame.camera.project(lines.reshape(-1, 3)).reshape(-1, 2, 2)
    # An edge is visible if its middle is in the image, and at most 4 mm behind the surface drawn around it.
    middles = np.nan_to_num(pixels.mean(axis=1), nan=-1).round()
    shown = ((middles >= 0) & (middles < inside.shape[::-1])).all(axis=1)
    columns, rows = middles[shown].astype(int).T
    padded = np.pad(np.where(inside, drawn, -np.inf), 1, constant_values=-np.inf)
    surface = sliding_window_view(padded, (3, 3))[rows, columns].max(axis=(1, 2))
    visible = lines[shown, :, 2].mean(axis=1) < surface + 0.004
    for line in pixels[shown][visible]:
        axes.plot(*line.T, color=color, lw=0.9)


def _residual(axes: "Axes", frame: Frame, drawn: Depth) -> None:
    """Draws the measured depth less the depth `drawn` (h, w) of the object, around it."""
    inside = np.isfinite(drawn)
    axes.set_title("measured depth less the best pose's", fontsize=10)
    known = inside & np.isfinite(frame.depth) & (frame.depth > 0)
    if not inside.any():
        return
    off = np.full(drawn.shape, np.nan)
    off[known] = 1e3 * (frame.depth[known] - drawn[known])
    axes.set_facecolor("0.85")
    most = 15.0  # [mm], at the ends of the colours
    shown = axes.imshow(off, cmap="RdBu", vmin=-most, vmax=most, interpolation="nearest")
    if frame.hand is not None:
        before = np.zeros((*drawn.shape, 4))
        before[frame.hand & (off < -most)] = *HAND, 1.0
        axes.imshow(before, interpolation="nearest")
    axes.contour(inside, [0.5], colors=[BEST], linewidths=1.5)
    rows, columns = np.nonzero(inside)
    low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()])
    around = 0.12 * max((high - low).max(), 20.0)
    axes.set(xlim=(low[0] - around, high[0] + around), ylim=(high[1] + around, low[1] - around))
    bar = axes.figure.colorbar(shown, ax=axes, shrink=0.8, extend="both")
    bar.set_label("nearer  ←  [mm]  →  farther", fontsize=9)
