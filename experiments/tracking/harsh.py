"""The tracker where the world is not as it believes: one thing wrong a row, and at last everything.

Each object is grasped, moved over the table, lifted and turned (18 s), from ten seeds; runs in which it is dropped are
left out. One simulation serves all rows but the last three, which change what happens. Default settings; YCB meshes
are used where the data folder is present. Synthetic (MuJoCo). From 2 s on, when the object is in the hand alone:

  mean, last   error of the object's middle, and over the last third of a run; turn: of its rotation
  inside       share of instants whose 95 % region holds the truth (modulo symmetry); worst: the worst run's
  tracking     share of instants in that state: the rest says that something is wrong
  unsaid       share of instants in that state at which it is more than 15 mm off
  trusted      mean error of the instants in that state, as a multiple of the usual error of the same grasps
  named        share of runs whose reason says that it is another object, within 2 s of the grasp

`--quick` leaves out two worlds.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

import handsight as hs
from handsight import se3
from handsight.simulation import Nuisances, Sample, Scenario, model_of, rig_of
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.motion import FREE_AT
from handsight.simulation.simulate import Sensors, samples
from handsight.simulation.world import World
from testbed import report, scenes, ycb
from testbed.report import Array, Row, Rows

RATE, QUICK_RATE = 50.0, 25.0
"""Observations a second."""
SLOW = ("soft", "pyramid")
"""Rows that need a simulation of their own, which `--quick` leaves out unless they are named."""
AT_REST, LAST = 2.0, 2 / 3
"""Instants that count [s]; share of a run after which its last third begins."""
OFF = 0.015
"""An error that nobody should trust [m]."""
FIRST = 1.0
"""How long the row `first` has vision [s]."""
NAMED = "another object"
"""Words of a tracker's reason."""
NAMED_IN = 2.0
"""Time within which they are to be said [s]."""
TIP = 5e-4
"""How much smaller than the true tips those of the row `tip` are believed [m]."""


@dataclass(frozen=True)
class Problem:
    """What a robot has recorded and what it believes."""

    samples: list[Sample]
    rig: hs.Rig
    model: hs.ObjectModel


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    title: str
    nuisances: Callable[[int], Nuisances] = lambda seed: Nuisances()
    """Of a seed."""
    believed: Callable[[Problem], Problem] = lambda problem: problem
    """Changes what the robot believes, or what reaches it."""


def first(problem: Problem) -> Problem:
    """Returns the problem without vision after the first second."""
    return replace(problem, samples=[blind(s) if s.observation.stamp > FIRST else s for s in problem.samples])


def blind(sample: Sample) -> Sample:
    """Returns a sample without vision."""
    return replace(sample, observation=replace(sample.observation, vision=None))


def table_off(height: float, tilt_deg: float) -> Callable[[Problem], Problem]:
    """Returns a change by which the rig's table is too high [m] and tilted [deg], with all else right."""

    def change(problem: Problem) -> Problem:
        # The world is described in the frame of the believed table.
        T = se3.compose(se3.rotation_exp(np.deg2rad([tilt_deg, 0.0, 0.0])), np.array([0.0, 0.0, -height]))
        rig, camera = problem.rig, problem.rig.camera
        assert camera is not None
        samples = []
        for sample in problem.samples:
            assert sample.observation.T_world_palm is not None
            T_world_palm = T @ sample.observation.T_world_palm
            samples.append(
                replace(sample, observation=replace(sample.observation, T_world_palm=T_world_palm))
            )
        camera = replace(camera, T_mount_camera=T @ camera.T_mount_camera)
        return replace(
            problem, samples=samples, rig=replace(rig, camera=camera, gravity=T[:3, :3] @ rig.gravity)
        )

    return change


def small_tips(problem: Problem) -> Problem:
    """Returns the problem with a rig whose tips are smaller than the true ones."""
    fingers = {name: replace(f, tip=f.tip.larger(-TIP)) for name, f in problem.rig.fingers.items()}
    return replace(problem, rig=replace(problem.rig, fingers=fingers))


def usual(**settings: float) -> Callable[[int], Nuisances]:
    """Returns the usual nuisances with some changed, for every seed."""
    return lambda seed: Nuisances(**settings)


