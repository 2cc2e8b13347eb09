"""Fig. 2 of the paper: the regions of the cloud in which each finger's contact is looked for (eq. 2).

Where the object was seen, the points of its cloud within ε = 2 cm of a contact are that contact's region;
where fewer than 200 are, the neighbourhood grows until it holds as many. The cost is then evaluated in these
alone. That is faster, but a region may miss the point that the finger truly touches, and then the cost
is not least at the true pose. Scenes are Table I's: 2 cm per axis and 20° off, four contacts.

The figure shows the regions in colours on the grey cloud where it was seen, contacts as crosses, the points
truly touched as dots; and how often a region holds the true point, by its least number of points. The table
adds how far regions reach and how much of the cloud they are; below it, what they save per evaluation.
"""

import numpy as np

import report
import scenes
from handsight.correction import paper

METHOD = paper.PaperMethod()
LEAST = (25, 50, 100, 200, 400, 800, 1600)
SHOWN = {
    "points": 0,
    "reach_cm": 2,
    "grown_share": 2,
    "cloud_share": 3,
    "holds_true_point": 2,
    "holds_all_four": 2,
}
"""Columns of the table, with their digits."""
COLOURS = ("#d1495b", "#2e86ab", "#8f5fb8", "#e08e2b")
"""One a finger."""


def one_trial(model, scene, least):
    """What the regions of one grasp are like, by the names of the CSV file."""
    cloud, _ = model.sample(scenes.CLOUD)
    contacts = scene.contacts.points_palm
    found = paper.regions(contacts, cloud, METHOD.epsilon, least)
    touched = np.linalg.norm(cloud[None] - scene.points_object[:, None], axis=2).argmin(axis=1)
    reach = [np.linalg.norm(cloud[r[-1]] - c) for c, r in zip(contacts, found, strict=True)]
    inside = [t in r for t, r in zip(touched, found, strict=True)]
    return {
        "points": float(np.mean([len(region) for region in found])),
        "reach_cm": 100 * float(np.mean(reach)),
        "grown_share": float(np.mean(np.asarray(reach) > METHOD.epsilon)),
        "cloud_share": float(np.mean([len(region) for region in found]) / len(cloud)),
        "holds_true_point": float(np.mean(inside)),
        "holds_all_four": float(np.all(inside)),
    }


def seconds_per_evaluation(model, scene, found, repeats):
    """Median seconds of one evaluation of eq. 3: in the regions, and in the whole cloud."""
    cloud, normals = model.sample(scenes.CLOUD)
    everywhere = [np.arange(len(cloud))] * len(found)
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    times = []
    matchings = [
        paper.Matching(
            scene.contacts.points_palm,
            paper.padded(cloud, regions, np.inf),
            scene.contacts.normals_palm,
            paper.padded(normals, regions, 0.0),
            METHOD.w_n,
        )
        for regions in (found, everywhere)
    ]
    for _ in range(repeats):
        times.append([report.timed(lambda m=m: paper.residuals(x, m))[1] for m in matchings])
    return np.median(times, axis=0)


def run(options):
    """A row per shape, least number of points and trial."""
    rows = []
    models = scenes.table_1_models()
    for k in report.progress(range(options.trials), "regions"):
        for s, (shape, model) in enumerate(models.items()):
            rng = options.rng(k, s)
            scene = scenes.displaced(*scenes.on_four_sides(model, rng), rng, sigmas=(1e-3, 0.1))
            for least in LEAST:
                rows.append({"shape": shape, "least": least, "trial": k, **one_trial(model, scene, least)})
    return rows


def summarised(rows):
    """A row per shape and least number of points: mean and standard error of each number."""
    table = []
    for shape in dict.fromkeys(row["shape"] for row in rows):
        for least in LEAST:
            chosen = [row for row in rows if (row["shape"], row["least"]) == (shape, least)]
            row = {"shape": shape, "least_points": least}
            for name in list(chosen[0])[3:]:
                row[f"{name}_mean"], row[f"{name}_se"] = report.summary(r[name] for r in chosen)
            table.append(row)
    return table


def print_table(rows, trials):
    """How the regions grow with their least number of points."""
    cells = []
    for shape in dict.fromkeys(row["shape"] for row in rows):
        for least in LEAST:
            chosen = [row for row in rows if (row["shape"], row["least"]) == (shape, least)]
            numbers = [report.plus_minus((row[n] for row in chosen), d) for n, d in SHOWN.items()]
            cells.append([shape, least, *numbers])
    columns = ["shape", "at least", "points", "reach cm", "grown", "share", "true point", "all four"]
    note = (
        f"Mean±standard error over {trials} trials, four contacts each. grown: share of regions wider than "
        "ε. share: of the cloud. true point, all four: share of contacts, and of trials, whose regions hold "
        "what is truly touched."
    )
    report.print_table("Regions of eq. 2, ε = 2 cm", columns, cells, note)


