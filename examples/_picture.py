"""What the examples share: pictures of bodies in the palm's frame, and of curves over time, saved in output/."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np


def pyplot() -> ModuleType | None:
    """Returns matplotlib's pyplot; None, and a line that says so, where it is absent."""
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        print("no picture: pip install 'handsight[plot]'")
        return None
    return plt


def save(plt: ModuleType) -> None:
    """Saves the figure as output/EXAMPLE.png, and shows it where there is a screen."""
    path = Path("output") / f"{Path(sys.argv[0]).stem}.png"
    path.parent.mkdir(exist_ok=True)
    plt.savefig(path, dpi=110)
    print("picture:", path)
    plt.show()  # does nothing without a screen


def bodies(title: str, clouds: dict, points=None, normals=None) -> None:
    """Draws clouds ((n, 3) by label, the palm's frame [m]) and contacts with their normals."""
    if (plt := pyplot()) is None:
        return
    colors = ["#808080", "#e0a100", "#1565c0", "#2e7d32", "#8e24aa", "#00838f"]
    figure = plt.figure(figsize=(7, 6.4), layout="constrained")
    axes = figure.add_subplot(projection="3d", title=title, xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    for color, (label, cloud) in zip(colors, clouds.items(), strict=False):
        axes.plot(*(1e3 * np.asarray(cloud)).T, ".", color=color, markersize=2.5, alpha=0.5, label=label)
    if points is not None:
        axes.plot(*(1e3 * np.asarray(points)).T, "o", color="#c2185b", label="contact, its normal")
        starts, ways = 1e3 * np.asarray(points), 25 * np.asarray(normals)
        axes.quiver(*starts.T, *ways.T, color="#c2185b")
    axes.set_aspect("equal")
    axes.legend(loc="upper left", markerscale=3)
    save(plt)


def over_time(title: str, seconds, curves: dict, sigma=None, unit: str = "mm") -> None:
    """Draws curves by label over time, the first one with a band of one sigma."""
    if (plt := pyplot()) is None:
        return
    axes = plt.subplots(figsize=(8, 4.2), layout="constrained")[1]
    for color, (label, values) in zip(["#e0a100", "#808080", "#1565c0"], curves.items(), strict=False):
        axes.plot(seconds, values, color=color, label=label)
    if sigma is not None:
        first = np.asarray(next(iter(curves.values())))
        low, high = np.maximum(first - sigma, 0), first + np.asarray(sigma)
        axes.fill_between(seconds, low, high, color="#e0a100", alpha=0.25, label="± one sigma")
    axes.set(title=title, xlabel="time [s]", ylabel=f"[{unit}]")
    axes.legend()
    save(plt)
