"""Fig. 3 of the paper: an object as measured by vision (grey), its true pose (green), corrected (yellow).

The paper shows Levenberg-Marquardt with normals on simulated data and finds that its result "coincides
almost perfectly" with the truth. Here it is beside handsight, on the same starts and contacts: Table I's,
with 2 cm per axis and 20° of error and four exact contacts. One picture may flatter, so the trial shown is
the one whose error with the paper's method is the median of all, and the table has the mean of all.

`surface` is how far a point of the object's surface is on average from where it truly is, so of everything
that a picture shows; modulo the object's symmetry, so the truth is drawn, too, at the equivalent pose nearest
to the answer. `contacts` is the same of the four points touched (Table I's RME).
"""

from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from testbed import figures, report, scenes
from testbed.report import Array, Row, Rows

METHODS = {"LM with normals (paper)": "paper-lm", "handsight": "handsight"}
SIGMAS = (1e-4, float(np.deg2rad(0.3)))
"""What the exact contacts say of themselves: point [m], normal [rad], per axis."""
SHOWN = 1200
ERRORS = {"surface_cm": "surface cm", "contacts_cm": "contacts cm", "turn_deg": "turn °"}
COLOURS, WIDTHS = (figures.INITIAL, figures.TRUTH, figures.RESULT), (1.6, 4.5, 1.8)


def scene_of(options: report.Options, k: int, s: int, model: hs.ObjectModel) -> scenes.Scene:
    """Trial k of shape s."""
    rng = options.rng(k, s)
    return scenes.paper_scene(scenes.on_four_sides(model, rng), rng, sigmas=SIGMAS)


def errors_cm(model: hs.ObjectModel, scene: scenes.Scene, T_hat: Array) -> Row:
    """Mean error [cm] of the surface and of the contacts' points, and turn [°], modulo symmetry."""
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_hat)
    surface, _ = model.sample(SHOWN)
    moved = np.linalg.norm(se3.apply(T_hat, surface) - se3.apply(T_near, surface), axis=1)
    contacts, turn = scenes.contact_errors(model, scene, T_hat)
    errors = 100 * float(moved.mean()), 100 * contacts, float(np.rad2deg(turn))
    return dict(zip(ERRORS, errors, strict=True))


def corrected(model: hs.ObjectModel, scene: scenes.Scene, label: str) -> Array:
    """The answer of one of the methods."""
    vision, method = scene.vision, METHODS[label]
    return hs.correct_pose(model, scene.contacts, vision=vision, method=method).T_palm_object


def run(options: report.Options) -> Rows:
    """A row per trial, shape and method, the start among them."""
    rows = []
    for k in report.progress(range(options.trials), "corrections"):
        for s, (shape, model) in enumerate(scenes.table_1_models().items()):
            scene = scene_of(options, k, s, model)
            answers = {"start": scene.vision.T_palm_object}
            answers |= {label: corrected(model, scene, label) for label in METHODS}
            for label, T in answers.items():
                rows.append({"trial": k, "shape": shape, "method": label, **errors_cm(model, scene, T)})
    return rows


def summarised(rows: Rows) -> Rows:
    """A row per shape and method: mean, standard error and median of all trials, and the trial shown.

    Shown is the trial in the middle of the paper's method's errors.
    """
    table = []
    for shape in scenes.table_1_models():
        by_error = sorted(report.chosen(rows, shape=shape, method=next(iter(METHODS))), key=_surface)
        shown = by_error[(len(by_error) - 1) // 2]["trial"]
        for line in report.grouped(report.chosen(rows, shape=shape), ("shape", "method"), ERRORS):
            (row,) = report.chosen(rows, shape=shape, method=line["method"], trial=shown)
            table.append(line | {"shown_trial": shown} | {f"{name}_shown": row[name] for name in ERRORS})
    return table


def _surface(row: Row) -> float:
    return float(row["surface_cm"])


def print_table(table: Rows, trials: int) -> None:
    """Mean, median and what is shown, of each error."""
    cells = []
    for row in table:
        line = [row["shape"], row["method"]]
        for name in ERRORS:
            line.append(f"{row[f'{name}_mean']:.3f}±{row[f'{name}_se']:.3f}")
            line += [f"{row[f'{name}_{of}']:.4f}" for of in ("median", "shown")]
        cells.append(line)
    columns = ["shape", "method"]
    for title in ERRORS.values():
        columns += [title, "median", "shown"]
    note = f"Mean±standard error, and median, over {trials} trials; shown: of the trial in the figure."
    report.print_table("Distance from the truth, modulo symmetry", columns, cells, note)


def draw(options: report.Options, table: Rows, path: Path) -> None:
    """Three clouds a panel: a row per shape, a column per method."""
    plt = figures.pyplot()
    figure = plt.figure(figsize=(10, 9.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, wspace=0.06, hspace=0.05)
    for s, (shape, model) in enumerate(scenes.table_1_models().items()):
        for m, label in enumerate(METHODS):
            (row,) = report.chosen(table, shape=shape, method=label)
            scene = scene_of(options, row["shown_trial"], s, model)
            axes = figure.add_subplot(grid[s, m], projection="3d")
            draw_clouds(axes, model, scene, corrected(model, scene, label))
            off = 10 * row["surface_cm_shown"]
            axes.set_title(f"{shape}, {label}\nsurface off by {off:.2g} mm on average", y=1.0)
    styles = zip(("initial", "truth", "corrected"), COLOURS, WIDTHS, strict=True)
    handles = [plt.Line2D([], [], color=color, linewidth=1.4 * w, label=text) for text, color, w in styles]
    handles.append(plt.Line2D([], [], marker="x", linestyle="none", color="k", markersize=8, label="contact"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    figures.save(figure, path)


def draw_clouds(axes: Any, model: hs.ObjectModel, scene: scenes.Scene, T_result: Array) -> None:
    """Clouds with outlines; green is drawn wider, so that yellow upon it shows where they coincide."""
    cloud, normals = model.sample(SHOWN)
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_result)
    poses = (scene.vision.T_palm_object, T_near, T_result)
    figures.frame_3d(axes, np.vstack([se3.apply(T, cloud) for T in poses]))
    axes.computed_zorder = False
    for k, (T, color, width) in enumerate(zip(poses, COLOURS, WIDTHS, strict=True)):
        front = figures.faces_viewer(axes, normals @ T[:3, :3].T)
        points = se3.apply(T, cloud[front])
        axes.scatter(*points.T, s=3 * width, color=color, linewidths=0, depthshade=False, zorder=k)
        for line in figures.outline(model):
            axes.plot(*se3.apply(T, line).T, color=color, linewidth=width, zorder=10 + k)
    axes.plot(*scene.contacts.points_palm.T, "x", color="k", markersize=10, markeredgewidth=2.2, zorder=20)


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=100, quick_trials=15)
    table = summarised(run(options))
    print_table(table, options.trials)
    report.write_csv(options.output / "figure_3.csv", table)
    draw(options, table, options.output / "figure_3.png")


if __name__ == "__main__":
    main()