def example(options):
    """Shape, model and scene of the first trial of each shape."""
    for s, (shape, model) in enumerate(scenes.table_1_models().items()):
        rng = options.rng(0, s)
        yield shape, model, scenes.displaced(*scenes.on_four_sides(model, rng), rng, sigmas=(1e-3, 0.1))


def draw(options, rows, path):
    """The clouds with their regions, and how often these hold what is looked for."""
    plt = report.pyplot()
    figure = plt.figure(figsize=(14, 4.9), layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=(1, 1, 0.85), wspace=0.12)
    for i, (shape, model, scene) in enumerate(example(options)):
        axes = figure.add_subplot(grid[i], projection="3d")
        draw_regions(axes, model, scene)
        axes.set_title(f"{shape}, where it was seen")
    axes = figure.add_subplot(grid[2])
    table = summarised(rows)
    for shape, marker, color in (("cube", "s", "0.2"), ("cylinder", "o", COLOURS[1])):
        chosen = [row for row in table if row["shape"] == shape]
        share, error = ([row[f"holds_true_point_{n}"] for row in chosen] for n in ("mean", "se"))
        axes.errorbar(LEAST, share, error, marker=marker, capsize=3, label=shape, color=color)
    axes.axvline(METHOD.min_points, color="0.75", linestyle="--", zorder=0)
    axes.annotate("used", (METHOD.min_points, 0.02), (4, 0), textcoords="offset points", color="0.4")
    axes.set(xscale="log", ylim=(0, 1.03), xlabel="least number of points in a region")
    axes.set_ylabel("share of contacts")
    axes.set_title("the region holds the point truly touched")
    axes.set_xticks(LEAST, LEAST)
    axes.minorticks_off()
    axes.legend(loc="upper left", title="mean ± standard error")
    report.save_figure(figure, path)


def draw_regions(axes, model, scene):
    """The cloud in grey, a colour for each finger's region; contacts are crosses, points touched are dots."""
    cloud, normals = model.sample(scenes.CLOUD)
    contacts = scene.contacts.points_palm
    report.frame_3d(axes, np.vstack([cloud, contacts]), view=(24, -52))
    found = paper.regions(contacts, cloud, METHOD.epsilon, METHOD.min_points)
    color = np.full(len(cloud), "#9a9a9a", dtype="<U7")
    for name, region in zip(COLOURS, found, strict=True):
        color[region] = name
    front = report.faces_viewer(axes, normals)
    axes.scatter(*cloud[~front].T, s=3, color=color[~front], alpha=0.25, depthshade=False)
    axes.scatter(*cloud[front].T, s=7, color=color[front], alpha=0.9, depthshade=False)
    for name, contact, true in zip(COLOURS, contacts, scene.points_object, strict=True):
        axes.plot(*np.stack([contact, true]).T, color="k", linewidth=1.2, linestyle=":", zorder=20)
        axes.plot(*contact[:, None], "x", color="w", markersize=14, markeredgewidth=6, zorder=21)
        axes.plot(*contact[:, None], "x", color=name, markersize=13, markeredgewidth=3.2, zorder=22)
        axes.plot(*true[:, None], "o", color=name, markeredgecolor="k", markersize=8, zorder=22)


def print_speed(options):
    """What an evaluation of the cost takes in the regions and in the whole cloud, for the first trials."""
    for shape, model, scene in example(options):
        cloud, _ = model.sample(scenes.CLOUD)
        found = paper.regions(scene.contacts.points_palm, cloud, METHOD.epsilon, METHOD.min_points)
        regions, whole = seconds_per_evaluation(model, scene, found, 60 if options.quick else 400)
        report.say(
            f"* {shape}: one evaluation of eq. 3 takes {1e6 * regions:.0f} µs in the regions and "
            f"{1e6 * whole:.0f} µs in the whole cloud, {whole / regions:.1f} times as long."
        )


def main():
    options, _ = report.parsed(report.parser(__doc__), trials=200, quick_trials=20)
    rows = run(options)
    print_table(rows, options.trials)
    print_speed(options)
    report.write_csv(options.output / "figure_2.csv", summarised(rows))
    draw(options, rows, options.output / "figure_2.png")


if __name__ == "__main__":
    main()
