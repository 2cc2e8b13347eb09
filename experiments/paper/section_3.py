"""Section III of the paper, repeated with known truth: soda can and tea box in a simulated hand, vision 8 cm off.

A Shadow hand with ellipsoidal fingertips on six-axis sensors (MuJoCo) grasps the object; contacts come from raw
wrenches and joints, with all usual nuisances (joint offsets of 1 degree, force noise 10 mN and 0.05 mN m, drift,
compliant tips; the camera wrong by 8 cm in the table's plane on average, 64 mm in height and 6 degrees). Everything
is SYNTHETIC; the robot's model of the object is exact. Three experiments:

  one instant    the end of a grasp, object on the table, one seen pose; never selected on what a correction gave
  over time      the last third of a manipulation (moved, lifted, turned by 75 degrees and back), by the tracker
  sensing        contacts against the simulator's own, without noise and with it

  as read   error of x, y of the base's centre, as the paper measures it: truth by eq. 8 from two corners read to 1 mm
  removed   of vision's mean error;   exact, 3-D, turn: against the exact truth, of base, middle and rotation
  seen      share of vision's error removed in the directions that the contacts can see
  open      error in the directions they leave open, and the one sigma the answer states there

Intervals are 95 %, by bootstrap over grasps (over time: over runs). Where the paper's method has fewer than the two
fingers it asks for, vision's pose stays, and counts.
"""

import json
from collections import Counter
from functools import partial
from typing import Any

import numpy as np

from experiments.shared.grasp_errors import between, mean_interval, removed_interval
from experiments.shared.grasp_methods import OURS, PAPER, rows_of
from experiments.shared.grasp_trials import OBJECTS, again, grasps, sensing_errors, silent
from experiments.shared.manipulations import TRACKED, run_rows
from testbed import report
from testbed.report import Row, Rows

NOISE_DRAWS = 2
RUNS = 8
"""Manipulations of each object; one with --quick."""
SHOWN = (
    "paper-gd, w_n 10 cm",
    "paper-lm, no normals",
    "paper-lm, w_n 5 cm",
    "maximum",
    "best",
    "best, outside",
    "best, outside, table",
)
"""The methods that the tables of one instant have; the file has all."""
Sensing = dict[str, list[float]]
"""By noise: errors of contacts [m]."""
BY_CONTACTS = (
    ("instant", "can", "paper-lm, w_n 5 cm"),
    ("plane", "can", "paper-lm, w_n 5 cm"),
    ("instant", "can", "best"),
    ("instant", "box", "maximum"),
    ("instant", "box", "best, outside, table"),
)


def one_instant(options: report.Options, name: str) -> tuple[Rows, Rows, Sensing, Row]:
    """Rows of all methods, rows of the paper's with no error in height for the same grasps, and what was left out."""
    left_out, fingers, sensing = Counter[str](), Counter[str](), Sensing({"clean": [], "noisy": []})
    rows, plane, trials = Rows(), Rows(), grasps(name, options.trials, options.first_seed, left_out)
    for k in report.progress(range(options.trials), f"{name}, one instant"):
        trial = next(trials, None)
        if trial is None:
            break  # too many were dropped, as is told
        rows += rows_of(trial, [*PAPER, *OURS])
        level = again(trial, camera_height=0.0)
        plane += rows_of(level, PAPER) if level else []
        fingers.update(silent(trial))
        found = sensing_errors(trial.scenario, NOISE_DRAWS, options.rng(k))
        for key, errors in zip(sensing, found, strict=True):
            sensing[key] += errors
    return rows, plane, sensing, {"grasps": dict(left_out), "fingers": dict(fingers)}


def over_time(options: report.Options, name: str, runs: int) -> tuple[Rows, int]:
    """Rows of all runs, and how many were dropped."""
    rows, dropped = Rows(), 0
    for k in report.progress(range(runs), f"{name}, over time"):
        found = run_rows(name, options.first_seed + k, TRACKED)
        dropped += found is None
        rows += found or []
    return rows, dropped


def numbers(rows: Rows, key: str) -> report.Array:
    """A column, of the rows that have it."""
    return np.array([row[key] for row in rows if key in row], dtype=np.float64)


def summarised(rows: Rows) -> Rows:
    """A line a method, in order of appearance: what the tables and the file say of it."""
    lines = []
    for method in report.distinct(rows, "method"):
        mine = report.chosen(rows, method=method)
        of = partial(numbers, mine)
        line = {"method": method, "count": len(mine)}
        line |= {key: mean_interval(of(key)) for key in ("read", "base", "middle", "turn", "open")}
        line |= {"vision": mean_interval(of("vision read"))}
        for key in ("read", "seen", "middle"):
            line[f"{key} removed"] = removed_interval(of(f"vision {key}"), of(key))
        line |= {key: float(of(key).mean()) for key in ("iterations", "open sigma") if len(of(key))}
        line |= {"ms": float(np.median(of("ms")))} if len(of("ms")) else {}
        line["unanswered"] = sum(not row.get("answered", True) for row in mine)
        lines.append(line)
    return lines


def number(value: Any, digits: int = 0) -> str:
    """As text; nothing where there is none."""
    return "" if value is None else f"{value:.{digits}f}"


def print_methods(title: str, lines: Rows, note: str, *, detail: bool = False) -> None:
    """A table of errors, a row a method."""
    cells = [["vision", between(lines[0]["vision"])] + [""] * 9]
    for line in lines:
        opened = number(line["open"][0]) + (f" (σ {line['open sigma']:.0f})" if "open sigma" in line else "")
        cells.append([
            line["method"], between(line["read"]), between(line["read removed"], 0),
            *(number(line[key][0], 1) for key in ("base", "middle", "turn")),
            between(line["seen removed"], 0), opened, number(line.get("iterations")),
            number(line.get("ms"), 1), line["unanswered"] or "",
        ])  # fmt: skip
    columns = ["method", "as read mm", "removed %", "exact", "3-D", "turn °", "seen removed %", "open mm"]
    report.print_table(title, [*columns, "its.", "ms", "< 2"], cells, note, detail=detail)


