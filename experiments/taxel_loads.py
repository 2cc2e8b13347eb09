"""Three-axis taxels in place of wrenches: slips, the object's weight, and a search by touch. All synthetic.

A simulated hand (MuJoCo) pulls, carries and searches as in `slip.py`, `weight.py`, `blind.py`. Its fingertips measure
the same loads in three ways: by six-axis sensors; by 30 taxels of three axes, 4.7 mm apart, around where the finger
touches, without any wrench (an elastic skin, 5 % noise of each taxel, 3 % crosstalk, uneven by 0.15 mm); by the same
taxels with pressure alone.

  precision, recall   of slips, as in `slip.py`: alarms that are right, and slipping samples that are in alarm
  mass, centre        errors of the weighing after lift and tilt
  located             searches by four touches that end within 8 mm and 8° of the truth
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np

import handsight as hs
from handsight.correction import pose_distances
from handsight.forces import Slip
from handsight.search import best_sweep
from handsight.simulation import PROBE, SCENARIO, Scenario, model_of, rig_of, simulate, start_search
from handsight.simulation.probe import FINGER
from handsight.tracking import FingertipSensors, SkinSensors
from handsight.tracking.fingertips import FingertipContacts
from shared import report, slips, tip_scenes
from testbed.report import Array, Row, Rows

RATE, WEIGH_RATE, TOUCHES, SHIFT, TURN = 100.0, 25.0, 4, 0.008, float(np.deg2rad(8.0))
"""Samples a second of a pull and of a weighing; touches of a search; errors of what is located [m], [rad]."""
WAYS = {"wrenches": 0, "three axes": 3, "pressure": 1}
"""Components of a taxel, by what the tips have; 0: no taxels."""


class Tips:
    """`Tips` are fingertips that measure in one of the ways what wrenches say."""

    def __init__(
        self, way: str, fingers: Collection[str] = (), middles: Mapping[str, Array] | None = None
    ) -> None:
        """`way`: one of `WAYS`; `fingers`: those with taxels, all without any; `middles`: of their taxels."""
        self.rig, shapes = rig_of(Scenario()), dict[str, tip_scenes.Shape]()
        if components := WAYS[way]:
            self.rig, shapes = tip_scenes.with_taxels(
                self.rig, np.random.default_rng(0), components=components, middles=middles
            )
            shapes = {name: shape for name, shape in shapes.items() if name in (fingers or shapes)}
        self._sensors, self._skin = FingertipSensors(self.rig), SkinSensors(self.rig)
        self._waiting = deque[hs.Observation]()
        self._stream: Iterator[hs.Observation] = iter(self._waiting.popleft, None)
        if shapes:
            self._stream = tip_scenes.taxel_observations(self.rig, shapes, self._stream, 1)

    def observed(self, observation: hs.Observation) -> hs.Observation:
        """Returns an observation as these tips measure it."""
        self._waiting.append(observation)
        return next(self._stream)

    def contacts(self, observation: hs.Observation) -> FingertipContacts:
        """Returns what they measure of one observation, which has wrenches."""
        given = self.observed(observation)
        return self._sensors.contacts(given, None, self._skin.observed(given, touched=True))


def followed(way: str, samples: list[Any], model: hs.ObjectModel) -> tuple[hs.Tracker, list[Slip]]:
    """Returns a tracker after samples, and whether the object slipped at each."""
    observations = [sample.observation for sample in samples]
    tips, found = Tips(way, (), tip_scenes.places(rig_of(Scenario()), observations)), []
    tracker = hs.Tracker(tips.rig, model)
    for observation in observations:
        tracker.update(tips.observed(observation))
        found.append(tracker.slip)
    return tracker, found


def pull(name: str, seed: int) -> Rows:
    """Returns the alarms of each way in one pull; none where the hand did not hold the object until then."""
    scenario = slips.scenario(name, seed, RATE)
    samples = [sample for sample in simulate(scenario) if not sample.dropped]
    held = np.array([sample.phase != "close" for sample in samples])
    if samples[-1].phase == "close" or not any(sample.phase == "pull" for sample in samples):
        return []
    speeds, rows = np.array([slips.speed(sample) for sample in samples]), list[Row]()
    for way in WAYS:
        _, found = followed(way, samples, model_of(scenario))
        alarms = np.array([each.slipping for each in found])
        row: Row = {"what": "slip", "way": way, "object": name, "seed": seed}
        row |= slips.counted(alarms[held], speeds[held], 1 / RATE)
        unmeasured = [bool(each.unmeasured) for each in found]
        rows.append(row | {"unmeasured": float(np.mean(np.array(unmeasured)[held]))})
    return rows


def weighing(name: str, seed: int) -> Rows:
    """Returns the error of each way's weighing of an object that is lifted and tilted."""
    scenario = Scenario(object=name, seed=seed, motion="weigh", rate=WEIGH_RATE)
    samples, rows = [sample for sample in simulate(scenario) if not sample.dropped], list[Row]()
    for way in WAYS:
        tracker, _ = followed(way, samples, model_of(scenario))
        row: Row = {"what": "weight", "way": way, "object": name, "seed": seed, "why": tracker.unweighed}
        if (weight := tracker.weight) is not None:
            true = samples[-1].T_palm_object[:3, 3]
            row["mass"] = 100 * (weight.mass / SCENARIO.object_mass - 1)
            row["nees"] = ((weight.mass - SCENARIO.object_mass) / weight.sigma_mass) ** 2
            row["centre"] = 1e3 * float(np.linalg.norm(weight.center_palm - true))
        rows.append(row)
    return rows


