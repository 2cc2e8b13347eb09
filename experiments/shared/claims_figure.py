"""The figure of `claims.py`, with a panel or two for each claim."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from shared import figures, report
from testbed.report import Rows

COLOURS = ("#4878a8", "#c2185b", "#8f5fb8")


def draw(measured: Mapping[str, Rows], path: Path) -> None:
    """Writes the six panels."""
    figure, panels = figures.pyplot().subplots(2, 3, figsize=(14.5, 8.6), layout="constrained")
    draw_edges(panels[0, 0], measured["edges"])
    lengths = {"rme_mm": "RME [mm]", "distance_mm": "distance left [mm]"}
    angles = {"mae_deg": "MAE [°]", "normal_deg": "normals' angle left [°]"}
    draw_weights(panels[0, 1], measured["w_n"], lengths)
    draw_weights(panels[0, 2], measured["w_n"], angles)
    draw_minima(panels[1, 0], measured["minima"])
    draw_speed(panels[1, 1], measured["speed"], "evaluate", "points in the cloud")
    draw_speed(panels[1, 2], measured["speed"], "rotate", "points rotated")
    titles = (
        "a  contacts on the wrong face of a box",
        "b  LM with normals: distances",
        "b  LM with normals: angles",
        "c  error at the paper's minima",
        "d  one evaluation of the cost",
        "d  one rotation",
    )
    for axes, title in zip(panels.flat, titles, strict=True):
        axes.set_title(title, loc="left")
        axes.set_axisbelow(True)
    figure.get_layout_engine().set(wspace=0.05, hspace=0.06)
    figures.save(figure, path)


def draw_edges(axes: Any, rows: Rows) -> None:
    """Draws bars with standard errors for each method, near an edge and far from all edges."""
    table = report.grouped(rows, ("near_edge", "method"), ("wrong_face",))
    for near, label, color, shift in (
        (1, "1-5 mm from an edge", "#c2185b", -0.2),
        (0, "over 15 mm from any", "0.65", 0.2),
    ):
        chosen = report.chosen(table, near_edge=near)
        mean, error = (report.values(chosen, f"wrong_face_{n}") for n in ("mean", "se"))
        x = np.arange(len(chosen)) + shift
        axes.bar(x, mean, 0.38, yerr=error, color=color, capsize=3, label=label)
    names = [row["method"].replace(" with", "\nwith").replace(" (paper)", "") for row in chosen]
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("share of contacts")
    axes.legend(title="contacts")
    axes.grid(axis="y", color="0.92")


def draw_weights(axes: Any, rows: Rows, names: Mapping[str, str]) -> None:
    """Draws means with standard errors over w_n: the error solid, its observable part dashed."""
    table = report.grouped(rows, ("shape", "w_n_cm"), names)
    for shape, color in zip(("cube", "cylinder"), COLOURS, strict=False):
        chosen = report.chosen(table, shape=shape)
        for (name, label), line in zip(names.items(), ("-", "--"), strict=True):
            columns = (report.values(chosen, key) for key in ("w_n_cm", f"{name}_mean", f"{name}_se"))
            style = {"color": color, "linestyle": line, "marker": "o", "markersize": 4, "capsize": 3}
            axes.errorbar(*columns, **style, label=f"{shape}: {label}")
    axes.set(xscale="log", yscale="log", xlabel="w_n [cm]", ylabel=" / ".join(names.values()))
    axes.set_ylim(top=2.2 * axes.get_ylim()[1])  # room for the legend
    plain(axes)
    ticks = report.distinct(rows, "w_n_cm")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.grid(color="0.92")
    axes.legend(fontsize=7.5, loc="upper right", ncols=2, columnspacing=0.8)


def plain(axes: Any) -> None:
    """Sets plain numbers at 1, 2 and 5 on logarithmic axes."""
    from matplotlib.ticker import LogLocator

    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 1000 * low else (1,)))
        axis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()


def draw_minima(axes: Any, rows: Rows) -> None:
    """Draws each grasp's error at the cheapest minimum over that at the nearest, worse above the diagonal."""
    for shape, color in zip(("box", "can"), COLOURS, strict=False):
        for part, filled, label in (("_symmetric", True, "modulo symmetry"), ("", False, "as it is")):
            x, y = (report.values(rows, f"{n}{part}_mm", object=shape) for n in ("nearest", "cheapest"))
            style = {"facecolors": color if filled else "none", "edgecolors": color, "alpha": 0.7, "s": 26}
            axes.scatter(x, y, **style, label=f"{shape}, {label}")
    axes.set(xscale="log", yscale="log")
    limits = axes.get_xlim() + axes.get_ylim()
    low, high = min(limits), max(limits)
    axes.plot([low, high], [low, high], color="0.7", zorder=0)
    plain(axes)
    axes.set(xlabel="nearest to the initial estimate: error [mm]", ylabel="of least cost: error [mm]")
    axes.set_ylim(low, 12 * high)  # room for the legend
    axes.legend(fontsize=8, loc="upper center", ncols=2)


def draw_speed(axes: Any, rows: Rows, task: str, xlabel: str) -> None:
    """Draws medians with quartiles over the number of points."""
    chosen = report.chosen(rows, task=task)
    for way, color in zip(report.distinct(chosen, "way"), COLOURS, strict=False):
        columns = ("points", "q25_us", "median_us", "q75_us")
        points, low, middle, high = (report.values(chosen, key, way=way) for key in columns)
        axes.fill_between(points, low, high, color=color, alpha=0.2, linewidth=0)
        axes.plot(points, middle, "o-", color=color, markersize=4, label=way)
    axes.set(xscale="log", yscale="log", xlabel=xlabel, ylabel="time [µs], median and quartiles")
    plain(axes)
    axes.grid(color="0.92")
    axes.legend(fontsize=8)
