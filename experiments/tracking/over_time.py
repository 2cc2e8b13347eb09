"""Whole manipulations with default settings: how far off the tracker is, and how honest about it.

The row `usual` of `harsh.py`, object by object. Each is grasped, moved over the table, lifted and turned (18 s), from
ten seeds: another hand, camera, table and grasp each. Runs in which it is dropped are left out. YCB meshes are used
where the data folder is present. Synthetic (MuJoCo).

  inside   share of instants, from 2 s on, whose 95 % region holds the truth (modulo symmetry), mean over runs
  mean     error of the object's middle [mm], over the same instants; last: over the last third of a run
"""

import numpy as np

from experiments.tracking.harsh import RATE, objects, runs
from testbed import report, ycb
from testbed.report import Rows

MESHES = (
    "master_chef_can", "sugar_box", "mustard_bottle", "tuna_fish_can", "bleach_cleanser", "wood_block",
)  # fmt: skip
CELLS = {
    "held": report.count,
    "inside": report.of("inside"),
    "worst run": report.of("inside", ".2f", np.min),
    "mean mm": report.of("mean", ".1f"),
    "last mm, median": report.of("last", ".1f", np.median),
    "turn °": report.of("turn", ".1f"),
    "tracking": report.of("tracking"),
    "× real time": report.of("speed", ".0f", np.median),
}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    options = report.options(__doc__, trials=10, quick_trials=2)
    there = [name for name in ("can", "box", *MESHES) if name in objects()]
    chosen = there[:2] if options.quick else there
    tasks = [
        (name, options.first_seed + k, ("usual",), RATE) for name in chosen for k in range(options.trials)
    ]
    rows: Rows = [row for found in ycb.in_parallel(runs, tasks, "manipulations") for row in found]
    title = f"Manipulations with default settings, {options.trials} seeds each (synthetic)"
    note = f"95 % is honest. Palm turned by up to 75°. {report.machine()}"
    every = [row | {"object": "all"} for row in rows]
    report.print_by(title, rows + every, "object", CELLS, note)
    report.write_csv(options.output / "over_time.csv", rows)


if __name__ == "__main__":
    main()
