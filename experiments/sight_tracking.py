"""An object followed in depth images at 30 Hz while a hand closes on it: how far off, how fast, and how honest.

YCB objects move before the camera, at most 0.3 m/s and 1.5 rad/s; a Shadow hand, whose joints are believed a degree
off, comes from aside and closes on them, in two of three sequences on the camera's side. Drawn, with a structured-light
camera's noise: synthetic. Each method begins at the true pose. `in palm` knows from when on the object moves with the
palm. small_gicp lays the same window's points onto the model, from the same kind of prediction, point to plane; its
time is that of `align` alone.

  mm, deg  median error of the object's middle and of its turn, modulo symmetry, over images binned by the share of the
           silhouette that is hidden
  off      share of images with a surface point more than 10 % of the diameter off (MSSD)
  ms       process CPU time of a step, median and 99th percentile, searches of the whole image included
  inside   share of poses that are `tracking`, and of those with the truth in their 95 % region
Then: what is said of images in which the pose is off; a jug that turns on the spot with its handle out of sight, which
fits wherever the handle is thought to be; from how far off one image puts a pose right.
"""

from itertools import chain
from typing import Any

import numpy as np

import handsight as hs
from handsight import se3
from shared import figures, report, ycb
from testbed import sight_sequences as drawn
from testbed.report import Rows
from testbed.sequences import ASIDE, BINS, OBJECTS, Followed, followed, hand_shape, judged

CAPTURES = ((10, 5), (20, 10), (30, 15), (60, 30))
"""How far off a first pose is [mm, degrees]."""


def show(rows: Rows) -> None:
    """Prints the table by hidden share."""
    table = []
    for method in report.distinct(rows, "method"):
        for low, high in BINS:
            mine = [row for row in report.chosen(rows, method=method) if low < row["hidden"] <= high]
            if not mine:
                continue
            mm, deg, off, ms = (
                np.array([row[key] for row in mine], float) for key in ("mm", "deg", "off", "ms")
            )
            good = [row for row in mine if row["state"] == "tracking"]
            told = np.array([row["inside"] for row in good])
            inside = f"{len(good) / len(mine):.2f} {np.nanmean(told):.2f}" if np.isfinite(told).any() else ""
            label = f"{max(low, 0):.0%} to {min(high, 1):.0%}"
            numbers = (f"{np.median(mm):.2f}", f"{np.median(deg):.2f}", f"{off.mean():.3f}")
            times = f"{np.median(ms):.2f} {np.quantile(ms, 0.99):.2f}"
            table.append([method, label, len(mine), *numbers, times, inside])
    columns = ["method", "hidden", "images", "mm", "deg", "off", "ms, 99 %", "tracking, inside"]
    report.print_table("An object followed in depth images (synthetic)", columns, table, report.machine())


def show_states(title: str, rows: Rows) -> None:
    """Prints how often each state was reported, where the pose is wrong and where it is right."""
    table = []
    for method in ("handsight", "in palm"):
        for off in (False, True):
            mine = report.chosen(rows, method=method, off=off)
            counts = [len(report.chosen(mine, state=state)) for state in ("tracking", "uncertain", "lost")]
            table.append([method, "off" if off else "not off", len(mine), *counts])
    columns = ["method", "pose", "images", "tracking", "uncertain", "lost"]
    report.print_table(title, columns, table)


def captured(model: hs.ObjectModel, image: drawn.Instant, rng: np.random.Generator) -> dict[str, bool]:
    """Whether one image corrects a first pose that is off by each of `CAPTURES`."""
    found = {}
    for mm, degrees in CAPTURES:
        way, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        center = se3.compose(np.eye(3), model.center_object)
        delta = np.concatenate([1e-3 * mm * way, np.deg2rad(degrees) * axis])
        T = se3.moved(image.T_camera_object @ center, delta) @ se3.inverse(center)
        follower = Followed(model, T, palm=False)
        follower.step(image)
        found[f"{mm} mm, {degrees} deg"] = not judged(model, follower, image.T_camera_object)["off"]
    return found


def draw(rows: Rows, path: Any) -> None:
    """Errors over the hidden share, each image a dot, coloured by the reported state."""
    plt = figures.pyplot()
    figure, panels = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained", sharey=True)
    colours = {"tracking": "#2e9e4f", "uncertain": "#e6b400", "lost": "#c0392b"}
    for axes, method in zip(panels, ("handsight", "small_gicp"), strict=True):
        for state, colour in colours.items():
            mine = report.chosen(rows, method=method, state=state)
            hidden, mm = (np.array([row[key] for row in mine]) for key in ("hidden", "mm"))
            name = state if method == "handsight" else None
            axes.scatter(
                hidden, np.maximum(mm, 0.05), s=5, c=colour if name else "0.4", label=name, linewidths=0
            )
        axes.set(yscale="log", xlabel="hidden share of the silhouette", title=method, xlim=(-0.02, 1.02))
    panels[0].set_ylabel("error of the object's middle [mm]")
    panels[0].legend(markerscale=3)
    figures.save(figure, path)


@report.or_skip
def main() -> None:
    """Draws, follows, prints."""
    options = report.options(__doc__, trials=60, quick_trials=3)
    folder, hand, captures = ycb.data_or_goodbye(), hand_shape(), []
    rows: Rows = []
    spun: Rows = []
    jug = hs.ObjectModel.from_mesh(*drawn.jug())
    for k in report.progress(range(options.trials), "following"):
        name, rng = OBJECTS[k % len(OBJECTS)], options.rng(k)
        model = ycb.load(folder, name).model
        images = drawn.sequence(
            model, hand, rng, aside=ASIDE[k // len(OBJECTS) % len(ASIDE)], hold=k % 2 == 0
        )
        first = next(images)
        captures.append(captured(model, first, rng))
        rows += followed(name, model, chain([first], images), {"sequence": k})
        if k % 5 == 0:
            images = drawn.sequence(jug, None, rng, path=drawn.turning(rng))
            spun += followed("jug", jug, images, {"sequence": k})
    show(rows)
    show_states("What is said of them (off: a surface point is more than 10 % of the diameter off)", rows)
    show_states("A jug that turns on the spot, its handle out of sight", spun)
    shares = ", ".join(f"{key}: {np.mean([c[key] for c in captures]):.2f}" for key in captures[0])
    report.say(f"Put right by one image, from a pose off by {shares}.")
    report.write_csv(options.output / "sight_tracking.csv", rows)
    report.write_csv(options.output / "sight_tracking_jug.csv", spun)
    draw(rows, options.output / "sight_tracking.png")


if __name__ == "__main__":
    main()