def search(name: str, seed: int) -> Rows:
    """Returns whether a search by each way locates the object."""
    rows: Rows = []
    for way in WAYS:
        scenario = Scenario(object=name, seed=seed)
        probe, belief = start_search(scenario, model_of(scenario))
        vars(probe)["_tips"] = Tips(way, [FINGER])
        for _ in range(TOUCHES):
            belief = belief.after(probe.touch(best_sweep(belief, probe.heights, PROBE.radius)))
        T, best = probe.T_world_object, belief.modes[0].pose_world_object.T_a_b
        shift, turn = (float(error[0]) for error in pose_distances(belief.model, T[None], best))
        row: Row = {"what": "search", "way": way, "object": name, "seed": seed, "mm": 1e3 * shift}
        rows.append(row | {"located": shift < SHIFT and turn < TURN})
    return rows


def main() -> None:
    """Runs the experiment."""
    options, rows = report.options(__doc__, trials=10, quick_trials=1), list[Row]()
    seeds = [2000 + options.first_seed + k for k in range(options.trials)]
    for seed in report.progress(seeds, "seeds"):
        for name in ("can",) if options.quick else ("can", "box"):
            rows += [*pull(name, seed), *weighing(name, seed), *search(name, seed)]
    table = []
    for way in WAYS:
        pulls, weights, searches = (
            report.chosen(rows, what=what, way=way) for what in ("slip", "weight", "search")
        )
        total = {key: sum(int(row[key]) for row in pulls) for key in ("alarmed", "right", "slipped", "found")}
        cells = [
            f"{100 * total[a] / total[b]:.0f} %" if total[b] else "-"
            for a, b in (("right", "alarmed"), ("found", "slipped"))
        ]
        known = [row for row in weights if "mass" in row]
        mass, centre = (np.abs([float(row[key]) for row in known]) for key in ("mass", "centre"))
        cells += [f"{len(known)}/{len(weights)}"]
        cells += [f"{np.median(mass):.1f} %", f"{np.median(centre):.1f}"] if known else ["-", "-"]
        table.append(
            [way, len(pulls), *cells, f"{sum(bool(row['located']) for row in searches)}/{len(searches)}"]
        )
    report.print_table(
        "The same loads by wrenches and by taxels (synthetic)",
        ["tips", "pulls", "precision", "recall", "weighed", "mass", "centre mm", "located"],
        table,
        "",
    )
    report.write_csv(options.output / "taxel_loads.csv", rows)


if __name__ == "__main__":
    main()
