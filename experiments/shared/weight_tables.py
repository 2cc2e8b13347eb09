"""The tables of `weight.py`."""

from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np

from testbed import report
from testbed.report import Rows

ACCELERATIONS = (0.0, 0.4, 1.0, 2.0, np.inf)
"""Bounds of the classes of acceleration over which means are taken [m/s²]."""


def show(rows: Rows) -> None:
    """Prints the tables."""
    _show_weighing(rows, "weighing", "Weighing")
    _show_weighing(rows, "gains", "Weighing with gains off by 3 %")
    cells = _cells(rows, "weighing")
    lines = [
        [f"{o} {m:g} kg, {n}", *_mean_p90(mine, "without pose"), *_mean_p90(mine, "with pose"),
         _mean(mine, "shared pose"), _mean(mine, "without across"), _mean(mine, "with across"),
         *(_mean(mine, f"{way} normal") for way in ("without", "with", "shared")),
         *(_mean(mine, f"{way} turn") for way in ("without", "with", "shared")), _mean(mine, "left out")]
        for (o, m, n), mine in cells
    ]  # fmt: skip
    columns = [
        "object, orientations", "without mm", "p90", "with", "p90", "shared", "across g", "with",
        "normal", "with", "shared", "turn °", "with", "shared", "left out",
    ]  # fmt: skip
    report.print_table("Pose", columns, lines)
    _show_moving(rows)
    _show_wrong(rows)


def _cells(rows: Rows, table: str) -> list[tuple[tuple[Any, ...], Rows]]:
    """Returns the rows by object, mass and number of orientations."""
    keys = ("object", "mass", "orientations")
    found: dict[tuple[Any, ...], Rows] = {}
    for row in report.chosen(rows, table=table):
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(found.items())


def _show_weighing(rows: Rows, table: str, title: str) -> None:
    dropped = Counter((row["object"], row["mass"]) for row in report.chosen(rows, table="dropped"))
    lines = [
        [f"{o} {m:g} kg, {n}", len(mine), *_mean_p90(believed, "error"), _mean(believed, "nees"),
         _mean(believed, "mass error"), _mean(mine, "refused"), dropped[o, m]]
        for (o, m, n), mine in _cells(rows, table) for believed in [report.chosen(mine, refused=0.0)]
    ]  # fmt: skip
    columns = ["object, orientations", "grasps", "mm", "p90", "NEES", "mass %", "refused", "dropped"]
    report.print_table(title, columns, lines)


def _show_moving(rows: Rows) -> None:
    lines = []
    for low, high in pairwise(ACCELERATIONS):
        for name in report.distinct(rows, "object"):
            mine = [
                r for r in report.chosen(rows, table="moving", object=name) if low <= r["acceleration"] < high
            ]
            if mine:
                what = f"{name}, {low:g} to {high:g} m/s²"
                kept = *_mean_p90(mine, "error kept"), _mean(mine, "nees kept")
                lines.append([what, len(mine), *_mean_p90(mine, "error"), _mean(mine, "nees"), *kept])
    report.print_table(
        "Moving", ("object, acceleration", "means", "mm", "p90", "NEES", "kept mm", "p90", "NEES"), lines
    )


def _show_wrong(rows: Rows) -> None:
    lines = []
    for what in report.distinct(report.chosen(rows, table="wrong"), "what"):
        for name in report.distinct(rows, "object"):
            mine = report.chosen(rows, table="wrong", what=what, object=name)
            if mine:
                worst = max(row["pose"] - row["without"] for row in mine)
                means = (_mean(mine, key) for key in ("ever", "now", "pose", "without"))
                lines.append([f"{what}, {name}", len(mine), *means, f"{worst:.1f}"])
    columns = [
        "what is wrong",
        "grasps",
        "noticed by then",
        "at last",
        "pose mm",
        "without",
        "worse by at most",
    ]
    report.print_table("Wrong", columns, lines)


def _mean(rows: Rows, name: str) -> str:
    return f"{report.values(rows, name).mean():.2f}" if rows else "-"


def _mean_p90(rows: Rows, name: str) -> tuple[str, str]:
    found = report.values(rows, name)
    if not rows:
        return "-", "-"
    return f"{found.mean():.2f}", f"{np.quantile(found, 0.9):.2f}"
