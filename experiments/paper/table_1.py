"""Table I of the paper: how close four exact contacts bring a cube and a cylinder, and how fast.

A 10 cm cube and a cylinder, 10 cm wide and 10 cm high, are seen at a wrong pose: N(0, 2 cm) off along each
axis and turned by 20° about a random axis. Four contacts on different faces, exact in place and normal, then
correct the pose. (Cube: four of six faces. Cylinder: three on the side, 120° apart and each up to 15° off
that, and one on the top.) They are selected in the cloud that the paper's method searches, as the paper did,
so its cost is zero at the truth.

Eight rows are the paper's methods as `handsight.correction.paper` has them, with what the paper printed
beside them; it did not say how far off its starts were (--shift-mm 6 --turn-deg 12 comes near). Four rows are
handsight: its vision prior has the true sigmas (2 cm; 20° about a random axis is 20°/√3 per axis), and its
contacts say 0.1 mm and 0.3°, small because these are exact. All methods get the same starts and contacts.

  its       iterations; a step of any phase counts
  MDTS      mean distance of the corrected contacts to the surface: what a robot can check
  RME       mean distance of the corrected contacts to the points they were selected from: what it cannot
  MAE       angle of the rotation that is left
  seconds   of one correction, its uncertainty included

Four contacts cannot tell everything: a cylinder's spin never, not a slide between two pairs of faces, and
without normals two of six directions. So RME and MAE are given three times: all of the error; modulo the
object's symmetry (the truth moved along it to the nearest); and of that only what contacts can observe: the
error (δp, radius δθ) less the directions that `correct_pose` calls unobservable at the true pose, with the
same kind of contacts. The last is first order: of a turn by 20° along an open direction millimetres stay.
"""

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from testbed import figures, report, scenes
from testbed.report import Array, Row, Rows

SHAPES = CUBE, CYLINDER = "cube", "cylinder"
METHODS = (
    ("GD", "paper-gd-distance", False),
    ("LM", "paper-lm-distance", False),
    ("GD with normals", "paper-gd", True),
    ("LM with normals", "paper-lm", True),
    ("handsight", "handsight", False),
    ("handsight with normals", "handsight", True),
)
"""Label, method of `correct_pose`, whether the contacts have normals."""
COLUMNS = ("its", "mdts_cm", "rme_cm", "mae_deg", "seconds")
PUBLISHED = {
    ("GD", CUBE): (200, 0.197, 0.799, 9.53, 16.21),
    ("GD", CYLINDER): (154, 0.111, 0.265, 4.45, 15.97),
    ("LM", CUBE): (37, 0.113, 1.013, 10.63, 4.99),
    ("LM", CYLINDER): (25, 0.096, 0.420, 5.67, 5.50),
    ("GD with normals", CUBE): (200, 0.140, 0.524, 6.15, 17.46),
    ("GD with normals", CYLINDER): (136, 0.065, 0.088, 0.97, 14.12),
    ("LM with normals", CUBE): (37, 0.033, 0.629, 4.81, 6.33),
    ("LM with normals", CYLINDER): (25, 0.087, 0.324, 4.03, 5.63),
}
SIGMAS = (1e-4, float(np.deg2rad(0.3)))
"""What the exact contacts say of themselves: point [m], normal [rad], per axis."""
LABELS = ("start", *(label for label, *_ in METHODS))
APART = ("start", "LM", "LM with normals", "handsight", "handsight with normals")
"""What the second table has; the figure has all."""
PARTS = ("", "_symmetric", "_observable")
DIGITS = {"its": 0, "mdts_cm": 3, "rme_cm": 3, "mae_deg": 2, "seconds": 2}
PAPER, LEAST = "#c2185b", 1e-4