def print_contacts(rows: Rows) -> None:
    """Where the contacts are few: the same errors by the number of contacts."""
    cells, height = [], {"instant": "", "plane": "; vision right in height"}
    for experiment, name, method in BY_CONTACTS:
        mine = report.chosen(rows, experiment=experiment, object=name, method=method)
        for n in sorted(report.distinct(mine, "contacts"), reverse=True):
            few = report.chosen(mine, contacts=n)
            before, after = (report.values(few, key) for key in ("vision read", "read"))
            cells.append([f"{name}: {method}{height[experiment]}", n, len(few), f"{before.mean():.1f}"])
            cells[-1] += [between(mean_interval(after)), between(removed_interval(before, after), 0)]
    columns = ["", "contacts", "grasps", "vision mm", "as read mm", "removed %"]
    report.print_table("One instant, by the number of contacts", columns, cells, detail=True)


def print_regions(rows: Rows) -> None:
    """How often the truth is inside the stated regions."""

    def share(level: str) -> report.Cell:
        def cell(rows: Rows) -> str:
            inside = 100 * report.values(rows, level).mean()
            return f"{inside:.0f}±{np.sqrt(inside * (100 - inside) / len(rows)):.0f}"

        return cell

    def freedom(rows: Rows) -> str:
        return f"{(report.values(rows, 'squared') / report.values(rows, 'freedom')).mean():.2f}"

    report.print_by(
        "Truths inside the stated regions, one instant, %",
        [
            row
            for row in report.chosen(rows, experiment="instant")
            if "in 50%" in row and row["method"] in SHOWN
        ],
        "object, method",
        {"50 % region": share("in 50%"), "95 % region": share("in 95%"), "χ² per freedom": freedom},
        "± one standard error; modulo symmetry; 1.00 is honest, less is modest. The "
        "maximum has the mean's covariance.",
    )


def print_sensing(sensing: dict[str, Sensing]) -> None:
    """Location errors of contacts."""
    labels = {"clean": "no noise", "noisy": "10 mN, 0.05 mN m"}
    rows = [
        {"object": name, "noise": labels[key], "um": 1e6 * error}
        for name, found in sensing.items()
        for key, errors in found.items()
        for error in errors
    ]
    cells = {
        "contacts": report.count,
        "mean": lambda rows: between(mean_interval(report.values(rows, "um")), 0),
        "median": report.of("um", ".0f", np.median),
        "95 %": report.of("um", ".0f", report.quantile(0.95)),
    }
    title = "Contact sensing from simulated wrenches, location error [µm]"
    note = "Tips that touch the object and nothing else; joints exact. The paper's sensor: 266 µm."
    report.print_by(title, rows, "object, noise", cells, note)


def measured(options: report.Options, runs: int) -> tuple[Rows, Row]:
    """Everything: per object rows and summaries of the experiments."""
    found: Row = {key: {} for key in ("instant", "plane", "time", "sensing", "left out")}
    rows = Rows()
    for name in OBJECTS:
        instant, plane, found["sensing"][name], left = one_instant(options, name)
        moved, dropped = over_time(options, name, runs)
        found["left out"][name] = left | {"manipulations": dropped}
        for key, mine in (("instant", instant), ("plane", plane), ("time", moved)):
            found[key][name] = summarised(mine)
            rows += [{"experiment": key, **row} for row in mine]
    return rows, found


def printed(found: Row, rows: Rows, runs: int) -> None:
    """All tables."""
    for name in OBJECTS:
        left = found["left out"][name]
        note = (
            f"Left out: {_counted(left['grasps'], 'grasps')}. Touching fingers without a contact: "
            f"{_counted(left['fingers'], 'fingers')}. its.: mean; ms: median, {report.machine()}."
        )
        title = f"{name}: one instant, {found['instant'][name][0]['count']} grasps (synthetic)"
        instant = found["instant"][name]
        print_methods(title, [line for line in instant if line["method"] in SHOWN], note)
        title = f"{name}: the same grasps, vision right in height (the paper's method alone)"
        print_methods(title, found["plane"][name], "Ours knows the height by the table.", detail=True)
        if found["time"][name]:
            title = (
                f"{name}: over time, last third of {runs} manipulations, palm turned by up to 75° (synthetic)"
            )
            print_methods(title, found["time"][name], f"Dropped: {left['manipulations']} of {runs} runs.")
    print_contacts(rows)
    print_regions(rows)
    print_sensing(found["sensing"])


def _counted(counts: dict[str, int], what: str) -> str:
    return ", ".join(f"{n} {what} {reason}" for reason, n in counts.items()) or "none"


@report.or_skip
def main() -> None:
    """Runs the experiments."""
    options = report.options(__doc__, trials=100, quick_trials=6)
    runs = 1 if options.quick else RUNS
    rows, found = measured(options, runs)
    printed(found, rows, runs)
    report.write_csv(options.output / "section_3.csv", rows)
    found["sensing"] = {
        name: {key: 1e6 * float(np.mean(v)) for key, v in errors.items()}
        for name, errors in found["sensing"].items()
    }
    path = options.output / "section_3.json"
    kept = {"seed": options.seed, "grasps": options.trials, "runs": runs, **found}
    path.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    report.wrote(path)


if __name__ == "__main__":
    main()
