"""Fig. 2 of the paper: the regions of the cloud in which each finger's contact is looked for (eq. 2).

Where the object was seen, the points of its cloud within ε = 2 cm of a contact are that contact's region;
where fewer than 200 are, the neighbourhood grows until it holds as many. The cost is then evaluated in these
alone. That is faster, but a region may miss the point that the finger truly touches, and then the cost
is not least at the true pose. Scenes are Table I's: 2 cm per axis and 20° off, four contacts.

The figure shows the regions in colours on the grey cloud where it was seen, contacts as crosses, the points
truly touched as dots; and how often a region holds the true point, by its least number of points. The table
adds how far regions reach and how much of the cloud they are; below it, what they save per evaluation.
"""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import handsight as hs
from handsight.correction import paper
from testbed import figures, report, scenes
from testbed.report import Array, Row, Rows

METHOD = paper.PaperMethod()
LEAST = (25, 50, 100, 200, 400, 800, 1600)
SHOWN = (50, 200, 800)
"""What the table has; the figure has all."""
DIGITS = {
    "points": 0, "reach_cm": 2, "grown_share": 2, "cloud_share": 3, "holds_true_point": 2, "holds_all_four": 2
}  # fmt: skip
"""Columns of the table, with their digits."""
COLOURS = ("#d1495b", "#2e86ab", "#8f5fb8", "#e08e2b")
"""One a finger."""


def one_trial(model: hs.ObjectModel, scene: scenes.Scene, least: int) -> Row:
    """What the regions of one grasp are like, by the names of the CSV file."""
    cloud, _ = model.sample(scenes.CLOUD)
    contacts = scene.contacts.points_palm
    found = paper.regions(contacts, cloud, METHOD.epsilon, least)
    touched = np.linalg.norm(cloud[None] - scene.points_object[:, None], axis=2).argmin(axis=1)
    reach = [np.linalg.norm(cloud[r[-1]] - c) for c, r in zip(contacts, found, strict=True)]
    inside = [t in r for t, r in zip(touched, found, strict=True)]
    points = float(np.mean([len(region) for region in found]))
    return {
        "points": points,
        "reach_cm": 100 * float(np.mean(reach)),
        "grown_share": float(np.mean(np.asarray(reach) > METHOD.epsilon)),
        "cloud_share": points / len(cloud),
        "holds_true_point": float(np.mean(inside)),
        "holds_all_four": float(np.all(inside)),
    }


def seconds_per_evaluation(
    model: hs.ObjectModel, scene: scenes.Scene, found: Any, repeats: int
) -> tuple[float, float]:
    """Median seconds of one evaluation of eq. 3: in the regions, and in the whole cloud."""
    cloud, normals = model.sample(scenes.CLOUD)
    everywhere = [np.arange(len(cloud))] * len(found)
    x = np.array([1.0, 0, 0, 0, 0, 0, 0])
    points, felt = scene.contacts.points_palm, scene.contacts.normals_palm
    matchings = []
    for regions in (found, everywhere):
        padded = paper.padded(cloud, regions, np.inf), felt, paper.padded(normals, regions, 0.0)
        matchings.append(paper.Matching(points, *padded, METHOD.w_n))
    calls = [partial(paper.residuals, x, matching) for matching in matchings]
    times = [[report.timed(call)[1] for call in calls] for _ in range(repeats)]
    regions_s, whole_s = np.median(times, axis=0)
    return regions_s, whole_s


def scene_of(options: report.Options, k: int, s: int, model: hs.ObjectModel) -> scenes.Scene:
    """Trial k of shape s."""
    rng = options.rng(k, s)
    return scenes.paper_scene(scenes.on_four_sides(model, rng), rng, sigmas=(1e-3, 0.1))


def run(options: report.Options) -> Rows:
    """A row per shape, least number of points and trial."""
    rows = []
    for k in report.progress(range(options.trials), "regions"):
        for s, (shape, model) in enumerate(scenes.table_1_models().items()):
            scene = scene_of(options, k, s, model)
            key = {"shape": shape, "trial": k}
            rows += [{**key, "least_points": least, **one_trial(model, scene, least)} for least in LEAST]
    return rows