def trial(model: hs.ObjectModel, scene: scenes.Scene, method: str, normals: bool) -> Row:
    """One correction's numbers, by the names of the CSV file."""
    bare = hs.Contacts(scene.contacts.points_palm, sigma_point=SIGMAS[0])
    contacts, vision = scene.contacts if normals else bare, scene.vision
    estimate, seconds = report.timed(lambda: hs.correct_pose(model, contacts, vision=vision, method=method))
    at_truth = hs.PosePrior.from_sigmas(scene.T_palm_object, 1e-3, 1e-2)
    open_directions = hs.correct_pose(model, contacts, vision=at_truth).unobservable
    return {
        "its": estimate.iterations,
        "mdts_cm": 100 * float(np.abs(estimate.residuals.distance).mean()),
        **errors(model, scene, estimate.T_palm_object, open_directions),
        "open_directions": len(open_directions),
        "seconds": seconds,
        "converged": int(estimate.converged),
        "rejected": len(estimate.outliers),
    }


def errors(model: hs.ObjectModel, scene: scenes.Scene, T_hat: Array, open_directions: Array) -> Row:
    """RME [cm] and MAE [°] of a pose: all, modulo symmetry, and the observable part of that."""
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_hat)
    metres = np.repeat([1.0, model.radius], 3)
    delta = se3.difference(T_hat, T_near) * metres
    seen = delta - open_directions.T @ (open_directions @ delta)
    observed = se3.moved(T_near, seen / metres)
    pairs = (T_hat, scene.T_palm_object), (T_hat, T_near), (observed, T_near)
    found = {}
    for suffix, pair in zip(PARTS, pairs, strict=True):
        distance, turn = scenes.places_apart(scene, *pair)
        found[f"rme_cm{suffix}"] = 100 * distance
        found[f"mae_deg{suffix}"] = float(np.rad2deg(turn))
    return found


def run(options: report.Options, start: scenes.Pair) -> Rows:
    """A row per trial, shape and method, and one per trial and shape for the start itself."""
    rows = []
    for k in report.progress(range(options.trials), "Table I"):
        for s, (shape, model) in enumerate(scenes.table_1_models().items()):
            rng = options.rng(k, s)
            scene = scenes.paper_scene(scenes.on_four_sides(model, rng), rng, start=start, sigmas=SIGMAS)
            key = {"trial": k, "shape": shape}
            before = errors(model, scene, scene.vision.T_palm_object, np.zeros((0, 6)))
            rows.append({**key, "method": "start", "normals": 0, **before, "open_directions": 0})
            for label, method, normals in METHODS:
                answer = trial(model, scene, method, normals)
                rows.append({**key, "method": label, "normals": int(normals), **answer})
    return rows


def values(rows: Rows, shape: str, label: str, name: str) -> Array:
    """(trials,) of one method on one shape."""
    return report.values(rows, name, shape=shape, method=label)


def published(label: str, shape: str) -> dict[str, Any]:
    """What the paper printed, by column; nothing for handsight."""
    return dict(zip(COLUMNS, PUBLISHED.get((label, shape), ("",) * len(COLUMNS)), strict=True))


def summarised(rows: Rows) -> Rows:
    """A row per method and shape for the CSV file: published, mean, standard error, median."""
    names = [name for name in rows[1] if name not in ("trial", "shape", "method", "normals")]
    table = []
    for (label, *_), shape in product(METHODS, SHAPES):
        mine = report.chosen(rows, method=label, shape=shape)
        printed = {f"{name}_published": value for name, value in published(label, shape).items()}
        (found,) = report.grouped(mine, ("method", "shape", "normals"), names)
        table.append(printed | found)
    return table


def print_tables(rows: Rows, trials: int) -> None:
    """The paper's table with its own numbers beside ours, then the errors split."""
    beside = []
    for (label, *_), shape in product(METHODS, SHAPES):
        cells = [label, shape]
        for (name, number), digits in zip(published(label, shape).items(), (1, 3, 2, 2, 3), strict=True):
            cells += [report.plus_minus(values(rows, shape, label, name), digits)]
            cells += [number and f"{number:.{DIGITS[name]}f}"]
        beside.append(cells)
    columns = ["method", "shape"]
    for name in ("its", "MDTS cm", "RME cm", "MAE °", "seconds"):
        columns += [name, "paper"]
    note = f"Mean±standard error over {trials} trials. paper: as published (seconds: MATLAB, 2013)."
    report.print_table("Table I", columns, beside, note)

    apart = []
    for label, shape in product(APART, SHAPES):
        cells = [label, shape, f"{values(rows, shape, label, 'open_directions').mean():.1f}"]
        for name in ("rme_cm", "mae_deg"):
            cells += [report.plus_minus(values(rows, shape, label, name + part)) for part in PARTS]
        apart.append(cells)
    columns = ["method", "shape", "open"]
    columns += [f"{n}\n{part}" for n in ("RME cm", "MAE °") for part in ("all", "mod. sym.", "observable")]
    note = "open: directions of six that the contacts leave open, on average."
    report.print_table("What the contacts can tell", columns, apart, note)