CASES = {
    "usual": Case("usual"),
    "first": Case("vision in the first second only", believed=first),
    "table": Case("table believed 15 mm high, 3° off", believed=table_off(0.015, 3.0)),
    "low": Case("table believed 10 mm low", believed=table_off(-0.010, 0.0)),
    "other": Case("another object than told"),
    "tip": Case("tips .5 mm larger than told", believed=small_tips),
    "noise": Case("F/T noise × 3", usual(force_noise=0.03, torque_noise=1.5e-4)),
    "gain": Case("gain 3 %, backlash 50 mN", usual(force_gain=0.03, force_backlash=0.05)),
    "joints": Case("joint offsets 2°", usual(joint_offset=float(np.deg2rad(2.0)))),
    "late": Case("camera 200 ms late", usual(vision_delay=0.2)),
    "drift": Case(
        "camera bias wanders: 10 mm, 3°",
        usual(vision_drift_position=0.01, vision_drift_rotation=float(np.deg2rad(3.0))),
    ),
    "mass": Case("declared mass +10 %", usual(declared_mass=1.1)),
    "soft": Case("contacts twice as soft", usual(contact_softness=1.0)),
    "pyramid": Case("pyramidal friction", usual(pyramidal_friction=1.0)),
    "harsh": Case("harsh world: everything", Nuisances.harsh),
}
"""Rows by name. Those of one `physical` share a simulation."""


def physical(n: Nuisances) -> tuple[float, ...]:
    """Returns the nuisances that change what happens; all others change what is measured, or what is believed."""
    pull = n.pull_force, n.pull_torque, n.unsensed_force, n.support_force
    touch = n.friction, n.tip_size, n.contact_softness, n.pyramidal_friction, n.coupled_joint
    return (n.object_mass, n.object_off_center, *pull, *touch)


def objects() -> dict[str, str]:
    """Returns the arguments `object` of `Scenario` by name: can, box, and the YCB meshes that are here."""
    folder = ycb.data_folder()
    files = sorted((folder / "ycb_meshes").glob("*.ply")) if folder else []
    return {"can": "can", "box": "box"} | {file.stem[4:]: str(file) for file in files}


@lru_cache(maxsize=64)
def known(name: str, scale: float, mass: float, declared: float) -> hs.ObjectModel:
    """Returns the robot's model of an object, as the nuisances of its scale and masses have it."""
    nuisances = Nuisances(object_scale=scale, object_mass=mass, declared_mass=declared)
    return model_of(Scenario(object=objects()[name], nuisances=nuisances))


def told(name: str, n: Nuisances) -> hs.ObjectModel:
    """Returns `known` of some nuisances."""
    return known(name, n.object_scale, n.object_mass, n.declared_mass)


def runs(name: str, seed: int, keys: tuple[str, ...], rate: float) -> Rows:
    """Returns a row for each case of one object and seed in which the hand held the object."""
    scenario = Scenario(object=objects()[name], seed=seed, motion="manipulate", rate=rate)
    wanted, found = {key: CASES[key].nuisances(seed) for key in keys}, {}
    while wanted:
        truth = next(iter(wanted.values()))
        here = {key: n for key, n in wanted.items() if physical(n) == physical(truth)}
        wanted = {key: n for key, n in wanted.items() if key not in here}
        variants = list(dict.fromkeys(here.values()))
        recorded: list[list[Sample]] = [[] for _ in variants]
        try:
            here_scenario = replace(scenario, nuisances=truth)
            world = World(here_scenario, grasp_for(scenario.object, seed))
            sensors = [Sensors(replace(scenario, nuisances=n), world) for n in variants]
            for instant in samples(here_scenario, world, sensors):
                for run, sample in zip(recorded, instant, strict=True):
                    if sample is not None:
                        run.append(replace(sample, configuration=np.empty(0)))
                if any(run and run[-1].dropped for run in recorded):
                    break  # such a run is left out, and what falls off a table falls for the rest of it
        except hs.InvalidObject:  # thrown away by the simulator
            continue
        for key, n in here.items():
            run = recorded[variants.index(n)]
            if not any(sample.dropped for sample in run):
                model = told(other_than(name, seed) if key == "other" else name, n)
                problem = CASES[key].believed(Problem(run, rig_of(scenario), model))
                found[key] = {"row": key, "object": name, "seed": seed} | judged(problem, told(name, n))
    return [found[key] for key in keys if key in found]


def other_than(name: str, seed: int) -> str:
    """Returns another object's name, drawn by the seed."""
    others = [each for each in objects() if each != name]
    return others[int(np.random.default_rng(seed).integers(len(others)))]


