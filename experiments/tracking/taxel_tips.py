"""Contacts of curved fingertips with taxels: point, normal and force, and how certain they say to be. All synthetic.

A tip of 30 taxels, 4.7 mm apart, presses on a round or flat body with 0.5 to 5 N: an elastic skin (1.5 mm of rubber to
5 mm of foam), 5 % noise, 3 % crosstalk, each taxel off by 0.15 mm, one dead, half of the time where it is pressed. The
constants of patches were chosen on the shapes `capsule` and `ball`, with other seeds.

  point    error of the point where the body touches first, median and 90 % quantile
  NEES     squared error by the covariance of point and normal, per degree of freedom

Second, the height of a contact over the object's surface where that has sunk into 1.5 mm of rubber, by the stiffness
that is declared.
"""

import numpy as np

from handsight.simulation.taxels import RUBBER
from testbed import report, skin_scenes
from testbed.report import Array, Rows

DECLARED = {"nothing": None, "half": 0.5, "right": 1.0, "double": 2.0}
"""Factor of the stiffness that the surface has, by its name in the table."""
HELD_OUT = 15
"""A key of the presses that no constant was chosen on."""


def main() -> None:
    """Runs the experiment."""
    options, rows = report.options(__doc__, trials=300, quick_trials=40), []
    for components in (3, 1):
        for n, name in enumerate(skin_scenes.SHAPES):
            rows += presses(options, n, name, components)
    cells: dict[str, report.Cell] = {
        "n": report.count,
        "point mm": report.of("point", ".2f", np.median),
        "p90": report.of("point", ".2f", report.quantile(0.9)),
        "normal °": report.of("normal", ".1f", np.median),
        "normal p90": report.of("normal", ".1f", report.quantile(0.9)),
        "force": report.where(report.of("force", ".1%", np.median), components=3),
        "NEES": report.of("nees"),
    }
    report.print_by("Errors of a contact (synthetic)", rows, "components, shape, use", cells)
    report.write_csv(options.output / "taxel_tips.csv", rows)
    heights = [row for declared in DECLARED for row in sunk(options, declared)]
    cells = {
        "n": report.count,
        "median mm": report.of("height", ".2f", median_size),
        "p90": report.of("height", ".2f", lambda heights: np.quantile(np.abs(heights), 0.9)),
        "NEES": report.of("nees"),
    }
    report.print_by("Heights over the sunken surface (synthetic)", heights, "declared", cells)


def median_size(numbers: Array) -> float:
    """Returns the median size of numbers."""
    return float(np.median(np.abs(numbers)))


def sunk(options: report.Options, declared: str) -> Rows:
    """The heights of three-axis contacts over the surface of what has sunk into rubber."""
    rows: Rows = []
    factor = DECLARED[declared]
    stiffness = None if factor is None else factor * RUBBER
    for n, shape in enumerate(skin_scenes.SHAPES.values()):
        for k in range(options.trials):
            rng = options.rng(HELD_OUT, n, k)
            if k % 10 == 0:
                surface = skin_scenes.tip(shape, rng, stiffness=stiffness)
            truth = skin_scenes.pressed(shape, surface, rng, springs=RUBBER)
            touch = surface.touch(truth.readings)
            if len(touch.patches):
                height, squared = skin_scenes.height_error(touch.patches[touch.strongest], truth)
                rows.append({"declared": declared, "height": height, "nees": squared})
    return rows


def presses(options: report.Options, n: int, name: str, components: int) -> Rows:
    """The errors of presses of one shape; every tenth has another layout."""
    rows: Rows = []
    use = "held out" if name in skin_scenes.HELD_OUT else "chosen on"
    key = {"shape": name, "components": components, "use": use}
    for k in range(options.trials):
        rng = options.rng(HELD_OUT, n, components, k)
        if k % 10 == 0:
            surface = skin_scenes.tip(skin_scenes.SHAPES[name], rng, components=components)
        truth = skin_scenes.pressed(skin_scenes.SHAPES[name], surface, rng)
        touch = surface.touch(truth.readings)
        row = skin_scenes.errors(touch.patches[touch.strongest], truth) if len(touch.patches) else None
        rows += [] if row is None else [key | {"trial": k, **row}]
    return rows


if __name__ == "__main__":
    main()
