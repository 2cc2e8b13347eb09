"""Fig. 6 of the paper: where the object is on the table, from two corners of a square (eq. 8).

The object is glued to a transparency on which four squares meet in its centre p₀, and the transparency lies
on millimetre paper. Reading two corners off that paper gives the centre:

    v = p₁ - p₂,    p₀ = p₂ + [[0, -1], [1, 0]] v       the matrix turns v by 90° counterclockwise

So p₂ is the corner next to the centre and p₁ the one across from it, and the square is walked
counterclockwise p₀, p₂, p₁ (x to the right, y up; in an image, with y down, it is clockwise). The paper does
not say so. Swapped corners put the centre on the other side of the edge, √5 sides away from where it is; with
the other neighbour of the centre for p₂ it lands two sides away.

The table shows what a reading error per axis of each corner makes of the centre: √3 of it per axis, because
p₀ = R p₁ + (I - R) p₂ for the matrix R, and R Rᵀ + (I - R)(I - R)ᵀ = 3 I, whatever the side of the square.
"""

from pathlib import Path
from typing import Any

import numpy as np

from experiments.shared.grasp_errors import SIDE, centre_from_corners, corners
from testbed import figures, report
from testbed.report import Array, Row, Rows

SIGMAS_MM = (0.1, 0.3, 0.5, 1.0, 2.0)
"""Reading errors per axis [mm]: half a millimetre is what the paper's ground can give."""


def run(options: report.Options) -> Rows:
    """A row per reading error and use of the corners: the centre's error over all trials."""
    rows = []
    for k, sigma_mm in enumerate(report.progress(SIGMAS_MM, "readings")):
        rng = options.rng(k)
        centre = rng.uniform(-0.2, 0.2, (options.trials, 2))
        turns = rng.uniform(0, 2 * np.pi, len(centre))
        squares = [corners(c, angle) for c, angle in zip(centre, turns, strict=True)]
        p1, p2 = np.swapaxes([s[rng.integers(4)] for s in squares], 0, 1)
        p1, p2 = (p + 1e-3 * sigma_mm * rng.normal(size=p.shape) for p in (p1, p2))
        rows.append(errors(sigma_mm, "as meant", centre_from_corners(p1, p2) - centre))
        rows.append(errors(sigma_mm, "swapped", centre_from_corners(p2, p1) - centre))
    return rows


def errors(sigma_mm: float, use: str, error: Array) -> Row:
    """A row of the table from errors (n, 2) of the centre [m]."""
    distance = 1000 * np.linalg.norm(error, axis=1)
    return {
        "sigma_mm": sigma_mm,
        "corners": use,
        "error_per_axis_mm": 1000 * float(np.sqrt((error**2).mean())),
        "predicted_per_axis_mm": float(np.sqrt(3)) * sigma_mm if use == "as meant" else "",
        "distance_mean_mm": float(distance.mean()),
        "distance_std_mm": float(distance.std(ddof=1)),
        "distance_max_mm": float(distance.max()),
    }


def print_table(rows: Rows, trials: int) -> None:
    """The centre's error by reading error."""
    cells = []
    for row in rows:
        predicted = row["predicted_per_axis_mm"]
        line = [f"{row['sigma_mm']:.1f}", row["corners"], f"{row['error_per_axis_mm']:.2f}"]
        line += [predicted and f"{predicted:.2f}"]
        line += [f"{row['distance_mean_mm']:.2f}±{row['distance_std_mm']:.2f}"]
        cells.append([*line, f"{row['distance_max_mm']:.2f}"])
    columns = ["reading mm", "corners", "centre mm per axis", "√3 reading", "centre mm", "largest"]
    note = (
        "reading: standard deviation per axis. centre: root mean square per axis, then distance, "
        f"mean±standard deviation, of {trials} readings. Squares of {100 * SIDE:.0f} cm."
    )
    report.print_table("The centre from two corners (eq. 8)", columns, cells, note)


def draw(path: Path) -> None:
    """The transparency as it is meant, and with the corners swapped."""
    centre, angle = np.array([0.10, 0.08]), np.deg2rad(24)
    figure, panels = figures.pyplot().subplots(
        1, 2, figsize=(10.5, 5.6), sharex=True, sharey=True, layout="constrained"
    )
    for axes, swapped in zip(panels, (False, True), strict=True):
        squares = corners(centre, angle)
        for p1, p2 in squares:
            loop = np.array([centre, p2, p1, p1 - p2 + centre, centre])
            axes.plot(*(100 * loop.T), color="0.45", linewidth=1.2)
        p1, p2 = squares[0][::-1] if swapped else squares[0]
        draw_construction(axes, p1, p2, centre)
        axes.set_title("p₁ and p₂ swapped: √5 sides off" if swapped else "as eq. 8 means it")
        axes.set(aspect="equal", xlabel="table x [cm]")
        axes.grid(color="0.93")
        axes.set_axisbelow(True)
    panels[0].set_ylabel("table y [cm]")
    figures.legend_below(figure, panels[1], 4)
    figures.save(figure, path)


def draw_construction(axes: Any, p1: Array, p2: Array, centre: Array) -> None:
    """v from p₂ to p₁, its quarter turn from p₂, and where that puts the centre."""
    found = centre_from_corners(p1, p2)
    arrow = {"arrowstyle": "-|>", "linewidth": 2, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 16}
    for end, color in ((p1, "#4878a8"), (found, "#c2185b")):
        axes.annotate("", 100 * end, 100 * p2, arrowprops={**arrow, "color": color})
    axes.plot([], [], color="#4878a8", linewidth=2, label="v = p₁ - p₂")
    axes.plot([], [], color="#c2185b", linewidth=2, label="v turned by 90°")
    dot = {"linestyle": "none", "markeredgecolor": "k", "zorder": 5}
    axes.plot(*(100 * centre), "o", color=figures.TRUTH, markersize=13, label="true centre", **dot)
    axes.plot(*(100 * found), "o", color=figures.RESULT, markersize=8, label="centre by eq. 8", **dot)
    middle = (p1 + p2) / 2
    outward = (middle - found) / np.linalg.norm(middle - found)
    for name, point in (("p₁", p1), ("p₂", p2)):
        axes.plot(*(100 * point), "s", color="k", markersize=6, zorder=6)
        away = (point - middle) / np.linalg.norm(point - middle)
        offset = 13 * (away + outward) / np.linalg.norm(away + outward)
        centred = {"textcoords": "offset points", "ha": "center", "va": "center", "size": 13}
        axes.annotate(name, 100 * point, offset, **centred)


def main() -> None:
    """Reads corners, with and without errors."""
    options = report.options(__doc__, trials=20000, quick_trials=2000)
    rows = run(options)
    print_table(rows, options.trials)
    p1, p2 = corners(np.zeros(2), 0.3)[0]
    exact, off = np.linalg.norm(centre_from_corners(p1, p2)), np.linalg.norm(centre_from_corners(p2, p1))
    report.say(
        f"* p₁ across from the centre, p₂ next to it, counterclockwise: exact to {exact:.0e} m; swapped: "
        f"{off / SIDE:.3f} sides ({100 * off:.1f} cm here) off, on the other side of the edge."
    )
    report.write_csv(options.output / "figure_6.csv", rows)
    draw(options.output / "figure_6.png")


if __name__ == "__main__":
    main()
