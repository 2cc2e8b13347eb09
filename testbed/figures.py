"""Parts of figures: matplotlib without a screen, colours, axes in centimetres, views of a simulated grasp."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from testbed import report
from testbed.report import Array

INITIAL, TRUTH, RESULT = "0.6", "#2e9e4f", "#e6b400"
"""The colours of the paper's figure 3: grey, green, yellow."""


def pyplot() -> Any:
    """Returns matplotlib's pyplot on a backend that needs no screen; exits with a message where it is absent."""
    try:
        import matplotlib
    except ImportError:
        raise SystemExit("figures need matplotlib: pip install 'handsight[plot]'") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 9, "axes.titlesize": 10, "axes.spines.top": False})
    plt.rcParams.update({"axes.spines.right": False, "legend.frameon": False})
    return plt


def save(figure: Any, path: Path) -> None:
    """Writes the figure as PNG, closes it, and prints the file's name."""
    figure.savefig(path, dpi=140)
    pyplot().close(figure)
    report.wrote(path)


def shares(values: Array) -> tuple[Array, Array]:
    """Returns a cumulative distribution: the values in order, and the share that is not above each."""
    return np.sort(values), np.arange(1, len(values) + 1) / len(values)


def frame_3d(axes: Any, points: Array, view: tuple[float, float] = (22, -58)) -> None:
    """Sets equal scales around points (n, 3) [m], with few ticks in centimetres."""
    from matplotlib.ticker import MaxNLocator

    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, 0.5 * (high - low).max()
    for name, center in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{name}lim")(center - half, center + half)
        axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(lambda value, _: f"{100 * value:.0f}")
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(labelsize=7, pad=-1)
        axis.set_label_text(f"palm {name} [cm]", fontsize=8)
        axis.labelpad = -3
    axes.grid(False)
    axes.set_box_aspect((1, 1, 1))
    axes.view_init(elev=view[0], azim=view[1])


def outline(model: hs.ObjectModel) -> list[Array]:
    """Returns the edges of a box or the rims of a cylinder, as polylines (k, 3) in the object's frame [m]."""
    low, high = model.bounds_object
    if model.symmetries.axes:
        angle = np.linspace(0, 2 * np.pi, 73)
        rim = high[0] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return [np.column_stack([rim, np.full(len(rim), z)]) for z in (low[2], high[2])]
    corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
    pairs = itertools.combinations(range(8), 2)
    return [corners[[i, j]] for i, j in pairs if (corners[i] != corners[j]).sum() == 1]


def faces_viewer(axes: Any, normals: Array) -> Array:
    """Returns whether surfaces with these normals (n, 3) face the viewer of axes that `frame_3d` has set, (n,)."""
    elevation, azimuth = np.deg2rad([axes.elev, axes.azim])
    toward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return np.asarray(normals @ np.array(toward) > 0)


def legend_below(figure: Any, axes: Any, columns: int) -> None:
    """Adds the legend of some axes below the figure."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