def judged(problem: Problem, true_model: hs.ObjectModel) -> Row:
    """Returns the means over one run, and how often what is wrong is said."""
    tracker, model = hs.Tracker(problem.rig, problem.model), problem.model
    middle, true_middle = (np.append(m.center_object, 1.0) for m in (model, true_model))
    spent, said, counted = 0.0, np.inf, list[tuple[float, ...]]()
    for sample in problem.samples:
        begin = time.process_time()
        estimate = tracker.update(sample.observation)
        spent += time.process_time() - begin
        stamp = sample.observation.stamp
        if NAMED in tracker.reason:
            said = min(said, stamp - FREE_AT)
        if stamp < AT_REST or estimate is None:
            continue
        if model is not true_model:  # the poses of two objects differ by their frames
            off = (estimate.T_palm_object @ middle - sample.T_palm_object @ true_middle)[:3]
            turn, inside = 0.0, False
        else:
            T_near = scenes.nearest_truth(model, sample.T_palm_object, estimate.T_palm_object)
            off = ((estimate.T_palm_object - T_near) @ middle)[:3]
            _, turn = scenes.off(estimate.T_palm_object, T_near)
            squared, freedom = scenes.chi2(
                model, estimate.T_palm_object, estimate.information, sample.T_palm_object
            )
            inside = squared < chdtri(freedom, 0.05)
        counted.append((float(np.linalg.norm(off)), np.rad2deg(turn), inside, tracker.state == "tracking"))
    errors, turns, inside_, tracking = np.array(counted, dtype=float).reshape(-1, 4).T
    ends = errors[int(LAST * len(errors)) :]
    return {
        "mean": 1e3 * mean(errors), "last": 1e3 * mean(ends), "turn": mean(turns), "inside": mean(inside_),
        "tracking": mean(tracking), "unsaid": mean(tracking * (errors > OFF)),
        "trusted": 1e3 * mean(errors[tracking > 0]), "named": said <= NAMED_IN,
        "speed": problem.samples[-1].observation.stamp / spent,
    }  # fmt: skip


def mean(values: Array) -> float:
    """Returns the mean of those that are no NaN; NaN of none."""
    finite = values[~np.isnan(values.astype(float))]
    return float(finite.mean()) if len(finite) else np.nan


def trusted(rows: Rows) -> str:
    """The cell of the error while tracking, as a multiple of the usual one."""
    return f"{mean(report.values(rows, 'trusted')) / mean(report.values(rows, 'usual')):.2f}"


CELLS: dict[str, report.Cell] = {
    "runs": report.count,
    "mean mm": report.of("mean", ".1f"),
    "last": report.of("last", ".1f"),
    "turn °": report.of("turn", ".1f"),
    "inside": report.of("inside"),
    "worst": report.of("inside", ".2f", np.min),
    "tracking": report.of("tracking"),
    "unsaid": report.of("unsaid", ".3f"),
    "trusted ×": trusted,
    "named": report.of("named"),
    "× real time": report.of("speed", ".0f"),
}


@report.or_skip
def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    add = arguments.add_argument
    add(
        "--only",
        action="append",
        choices=objects(),
        metavar="NAME",
        help="an object; repeatable (default: all)",
    )
    add(
        "--row", action="append", choices=CASES, metavar="NAME", help=f"one of {', '.join(CASES)}; repeatable"
    )
    options, given = report.parsed(arguments, trials=10, quick_trials=2)
    names = given.only or (list(objects())[:2] if options.quick else list(objects()))
    default = [key for key in CASES if not (options.quick and key in SLOW)]
    keys = tuple(key for key in CASES if key in (given.row or default) or key == "usual")
    rate = QUICK_RATE if options.quick else RATE
    tasks = [(name, options.first_seed + k, keys, rate) for name in names for k in range(options.trials)]
    rows = [row for found in ycb.in_parallel(runs, tasks, "manipulations") for row in found]
    rows.sort(key=lambda row: keys.index(row["row"]))
    usual_errors = {(row["object"], row["seed"]): row["mean"] for row in report.chosen(rows, row="usual")}
    for row in rows:
        row["world"] = CASES[row["row"]].title
        row["usual"] = usual_errors.get((row["object"], row["seed"]), np.nan)
    title = f"One thing wrong a row: {len(names)} objects, {options.trials} seeds each (synthetic)"
    report.print_by(title, rows, "world", CELLS, report.machine())
    report.write_csv(options.output / "harsh.csv", rows)


if __name__ == "__main__":
    main()
