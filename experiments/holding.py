"""Does the simulated hand hold what it is given? Ten YCB meshes, ten seeds each, through lift and turn.

For each object and seed a grasp is searched (`handsight simulate MESH` does the same) and the manipulation is recorded
with it, the usual nuisances on. Held: the object is in the hand at the end, by the simulator's own criterion (within
3 cm and half a radian in the palm of where it was let go), and thumb and a finger touched it (over 0.1 N each) for at
least nine tenths of the time since. Trials: grasps simulated until one held. Fingers: how many tips touched it, on
average; thumb: how hard it pressed. Seconds are of CPU time.
"""

from pathlib import Path
from time import process_time

import numpy as np

from handsight.simulation import Sample, Scenario, find_grasp, simulate
from shared import report, ycb

RATE, TOUCHES, MOSTLY = 10.0, 0.1, 0.9
"""Samples a second; force above which a tip touches [N]; share of the time for which they must."""
QUICK = ("008_pudding_box", "011_banana")
MEDIANS = ("fingers", "thumb", "moved", "search", "record")
COLUMNS = ("object", "held", "trials", "most", "fingers", "thumb N", "moved mm", "search s", "record s")


def trial(mesh: Path, seed: int) -> report.Row:
    """What became of one object with one seed."""
    scenario = Scenario(object=str(mesh), seed=seed, motion="manipulate", rate=RATE)
    begin = process_time()
    found = find_grasp(scenario)
    searched = process_time()
    samples = [sample for sample in simulate(scenario, grasp=found.grasp) if sample.phase != "close"]
    touching = [_touching(sample) for sample in samples]
    both = np.mean(["th" in fingers and len(fingers) > 1 for fingers in touching])
    last, first = samples[-1].T_palm_object, samples[0].T_palm_object
    return {
        "object": mesh.stem, "seed": seed, "trials": found.trials, "hold": found.hold, "failures": found.failures,
        "held": bool(found.succeeded and not samples[-1].dropped and both >= MOSTLY),
        "fingers": float(np.mean([len(fingers) for fingers in touching])),
        "thumb": float(np.mean([sample.forces_object.get("th", 0.0) for sample in samples])),
        "moved": 1000 * float(np.linalg.norm(last[:3, 3] - first[:3, 3])),
        "search": searched - begin, "record": process_time() - searched,
    }  # fmt: skip


def _touching(sample: Sample) -> list[str]:
    """The fingers that touch the object."""
    return [finger for finger, force in sample.forces_object.items() if force > TOUCHES]


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    arguments.add_argument(
        "--only", action="append", metavar="NAME", help="an object; repeatable (default: all)"
    )
    options, given = report.parsed(arguments, trials=10, quick_trials=2)
    meshes = sorted((ycb.data_or_goodbye() / "ycb_meshes").glob("*.ply"))
    names = given.only or (QUICK if options.quick else [mesh.stem for mesh in meshes])
    chosen = [mesh for mesh in meshes if mesh.stem in names]
    tasks = [(mesh, options.first_seed + k) for mesh in chosen for k in range(options.trials)]
    rows: report.Rows = ycb.in_parallel(trial, tasks, "holding")
    report.write_csv(options.output / "holding.csv", rows)
    show(rows)


def show(rows: report.Rows) -> None:
    """Prints a line an object."""
    cells = []
    for name in report.distinct(rows, "object"):
        mine = report.chosen(rows, object=name)
        held = f"{sum(row['held'] for row in mine)} of {len(mine)}"
        trials = report.values(mine, "trials")
        middle = [f"{np.median(report.values(mine, key)):.1f}" for key in MEDIANS]
        cells.append([name, held, f"{np.median(trials):g}", f"{trials.max()}", *middle])
    report.print_table("Held through lift and turn (medians over seeds)", COLUMNS, cells)


if __name__ == "__main__":
    main()
