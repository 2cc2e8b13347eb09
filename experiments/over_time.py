"""Whole manipulations with default settings: how far off the tracker is, and how honest about it.

Each object is grasped, moved over the table, lifted and turned (18 s), from ten seeds: another hand, camera, table and
grasp each. Runs in which it is dropped are left out. YCB meshes are used where the data folder is present. Synthetic
(MuJoCo).

  inside   share of instants, from 2 s on, whose 95 % region holds the truth (modulo symmetry), mean over runs
  mean     error of the object's middle [mm], over the same instants; last: over the last third of a run
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.tracking.replay import Tally, replay
from shared import report, scenes, ycb
from testbed.report import Row, Rows

MESHES = (
    "002_master_chef_can", "004_sugar_box", "006_mustard_bottle",
    "007_tuna_fish_can", "021_bleach_cleanser", "036_wood_block",
)  # fmt: skip
RATE = 50.0
AT_REST = 2.0
"""From then on the object is in the hand alone [s]."""
LAST = 2 / 3
"""Of a run, from which on errors are those of its last third."""


def objects() -> dict[str, str]:
    """Returns the arguments `object` of `Scenario` by name."""
    folder = ycb.data_folder()
    meshes = {name[4:]: f"{folder}/ycb_meshes/{name}.ply" for name in MESHES} if folder else {}
    return {"can": "can", "box": "box"} | meshes


@cache
def known(name: str) -> hs.ObjectModel:
    """Returns the robot's model of an object, the same for all seeds."""
    return model_of(Scenario(object=name))


def run(name: str, seed: int) -> Row | None:
    """Returns the results of one manipulation; None where the object was dropped."""
    scenario = Scenario(object=name, seed=seed, motion="manipulate", rate=RATE)
    samples = list(simulate(scenario))
    if any(sample.dropped for sample in samples):
        return None
    truths = {sample.observation.stamp: sample.T_palm_object for sample in samples}
    model, tally = known(name), Tally()
    tracker = hs.Tracker(rig_of(scenario), model)
    steps = list(replay((sample.observation for sample in samples), tracker, tally))
    rows = [judged(model, step.estimate, truths[step.stamp]) for step in steps if step.stamp >= AT_REST]
    last = [row["off"] for row in rows[int(LAST * len(rows)) :]]
    means = {
        key: float(np.mean([row[key] for row in rows])) for key in ("off", "turn", "inside", "consistent")
    }
    return means | {"last": float(np.mean(last)), "speed": tally.recorded / tally.wall}


def judged(model: hs.ObjectModel, estimate: hs.PoseEstimate, T: report.Array) -> Row:
    """Returns the errors of an estimate, in millimetres and degrees, and by its own covariance."""
    T_near = scenes.nearest_truth(model, T, estimate.T_palm_object)
    middle = np.append(model.center_object, 1.0)
    off = np.linalg.norm((estimate.T_palm_object - T_near) @ middle)
    squared, freedom = scenes.chi2(model, estimate.T_palm_object, estimate.information, T)
    inside = bool(squared < chdtri(freedom, 0.05))
    _, turn = scenes.off(estimate.T_palm_object, T_near)
    return {"off": 1e3 * off, "turn": np.rad2deg(turn), "inside": inside, "consistent": estimate.consistent}


def runs(name: str, options: report.Options) -> Iterator[Row]:
    """Returns the runs in which the hand held the object."""
    for k in report.progress(range(options.trials), name):
        found = run(objects()[name], options.first_seed + k)
        if found is not None:
            yield {"object": name, "seed": options.first_seed + k, **found}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    said = "an object; repeatable (default: all)"
    arguments.add_argument("--only", action="append", choices=objects(), metavar="NAME", help=said)
    options, given = report.parsed(arguments, trials=10, quick_trials=2)
    chosen = given.only or (list(objects())[:2] if options.quick else list(objects()))
    rows: Rows = []
    table = []
    for name in chosen:
        mine = list(runs(name, options))
        rows += mine
        table.append([name, len(mine), *cells(mine)] if mine else [name, 0])
    if rows:
        table.append(["all", len(rows), *cells(rows)])
    report.print_table(
        f"Manipulations with default settings, {options.trials} seeds each (synthetic)",
        [
            "object",
            "held",
            "inside",
            "worst run",
            "mean mm",
            "last mm, median",
            "turn °",
            "consistent",
            "× real time",
        ],
        table,
        f"95 % is honest. Palm turned by up to 75°. {report.machine()}",
    )
    report.write_csv(options.output / "over_time.csv", rows)


def cells(rows: Rows) -> list[str]:
    """Returns the cells of the table for some runs."""
    inside = report.values(rows, "inside")
    return [
        f"{inside.mean():.2f}", f"{inside.min():.2f}", f"{report.values(rows, 'off').mean():.1f}",
        f"{np.median(report.values(rows, 'last')):.1f}", f"{report.values(rows, 'turn').mean():.1f}",
        f"{report.values(rows, 'consistent').mean():.2f}", f"{np.median(report.values(rows, 'speed')):.0f}",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
