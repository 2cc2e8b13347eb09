"""Fig. 3 of the paper: an object where it was seen (grey), where it is (green), corrected (yellow).

The paper shows Levenberg-Marquardt with normals on simulated data and finds that its result "coincides
almost perfectly" with the truth. Here it is beside handsight, on the same starts and contacts: Table I's,
with 2 cm per axis and 20° of error and four exact contacts. One picture may flatter, so the trial shown is
the one whose error with the paper's method is the median of all, and the table has the mean of all.

`surface` is how far a point of the object's surface is on average from where it truly is, so of everything
that a picture shows; modulo the object's symmetry, so the truth is drawn, too, at the equivalent pose nearest
to the answer. `contacts` is the same of the four points touched (Table I's RME).
"""

import numpy as np

import handsight as hs
import report
import scenes
from handsight import se3

METHODS = {"LM with normals (paper)": "paper-lm", "handsight": "handsight"}
SIGMAS = (1e-4, np.deg2rad(0.3))
"""What the exact contacts say of themselves: point [m], normal [rad], per axis."""
SHOWN = 1200
COLOURS, WIDTHS = (report.INITIAL, report.TRUTH, report.RESULT), (1.6, 4.5, 1.8)


def scene_of(options, k, s, model):
    """Trial k of shape s."""
    rng = options.rng(k, s)
    return scenes.displaced(*scenes.on_four_sides(model, rng), rng, sigmas=SIGMAS)


def errors_cm(model, scene, T_hat):
    """Mean error [cm] of the surface and of the contacts' points, and turn [°], modulo symmetry."""
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_hat)
    surface, _ = model.sample(SHOWN)
    moved = np.linalg.norm(se3.apply(T_hat, surface) - se3.apply(T_near, surface), axis=1)
    contacts, turn = scenes.contact_errors(model, scene, T_hat)
    return {
        "surface_cm": 100 * float(moved.mean()),
        "contacts_cm": 100 * contacts,
        "turn_deg": float(np.rad2deg(turn)),
    }


def run(options, models):
    """A row per trial, shape and method, the start among them."""
    rows = []
    for k in report.progress(range(options.trials), "corrections"):
        for s, (shape, model) in enumerate(models.items()):
            scene = scene_of(options, k, s, model)
            answers = {"start": scene.vision.T_palm_object}
            for label, method in METHODS.items():
                estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision, method=method)
                answers[label] = estimate.T_palm_object
            for label, T in answers.items():
                rows.append({"trial": k, "shape": shape, "method": label, **errors_cm(model, scene, T)})
    return rows


def median_trial(rows, shape):
    """The trial in the middle of the paper's method's errors."""
    label = next(iter(METHODS))
    chosen = [row for row in rows if (row["shape"], row["method"]) == (shape, label)]
    return sorted(chosen, key=lambda row: row["surface_cm"])[(len(chosen) - 1) // 2]["trial"]


def summarised(rows, models):
    """A row per shape and method: mean, standard error and median of all trials, and the trial shown."""
    table = []
    for shape in models:
        shown = median_trial(rows, shape)
        for label in ("start", *METHODS):
            chosen = [row for row in rows if (row["shape"], row["method"]) == (shape, label)]
            line = {"shape": shape, "method": label, "shown_trial": shown}
            for name in ("surface_cm", "contacts_cm", "turn_deg"):
                values = np.array([row[name] for row in chosen])
                line[f"{name}_mean"], line[f"{name}_se"] = report.summary(values)
                line[f"{name}_median"] = float(np.median(values))
                line[f"{name}_shown"] = next(row[name] for row in chosen if row["trial"] == shown)
            table.append(line)
    return table


def print_table(table, trials):
    """Mean, median and what is shown, of each error."""
    cells = []
    for row in table:
        line = [row["shape"], row["method"]]
        for name in ("surface_cm", "contacts_cm", "turn_deg"):
            mean, error = row[f"{name}_mean"], row[f"{name}_se"]
            line.append(f"{mean:.3f}±{error:.3f}")
            line += [f"{row[f'{name}_{of}']:.4f}" for of in ("median", "shown")]
        cells.append(line)
    columns = ["shape", "method"]
    for name in ("surface cm", "contacts cm", "turn °"):
        columns += [name, "median", "shown"]
    note = f"Mean±standard error, and median, over {trials} trials; shown: of the trial in the figure."
    report.print_table("Distance from the truth, modulo symmetry", columns, cells, note)


def draw(options, models, table, path):
    """Three clouds a panel: a row per shape, a column per method."""
    plt = report.pyplot()
    figure = plt.figure(figsize=(10, 9.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, wspace=0.06, hspace=0.05)
    for s, (shape, model) in enumerate(models.items()):
        for m, (label, method) in enumerate(METHODS.items()):
            row = next(r for r in table if (r["shape"], r["method"]) == (shape, label))
            scene = scene_of(options, row["shown_trial"], s, model)
            estimate = hs.correct_pose(model, scene.contacts, vision=scene.vision, method=method)
            axes = figure.add_subplot(grid[s, m], projection="3d")
            draw_clouds(axes, model, scene, estimate.T_palm_object)
            off = 10 * row["surface_cm_shown"]
            axes.set_title(f"{shape}, {label}\nsurface off by {off:.2g} mm on average", y=1.0)
    styles = zip(("initial", "truth", "corrected"), COLOURS, WIDTHS, strict=True)
    handles = [plt.Line2D([], [], color=color, linewidth=1.4 * w, label=text) for text, color, w in styles]
    handles.append(plt.Line2D([], [], marker="x", linestyle="none", color="k", markersize=8, label="contact"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    report.save_figure(figure, path)


def draw_clouds(axes, model, scene, T_result):
    """Clouds with outlines; green is drawn wider, so that yellow upon it shows where they coincide."""
    cloud, normals = model.sample(SHOWN)
    T_near = scenes.nearest_truth(model, scene.T_palm_object, T_result)
    poses = (scene.vision.T_palm_object, T_near, T_result)
    report.frame_3d(axes, np.vstack([se3.apply(T, cloud) for T in poses]))
    axes.computed_zorder = False
    for k, (T, color, width) in enumerate(zip(poses, COLOURS, WIDTHS, strict=True)):
        front = report.faces_viewer(axes, normals @ T[:3, :3].T)
        points = se3.apply(T, cloud[front])
        axes.scatter(*points.T, s=3 * width, color=color, linewidths=0, depthshade=False, zorder=k)
        for line in report.outline(model):
            axes.plot(*se3.apply(T, line).T, color=color, linewidth=width, zorder=10 + k)
    axes.plot(*scene.contacts.points_palm.T, "x", color="k", markersize=10, markeredgewidth=2.2, zorder=20)


def main():
    options, _ = report.parsed(report.parser(__doc__), trials=100, quick_trials=15)
    models = scenes.table_1_models()
    rows = run(options, models)
    table = summarised(rows, models)
    print_table(table, options.trials)
    report.write_csv(options.output / "figure_3.csv", table)
    draw(options, models, table, options.output / "figure_3.png")


if __name__ == "__main__":
    main()
