"""Three-axis taxels in place of wrenches: slips, the object's weight, and a search by touch. All synthetic.

A simulated hand (MuJoCo) pulls and weighs as in `slip.py` and `weight.py`, and several kinds of sensors measure one and
the same motion: six-axis sensors behind the tips; taxels as XELA's (30 of three axes, 4.7 mm apart), PaXini's (116,
2.8 mm) and Inspire's (89, pressure alone), with all usual nuisances. 100 readings a second of a pull, 25 of a weighing.

  precision, recall, delay   of slips, as in `slip.py`: alarms that are right, slipping samples that are in alarm
  friction                   learnt in the end, off the truth: median and largest
  mass, centre               errors of the weighing after lift and tilt: medians, and the largest
  located                    searches by four touches that end within 8 mm and 8° of the truth, by taxels 4.7 mm from
                             each other around where the finger touches (`tests/tip_scenes.py`)
"""

from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

import handsight as hs
from handsight.correction import pose_distances
from handsight.forces import Slip, SlipDetector
from handsight.search import best_sweep
from handsight.simulation import PROBE, SCENARIO, Sample, Scenario, model_of, rig_of, start_search
from handsight.simulation.grasp_search import grasp_for
from handsight.simulation.scenario import SensorKind
from handsight.simulation.simulate import Sensors
from handsight.simulation.simulate import samples as samples_of
from handsight.simulation.touch_search import FINGER
from handsight.simulation.world import World
from handsight.tracking import FingertipSensors, SkinContacts, SkinSensors
from handsight.tracking.fingertips import FingertipContacts
from shared import report, slips, tip_scenes
from testbed.report import Array, Row, Rows

RATE, WEIGH_RATE, TOUCHES, SHIFT, TURN = 100.0, 25.0, 4, 0.008, float(np.deg2rad(8.0))
"""Samples a second of a pull and of a weighing; touches of a search; errors of what is located [m], [rad]."""
KINDS: tuple[SensorKind, ...] = ("wrench", "xela", "paxini", "inspire")
WAYS = {"wrench": 0, "xela": 3, "inspire": 1}
"""Components of a taxel in a search, by the kind in whose line it is counted; 0: no taxels."""


class Tips:
    """`Tips` are fingertips that measure with taxels what wrenches say."""

    def __init__(self, components: int, fingers: Collection[str]) -> None:
        """`components` of a taxel, 0 for wrenches; `fingers`: those with taxels."""
        self.rig, shapes = rig_of(Scenario()), dict[str, tip_scenes.Shape]()
        if components:
            self.rig, shapes = tip_scenes.with_taxels(
                self.rig, np.random.default_rng(0), components=components
            )
            shapes = {name: shape for name, shape in shapes.items() if name in fingers}
        self._sensors, self._skin = FingertipSensors(self.rig), SkinSensors(self.rig)
        self._waiting = deque[hs.Observation]()
        self._stream: Iterator[hs.Observation] = iter(self._waiting.popleft, None)
        if shapes:
            self._stream = tip_scenes.taxel_observations(self.rig, shapes, self._stream, 1)

    def contacts(self, observation: hs.Observation) -> FingertipContacts:
        """Returns what they measure of one observation, which has wrenches."""
        self._waiting.append(observation)
        given = next(self._stream)
        return self._sensors.contacts(given, None, self._skin.observed(given, touched=True))


def measured(scenario: Scenario, kinds: Sequence[SensorKind]) -> list[list[Sample]]:
    """Returns the samples of one motion by each kind of sensors, until the object is dropped."""
    world = World(scenario, grasp_for(scenario.object, scenario.seed))
    sensors = [Sensors(replace(scenario, sensors=kind), world) for kind in kinds]
    found: list[list[Sample]] = [[] for _ in kinds]
    for row in samples_of(scenario, world, sensors):
        for mine, sample in zip(found, row, strict=True):
            if sample is not None and not sample.dropped:
                mine.append(sample)
    return found


def detected(kind: SensorKind, samples: Sequence[Sample]) -> list[Slip]:
    """Returns whether the object slips at each sample, by one kind of sensors."""
    rig = rig_of(Scenario(sensors=kind))
    sensors, surfaces, detector = FingertipSensors(rig), SkinSensors(rig), SlipDetector(rig)
    skin, touched, found = SkinContacts(), False, []
    for observation in (sample.observation for sample in samples):
        skin = surfaces.observed(observation, skin, touched=touched)
        tips = sensors.contacts(observation, None, skin)
        touched = bool(tips.fingers)
        found.append(detector.update(observation.stamp, tips.fingers, tips.loads, (), tips.by_taxels))
    return found


def pull(name: str, seed: int, kinds: Sequence[SensorKind]) -> Rows:
    """Returns the alarms of each kind in one pull; none where the hand did not hold the object until then."""
    scenario, rows = slips.scenario(name, seed, RATE), list[Row]()
    for kind, samples in zip(kinds, measured(scenario, kinds), strict=True):
        if not any(sample.phase == "pull" for sample in samples):
            continue
        held = np.array([sample.phase != "close" for sample in samples])
        speeds = np.array([slips.speed(sample) for sample in samples])[held]
        stamps = np.array([sample.observation.stamp for sample in samples])[held]
        found = detected(kind, samples)
        alarms = np.array([each.slipping for each in found])[held]
        row: Row = {"what": "slip", "way": kind, "object": name, "seed": seed, "motion": scenario.motion}
        row |= slips.counted(alarms, speeds, 1 / RATE)
        delays = slips.delays(alarms, speeds, stamps)
        row["delays"] = " ".join("-" if d is None else f"{1e3 * d:.0f}" for d in delays)
        learnt, mu = found[-1].friction, scenario.nuisances.friction
        row |= {"friction": mu, "learnt": np.nan if learnt is None else 100 * (learnt / mu - 1)}
        unmeasured = np.array([bool(each.unmeasured) for each in found])[held]
        rows.append(row | {"unmeasured": float(unmeasured.mean())})
    return rows