def first_of_each(options: report.Options) -> Iterator[tuple[str, hs.ObjectModel, scenes.Scene, Any]]:
    """Shape, model, scene and regions of the first trial of each shape."""
    for s, (shape, model) in enumerate(scenes.table_1_models().items()):
        scene, (cloud, _) = scene_of(options, 0, s, model), model.sample(scenes.CLOUD)
        found = paper.regions(scene.contacts.points_palm, cloud, METHOD.epsilon, METHOD.min_points)
        yield shape, model, scene, found


def print_tables(rows: Rows, options: report.Options) -> None:
    """How the regions grow with their least number of points; what an evaluation of the cost takes in them."""
    note = (
        f"Mean±standard error over {options.trials} trials, four contacts each. grown_share: of regions wider "
        "than ε. cloud_share: of the cloud. holds: share of contacts, and of trials, whose regions hold what is "
        "truly touched."
    )
    shown = [row for row in rows if row["least_points"] in SHOWN]
    report.print_grouped("Regions of eq. 2, ε = 2 cm", shown, ("shape", "least_points"), DIGITS, note)
    for shape, model, scene, found in first_of_each(options):
        regions, whole = seconds_per_evaluation(model, scene, found, 60 if options.quick else 400)
        report.say(
            f"* {shape}: one evaluation of eq. 3 takes {1e6 * regions:.0f} µs in the regions and "
            f"{1e6 * whole:.0f} µs in the whole cloud, {whole / regions:.1f} times as long."
        )


def draw(options: report.Options, table: Rows, path: Path) -> None:
    """The clouds with their regions, and how often these hold what is looked for."""
    figure = figures.pyplot().figure(figsize=(14, 4.9), layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=(1, 1, 0.85), wspace=0.12)
    for i, (shape, model, scene, found) in enumerate(first_of_each(options)):
        axes = figure.add_subplot(grid[i], projection="3d")
        draw_regions(axes, model, scene, found)
        axes.set_title(f"{shape}, where it was seen")
    axes = figure.add_subplot(grid[2])
    for shape, marker, color in (("cube", "s", "0.2"), ("cylinder", "o", COLOURS[1])):
        share, error = (report.values(table, f"holds_true_point_{n}", shape=shape) for n in ("mean", "se"))
        axes.errorbar(LEAST, share, error, marker=marker, capsize=3, label=shape, color=color)
    axes.axvline(METHOD.min_points, color="0.75", linestyle="--", zorder=0)
    axes.annotate("used", (METHOD.min_points, 0.02), (4, 0), textcoords="offset points", color="0.4")
    axes.set(xscale="log", ylim=(0, 1.03), xlabel="least number of points in a region")
    axes.set(ylabel="share of contacts", title="the region holds the point truly touched")
    axes.set_xticks(LEAST, LEAST)
    axes.minorticks_off()
    axes.legend(loc="upper left", title="mean ± standard error")
    figures.save(figure, path)


def draw_regions(axes: Any, model: hs.ObjectModel, scene: scenes.Scene, found: Any) -> None:
    """The cloud in grey, a colour for each finger's region; contacts are crosses, points touched are dots."""
    cloud, normals = model.sample(scenes.CLOUD)
    contacts = scene.contacts.points_palm
    figures.frame_3d(axes, np.vstack([cloud, contacts]), view=(24, -52))
    color: Array = np.full(len(cloud), "#9a9a9a", dtype="<U7")
    for name, region in zip(COLOURS, found, strict=True):
        color[region] = name
    front = figures.faces_viewer(axes, normals)
    axes.scatter(*cloud[~front].T, s=3, color=color[~front], alpha=0.25, depthshade=False)
    axes.scatter(*cloud[front].T, s=7, color=color[front], alpha=0.9, depthshade=False)
    for name, contact, true in zip(COLOURS, contacts, scene.points_object, strict=True):
        axes.plot(*np.stack([contact, true]).T, color="k", linewidth=1.2, linestyle=":", zorder=20)
        axes.plot(*contact[:, None], "x", color="w", markersize=14, markeredgewidth=6, zorder=21)
        axes.plot(*contact[:, None], "x", color=name, markersize=13, markeredgewidth=3.2, zorder=22)
        axes.plot(*true[:, None], "o", color=name, markeredgecolor="k", markersize=8, zorder=22)


def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=200, quick_trials=20)
    rows = run(options)
    print_tables(rows, options)
    table = report.grouped(rows, ("shape", "least_points"), DIGITS)
    report.write_csv(options.output / "figure_2.csv", table)
    draw(options, table, options.output / "figure_2.png")


if __name__ == "__main__":
    main()