def draw(rows: Rows, path: Path) -> None:
    """Each trial's errors per method on logarithmic axes: all of it, and its observable part."""
    plt = figures.pyplot()
    figure, grid = plt.subplots(2, 2, figsize=(11, 8.6), sharey=True, sharex="col", layout="constrained")
    for panels, shape in zip(grid, SHAPES, strict=True):
        for axes, name, title in zip(panels, ("rme_cm", "mae_deg"), ("RME [cm]", "MAE [°]"), strict=True):
            for y, label in enumerate(LABELS):
                for part, side in (("", -0.2), ("_observable", 0.2)):
                    strip(axes, values(rows, shape, label, name + part), y + side, label, hollow=not part)
                if (label, shape) in PUBLISHED:
                    printed = PUBLISHED[label, shape][COLUMNS.index(name)]
                    axes.plot(printed, y, "D", color=PAPER, markeredgecolor="white", markersize=8, zorder=5)
            axes.set_xscale("log")
            axes.set_yticks(range(len(LABELS)), LABELS)
            axes.set_title(f"{shape}: {title}")
            axes.grid(axis="x", color="0.92")
            axes.set_axisbelow(True)
            axes.set_xlabel(title if shape == CYLINDER else "")
    grid[0, 0].invert_yaxis()
    legend(figure, plt)
    figures.save(figure, path)


def colour(label: str) -> str:
    """Grey for the start, yellow for handsight's results, blue for the paper's methods."""
    if label == "start":
        return figures.INITIAL
    return figures.RESULT if label.startswith("handsight") else "#4878a8"


def strip(axes: Any, errors_: Array, y: float, label: str, *, hollow: bool) -> None:
    """A box of quartiles with whiskers to 5 and 95 %, and every trial as a dot."""
    errors_, color = np.maximum(errors_, LEAST), colour(label)
    jitter = np.random.default_rng(0).uniform(-0.14, 0.14, len(errors_))
    axes.scatter(errors_, y + jitter, s=5, color=color, alpha=0.35, linewidths=0)
    filled = {"facecolor": "none" if hollow else color, "edgecolor": "0.25", "alpha": 0.85}
    plain = {"showfliers": False, "patch_artist": True, "manage_ticks": False, "zorder": 3}
    place = {"positions": [y], "widths": 0.3, "orientation": "horizontal", "whis": (5, 95)}
    axes.boxplot(errors_, **place, boxprops=filled, medianprops={"color": "0.1", "linewidth": 1.6}, **plain)


def legend(figure: Any, plt: Any) -> None:
    """What box, fill and diamond mean, below the panels."""
    patch = plt.matplotlib.patches.Patch
    handles = [
        patch(facecolor="none", edgecolor="0.25", label="all of the error"),
        patch(facecolor="0.5", edgecolor="0.25", label="what contacts observe, modulo symmetry"),
        plt.Line2D([], [], marker="D", color=PAPER, linestyle="none", label="published mean"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)


def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    start: Any = {"type": report.amount, "default": 20.0}
    arguments.add_argument("--shift-mm", **start, help="start, per axis (default: %(default)s)")
    arguments.add_argument("--turn-deg", **start, help="start (default: %(default)s)")
    options, given = report.parsed(arguments, trials=100, quick_trials=12)
    rows = run(options, (given.shift_mm / 1000, np.deg2rad(given.turn_deg)))
    print_tables(rows, options.trials)
    report.write_csv(options.output / "table_1.csv", summarised(rows))
    report.write_csv(options.output / "table_1_trials.csv", rows)
    draw(rows, options.output / "table_1.png")


if __name__ == "__main__":
    main()