def weighing(name: str, seed: int, kinds: Sequence[SensorKind]) -> Rows:
    """Returns the error of each kind's weighing of an object that is lifted and tilted."""
    scenario, rows = Scenario(object=name, seed=seed, motion="weigh", rate=WEIGH_RATE), list[Row]()
    for kind, samples in zip(kinds, measured(scenario, kinds), strict=True):
        tracker = hs.Tracker(rig_of(Scenario(object=name, sensors=kind)), model_of(scenario))
        for sample in samples:
            tracker.update(sample.observation)
        row: Row = {"what": "weight", "way": kind, "object": name, "seed": seed, "why": tracker.unweighed}
        if (weight := tracker.weight) is not None:
            off = weight.center_palm - samples[-1].T_palm_object[:3, 3]
            row["mass"] = 100 * (weight.mass / SCENARIO.object_mass - 1)
            row["centre"] = 1e3 * float(np.linalg.norm(off))
            row["nees mass"] = ((weight.mass - SCENARIO.object_mass) / weight.sigma_mass) ** 2
            row["nees centre"] = float(off @ np.linalg.solve(weight.covariance_palm, off)) / 3
            row["why"] = weight.reason
        rows.append(row)
    return rows


def search(name: str, seed: int) -> Rows:
    """Returns whether a search by each way locates the object."""
    rows: Rows = []
    for way, components in WAYS.items():
        scenario = Scenario(object=name, seed=seed)
        probe, belief = start_search(scenario, model_of(scenario))
        vars(probe)["_tips"] = Tips(components, [FINGER])
        for _ in range(TOUCHES):
            belief = belief.after(probe.touch(best_sweep(belief, probe.heights, PROBE.radius)))
        T, best = probe.T_world_object, belief.modes[0].pose_world_object.T_a_b
        shift, turn = (float(error[0]) for error in pose_distances(belief.model, T[None], best))
        row: Row = {"what": "search", "way": way, "object": name, "seed": seed, "mm": 1e3 * shift}
        rows.append(row | {"located": shift < SHIFT and turn < TURN})
    return rows


def cells(rows: Rows, way: str) -> list[str]:
    """Returns a line of the table."""
    pulls, weights, searches = (
        report.chosen(rows, what=what, way=way) for what in ("slip", "weight", "search")
    )
    total = {key: sum(int(row[key]) for row in pulls) for key in ("alarmed", "right", "slipped", "found")}
    shares = (("right", "alarmed"), ("found", "slipped"))
    line = [way, f"{len(pulls)}", *(f"{total[a] / total[b]:.3f}" if total[b] else "-" for a, b in shares)]
    known = [float(d) for row in pulls for d in row["delays"].split() if d != "-"]
    line.append("{:.0f}, {:.0f}".format(*np.percentile(known, [50, 90])) if known else "-")
    line.append(middle(np.array([row["learnt"] for row in pulls])))
    believed = [row for row in weights if "mass" in row and not row["why"]]
    line.append(f"{len(believed)}/{len(weights)}")
    line += [middle(np.array([row[key] for row in believed])) for key in ("mass", "centre")]
    return [*line, f"{sum(bool(row['located']) for row in searches)}/{len(searches)}"]


def middle(errors: Array) -> str:
    """Returns the median and the largest of the sizes of errors that are known."""
    known = np.abs(errors[np.isfinite(errors.astype(float))]) if len(errors) else errors
    return f"{np.median(known):.1f}, {known.max():.1f}" if len(known) else "-"


def main() -> None:
    """Runs the experiment."""
    arguments = report.parser(__doc__)
    arguments.add_argument(
        "--sensors", nargs="+", choices=KINDS, default=KINDS, help="kinds of sensors; default: all"
    )
    parts = ("slip", "weight", "search")
    arguments.add_argument("--parts", nargs="+", choices=parts, default=parts, help="default: all")
    options, given = report.parsed(arguments, trials=10, quick_trials=1)
    seeds, rows = [2000 + options.first_seed + k for k in range(options.trials)], list[Row]()
    for seed in report.progress(seeds, "seeds"):
        for name in ("can",) if options.quick else ("can", "box"):
            rows += pull(name, seed, given.sensors) if "slip" in given.parts else []
            rows += weighing(name, seed, given.sensors) if "weight" in given.parts else []
            rows += search(name, seed) if "search" in given.parts else []
            report.write_csv(options.output / "taxel_loads.csv", rows)
    columns = ["tips", "pulls", "precision", "recall", "delay ms, 90 %", "friction %"]
    columns += ["weighed", "mass %", "centre mm", "located"]
    table, note = [cells(rows, way) for way in given.sensors], "friction, mass, centre: median and largest"
    report.print_table("The same motions by wrenches and by taxels (synthetic)", columns, table, note)


if __name__ == "__main__":
    main()
