"""A search by touch as a picture: the table from above before and after each touch, and how the belief narrows."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from handsight import se3
from handsight.checks import Array
from handsight.search.belief import CERTAINTY, Belief
from handsight.viewer.correction_figures import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHOWN = 60  # particles whose outlines are drawn
PINK, BLUE, GREY = "#c2185b", "#1565c0", "0.55"


def draw_search(name: str, beliefs: Sequence[Belief], T_world_object: Array, path: Path) -> None:
    """Writes the beliefs of a search, the one before the first touch first, and the truth (4, 4) to an image file.
    Raises MissingExtra, HandsightError."""
    columns = min(4, len(beliefs) + 1)
    rows = -(-(len(beliefs) + 1) // columns)
    figure = new_figure(3.3 * columns, 3.4 * rows + 0.5)
    places = list(figure.subplots(rows, columns, squeeze=False).flat)
    for place in places[len(beliefs) + 1 :]:
        place.set_axis_off()
    for place, belief in zip(places, beliefs, strict=False):
        _draw_table(place, belief, T_world_object)
    # How the likeliest mode's standard deviations fall over the touches, and its certainty rises.
    axes, best = places[len(beliefs)], [belief.modes[0] for belief in beliefs]
    touches = range(len(best))
    axes.semilogy(touches, [1e3 * mode.sigma_position for mode in best], "o-", color=PINK, ms=4)
    axes.semilogy(touches, [np.rad2deg(mode.sigma_yaw) for mode in best], "s-", color=BLUE, ms=4)
    axes.text(0.03, 0.04, "position ± mm", color=PINK, transform=axes.transAxes, fontsize=9)
    axes.text(0.03, 0.12, "yaw ± °", color=BLUE, transform=axes.transAxes, fontsize=9)
    axes.set(xticks=touches, ylim=(0.5, 200), yticks=[1, 2, 5, 10, 20, 50, 100])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_xlabel("touches", fontsize=8)
    axes.tick_params(labelsize=7, which="both")
    certain = axes.twinx()
    certain.plot(touches, [mode.certainty for mode in best], "-", color="black", lw=1)
    certain.axhline(CERTAINTY.probability, color=GREY, lw=0.8, ls=":")
    certain.set(ylim=(0, 1.02))
    certain.tick_params(labelsize=7)
    axes.set_title("the likeliest pose\nblack: probability within 8 mm and 8°", fontsize=9)
    found = "found" if best[-1].is_certain else "not found yet"
    figure.suptitle(f"{name}: {found} after {len(touches) - 1} touches (from above)")
    save(figure, path)


def _draw_table(axes: "Axes", belief: Belief, T_world_object: Array) -> None:
    """Draws a belief, the path of the finger that led to it, and the truth, from above [mm]."""
    best, area = belief.modes[0], belief.area
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * (area.high - area.low) + area.low
    axes.plot(*(1e3 * corners.T), ":", color=GREY, lw=1, label="searched area (middles)")
    some = belief.Ts_world_object[:: max(len(belief.placements) // SHOWN, 1)]
    for k, T in enumerate(some):
        label = None if k else "believed poses"
        axes.plot(*_outline(belief, T), color=BLUE, lw=0.8, alpha=0.15, label=label)
    if belief.touches:
        axes.plot(*_outline(belief, best.pose_world_object.T_a_b), color=PINK, lw=1.6, label="likeliest")
    axes.plot(*_outline(belief, T_world_object), "--", color="black", lw=1.2, label="truth")
    title = "before the first touch"
    if belief.touches:
        touch = belief.touches[-1]
        title = f"touch {len(belief.touches)}: " + ("a miss" if touch.contact_world is None else "a contact")
        axes.plot(*(1e3 * touch.free_world[:, :2].T), color="#2e7d32", lw=2, label="path of the finger")
        if touch.contact_world is not None:
            place, way = (1e3 * touch.contact_world.points_palm[0], 45 * touch.contact_world.normals_palm[0])
            axes.plot(*place[:2], "o", color="#e0a100", ms=6, label="contact, its normal")
            arrow = {"arrowstyle": "->", "color": "#e0a100"}
            axes.annotate("", (place + way)[:2], place[:2], arrowprops=arrow)
    half = 1e3 * (max(abs(area.low).max(), abs(area.high).max()) + belief.model.radius)
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    axes.set_xlabel("world x [mm]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.set_title(f"{title}\nwithin 8 mm and 8°: {best.certainty:.2f}", fontsize=9)


def _outline(belief: Belief, T_world_object: Array) -> Array:
    """Returns the closed outline (2, n) of the object from above at a pose (4, 4) [mm]."""
    from scipy.spatial import ConvexHull

    flat = 1e3 * se3.apply(T_world_object, belief.model.vertices)[:, :2]
    around = ConvexHull(flat).vertices
    return np.asarray(flat[[*around, around[0]]].T)
