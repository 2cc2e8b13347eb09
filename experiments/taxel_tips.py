"""Contacts of curved fingertips with taxels: point, normal and force, and how certain they say to be. All synthetic.

A tip of 30 taxels, 4.7 mm apart, presses on a round or flat body with 0.5 to 5 N: an elastic skin (1.5 mm of rubber to
5 mm of foam), 5 % noise, 3 % crosstalk, each taxel off by 0.15 mm, one dead, half of the time where it is pressed. The
constants of patches were chosen on the shapes `capsule` and `ball`, with other seeds.

  point    error of the point where the body touches first, median and 90 % quantile
  NEES     squared error by the covariance of point and normal, per degree of freedom
"""

import numpy as np

from shared import report, tip_scenes
from testbed.report import Rows

HELD_OUT = 15
"""A key of the presses that no constant was chosen on."""


def main() -> None:
    """Runs the experiment."""
    options, rows = report.options(__doc__, trials=300, quick_trials=40), []
    for components in (3, 1):
        for n, name in enumerate(tip_scenes.SHAPES):
            rows += presses(options, n, name, components)
    table = []
    for components in (3, 1):
        for name in tip_scenes.SHAPES:
            mine = report.chosen(rows, shape=name, components=components)
            point, normal, force, nees = (
                report.values(mine, key) for key in ("point", "normal", "force", "nees")
            )
            use = "held out" if name in tip_scenes.HELD_OUT else "chosen on"
            cells = [
                f"{f(values):.{d}f}" for values, d in ((point, 2), (normal, 1)) for f in (np.median, p90)
            ]
            push = f"{100 * np.median(force):.1f} %" if components == 3 else ""
            table.append([components, name, use, len(mine), *cells, push, f"{nees.mean():.2f}"])
    report.print_table(
        "Errors of a contact (synthetic)",
        ["components", "shape", "", "n", "point mm", "p90", "normal °", "p90", "force", "NEES"],
        table,
        "",
    )
    report.write_csv(options.output / "taxel_tips.csv", rows)


def p90(values: np.ndarray) -> float:
    """The 90 % quantile."""
    return float(np.quantile(values, 0.9))


def presses(options: report.Options, n: int, name: str, components: int) -> Rows:
    """The errors of presses of one shape; every tenth has another layout."""
    rows: Rows = []
    for k in range(options.trials):
        rng = options.rng(HELD_OUT, n, components, k)
        if k % 10 == 0:
            surface = tip_scenes.tip(tip_scenes.SHAPES[name], rng, components=components)
        truth = tip_scenes.pressed(tip_scenes.SHAPES[name], surface, rng)
        touch = surface.touch(truth.readings)
        row = tip_scenes.errors(touch.patches[touch.strongest], truth) if len(touch.patches) else None
        rows += [] if row is None else [{"shape": name, "components": components, "trial": k, **row}]
    return rows


if __name__ == "__main__":
    main()
