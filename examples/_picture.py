"""What the examples share: pictures, which are saved in output/."""

import sys
from pathlib import Path
from types import ModuleType

import numpy as np

from handsight import se3


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


def bodies(title: str, model, poses: dict, points, normals, clouds: dict | None = None) -> None:
    """Draws a model's edges at its poses (by label), contacts with normals, and clouds (by label), in the palm [m]."""
    if (plt := pyplot()) is None:
        return
    figure = plt.figure(figsize=(7, 6.4), layout="constrained")
    axes = figure.add_subplot(projection="3d", title=title, xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    colors = iter(["#808080", "#e0a100", "#1565c0", "#2e7d32", "#8e24aa", "#00838f"])
    for label, T_palm_object in poses.items():
        color = next(colors)
        for k, ends in enumerate(1e3 * se3.apply(T_palm_object, edges(model))):
            axes.plot(*ends.T, color=color, label=label if k == 0 else None)
    for label, cloud in (clouds or {}).items():
        axes.plot(*(1e3 * np.asarray(cloud)).T, ".", color=next(colors), markersize=4, alpha=0.6, label=label)
    starts = 1e3 * np.asarray(points)
    axes.plot(*starts.T, "o", color="#c2185b", label="contact, its normal")
    axes.set_aspect("equal")
    length = 0.2 * np.ptp(axes.get_zlim())
    axes.quiver(*starts.T, *(length * np.asarray(normals)).T, color="#c2185b")
    axes.legend(loc="upper left")
    save(plt)


def edges(model) -> np.ndarray:
    """Returns the edges of a model's mesh at which its surface bends by 30 degrees or more, (n, 2, 3)."""
    if model is None:
        return np.empty((0, 2, 3))
    faces = np.asarray(model.faces)
    corners = np.asarray(model.vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sides: dict[tuple, list] = {}
    for face, normal, places in zip(faces, normals, corners, strict=True):
        for i, j in ((0, 1), (1, 2), (2, 0)):
            sides.setdefault(tuple(sorted((face[i], face[j]))), []).append((normal, places[[i, j]]))
    bent = [
        side[0][1] for side in sides.values() if len(side) < 2 or side[0][0] @ side[1][0] < np.cos(np.pi / 6)
    ]
    return np.array(bent)


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
