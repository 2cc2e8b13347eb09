"""Targets of the repetition of section III, and whether they are met."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from testbed.report import Row, Rows

REMOVED = (
    # object, experiment, method, least share removed [%], most error as read [mm]
    ("can", "instant", "best", 95, 4.0),
    ("box", "instant", "best, outside, table", 94, None),
    ("box", "instant", "best, outside", 90, None),
    ("box", "time", "best, outside, table", 95, None),
)
DEPTH_POINT = 95
"""Smallest share of vision's error that is removed in observable directions [%]."""
SENSING = {("can", "clean"): 60, ("box", "clean"): 30, ("can", "noisy"): 200, ("box", "noisy"): 200}
"""Largest mean error of a contact's location [µm]."""
REGIONS = {"in 50%": (45, 60), "in 95%": (92, 98)}
"""Shares of truths within the stated regions [%]."""
HONEST = {"can": ("best", "best, table"), "box": ("best, outside", "best, outside, table")}
WHEN = {"instant": "one instant", "time": "over time"}


def judged(found: Row) -> Rows:
    """Returns a line for each target: its name, the target, the measured value, and whether it is met."""
    return [*_paper(found), *_removed(found), *_seen(found), *_sensing(found), *_regions(found)]


def _line(target: str, wanted: str, value: str, met: bool) -> Row:
    return {"target": target, "wanted": wanted, "found": value, "met": bool(met)}


def _of(lines: Rows, method: str) -> Any:
    return next((line for line in lines if line["method"] == method), None)


def _paper(found: Row) -> Iterator[Row]:
    for key, vision in (("instant", "vision wrong in 3-D"), ("plane", "vision right in height")):
        line = _of(found[key]["can"], "paper-lm, w_n 5 cm")
        if line:
            mm = line["read"][0]
            yield _line(f"can, paper-lm, w_n 5 cm, {vision}", "20-30 mm", f"{mm:.1f} mm", 20 <= mm <= 30)


def _removed(found: Row) -> Iterator[Row]:
    for name, when, method, least, most in REMOVED:
        line = _of(found[when][name], method)
        if line is None:
            continue
        share, mm = line["read removed"][0], line["read"][0]
        wanted = f"≥ {least} %" + (f", ≤ {most:g} mm" if most else "")
        met = share >= least and (most is None or mm <= most)
        yield _line(f"{name}, {WHEN[when]}, {method}", wanted, f"{share:.1f} %, {mm:.1f} mm", met)


def _seen(found: Row) -> Iterator[Row]:
    for name in found["instant"]:
        share = _of(found["instant"][name], "best")["seen removed"][0]
        yield _line(
            f"{name}, one instant, observable directions",
            f"≥ {DEPTH_POINT} %",
            f"{share:.1f} %",
            share >= DEPTH_POINT,
        )


def _sensing(found: Row) -> Iterator[Row]:
    for (name, noise), most in SENSING.items():
        um = 1e6 * float(np.mean(found["sensing"][name][noise]))
        yield _line(f"{name}, contact sensing, {noise}", f"≤ {most} µm", f"{um:.0f} µm", um <= most)


def _regions(found: Row) -> Iterator[Row]:
    for name, methods in HONEST.items():
        for method in methods:
            line = _of(found["instant"][name], method)
            for key, (low, high) in REGIONS.items():
                share = 100 * line[key]
                yield _line(
                    f"{name}, one instant, {method}, truths {key.replace('%', ' %')}",
                    f"{low}-{high} %",
                    f"{share:.0f} %",
                    low <= share <= high,
                )
