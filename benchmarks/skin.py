"""What tactile surfaces cost a tracker: updates at 100 Hz with taxels on five tips and on the palm. Synthetic.

A Shadow hand holds a can against its palm in MuJoCo; three-axis taxels on its tips read what the tips' wrenches say,
those of the palm an elastic skin. The updates go round the same half second of a held grasp. Each kind is updated in
turn with the others, so that their ratios do not depend on what else the machine does. Some updates bring a correction,
a share `corrected`; `uncorrected` is the median of the rest, and the difference of two of these is what a pressed palm
costs by itself. A search is a correction from scratch.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import handsight as hs
from benchmarks import timing
from handsight.contact import TactileSurface
from handsight.rig import Rig
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.simulation.scene import CAN_SIZE
from handsight.simulation.taxels import T_PALM_GRID, Solid
from testbed import report, skin_scenes, tip_scenes

SCENARIO = Scenario(object="can", seed=1, motion="grasp", rate=100, skin=True)
SIZES = {"174": (30, 0.0047, (6, 4)), "1010": (160, 0.002, (15, 14))}
"""By the number of taxels: those of a tip, their pitch [m], and the rows and columns on the palm's 60 x 80 mm."""
ROUND = 50
"""Observations that are gone round."""


def with_surfaces(rig: Rig, size: str) -> tuple[Rig, dict[str, tip_scenes.Shape]]:
    """Returns the rig with three-axis taxels on its tips and on its palm, and the tips' shapes."""
    taxels, pitch, (rows, columns) = SIZES[size]
    palm = TactileSurface.grid(
        frame=rig.hand.palm, T_frame_grid=T_PALM_GRID, rows=rows, columns=columns, pitch=0.06 / columns,
        threshold=0.03, components=3,
    )  # fmt: skip
    rig, shapes = tip_scenes.with_taxels(
        replace(rig, skin={}), np.random.default_rng(0), taxels=taxels, pitch=pitch
    )
    return replace(rig, skin=dict(rig.skin) | {"palm": palm}), shapes


def observed(rig: Rig, shapes: dict[str, tip_scenes.Shape], samples: list[Any]) -> list[hs.Observation]:
    """Returns the samples' observations with readings of the rig's taxels."""
    palm, solid, rng = rig.skin["palm"], Solid.cylinder(*CAN_SIZE), np.random.default_rng(1)
    flat = TactileSurface.grid(
        frame=palm.frame, T_frame_grid=T_PALM_GRID, rows=palm.places[0], columns=palm.places[1],
        pitch=palm.pitch, threshold=0.03,
    )  # fmt: skip
    given = [replace(sample.observation, skin={}) for sample in samples]
    found, rest = list[hs.Observation](), samples[0].observation.skin["palm"]  # its offsets, in the open hand
    for sample, tips in zip(samples, tip_scenes.taxel_observations(rig, shapes, given, 3), strict=True):
        force = float((sample.observation.skin["palm"] - rest).sum())
        push = skin_scenes.taxel_forces(flat, solid, sample.T_palm_object, force if force > 0.3 else 0.0)
        reading = np.stack([0.3 * push, 0.0 * push, push], axis=2)
        reading = reading * (1 + 0.05 * rng.normal(size=reading.shape)) + 2e-3 * rng.normal(
            size=reading.shape
        )
        found.append(replace(tips, skin=dict(tips.skin) | {"palm": reading}))
    return found


class Held:
    """A tracker that goes round observations of a held grasp, 10 ms from one to the next."""

    def __init__(self, rig: Rig, grasp: list[hs.Observation], *, palm: bool) -> None:
        """Follows the grasp to its end; without `palm` nothing is pressed there."""
        self.rig, self.tracker = rig, hs.Tracker(rig, model_of(SCENARIO))
        grasp = grasp if palm else [self._without(each) for each in grasp]
        for each in grasp:
            self.tracker.update(each)
        self.held, self.k = grasp[-ROUND:], 0
        self.corrected: list[bool] = []
        """Of each update since, whether it brought a correction."""

    def _without(self, observation: hs.Observation) -> hs.Observation:
        return replace(
            observation, skin=dict(observation.skin) | {"palm": np.zeros(self.rig.skin["palm"].shape)}
        )

    def update(self) -> None:
        """Updates the tracker once."""
        self.k += 1
        stamp, before = 100 + 0.01 * self.k, self.tracker.corrections
        self.tracker.update(replace(self.held[self.k % ROUND], stamp=stamp, vision=None))
        self.corrected.append(self.tracker.corrections > before)

    def search(self) -> Callable[[], object]:
        """Returns a correction from scratch by what the tracker has measured last."""
        tracker = self.tracker
        touched, pressed = tracker.fingertips.contacts, tracker.skin.evidence()
        assert touched is not None
        assert tracker.estimate is not None
        vision = hs.PosePrior.from_sigmas(tracker.estimate.T_palm_object, 0.03, 0.1)
        return lambda: hs.correct_pose(tracker.model, touched, vision=vision, skin=pressed)


def run(seconds: float) -> list[list[str]]:
    """Returns the rows of the table: updates and searches, each kind in turn with the others."""
    samples, rows, hands = list(simulate(SCENARIO)), list[list[str]](), {}
    known = replace(rig_of(SCENARIO), table=None)  # whose evidence would cost as much as all taxels
    for size in SIZES:
        rig, shapes = with_surfaces(known, size)
        grasp = observed(rig, shapes, samples)
        for palm in (False, True):
            hands[size, palm] = Held(rig, grasp, palm=palm)
    wrenches = Held(replace(known, skin={}), [replace(s.observation, skin={}) for s in samples], palm=True)
    named = {True: ", palm pressed", False: ""}
    all_hands = {"wrenches alone": wrenches}
    all_hands |= {f"{size} taxels{named[palm]}": hand for (size, palm), hand in hands.items()}
    took = timing.in_turn([(name, hand.update) for name, hand in all_hands.items()], seconds, most=10**6)
    usual = dict[str, float]()
    for name, each in took.items():
        corrected = np.array(all_hands[name].corrected[1:])  # the first round does not count
        usual[name] = 1e6 * float(np.median(each[~corrected]))
        ratio = timing.ratio(each, took["wrenches alone"])["ratio"]
        median, tail = 1e6 * np.quantile(each, [0.5, 0.99])
        cells = [f"{median:.0f}", f"{tail:.0f}", f"{ratio:.2f}", f"{usual[name]:.0f}"]
        rows.append([name, "update", *cells, f"{corrected.mean():.2f}", all_hands[name].tracker.state])
    for size in SIZES:
        more = usual[f"{size} taxels{named[True]}"] - usual[f"{size} taxels"]
        rows.append([f"{size} taxels, a pressed palm by itself", "update", "", "", "", f"{more:.0f}", "", ""])
    searches = [(name, hand.search()) for name, hand in all_hands.items()]
    took = timing.in_turn(searches, seconds, most=10**4)
    for name, each in took.items():
        ratio = timing.ratio(each, took["wrenches alone"])["ratio"]
        median, tail = 1e6 * np.quantile(each, [0.5, 0.99])
        rows.append([name, "search", f"{median:.0f}", f"{tail:.0f}", f"{ratio:.2f}", "", "", ""])
    return rows


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="of updates, and of searches (default: %(default)s)"
    )
    given = parser.parse_args()
    columns = ["", "", "median µs", "99 % µs", "× wrenches", "uncorrected µs", "corrected", "state"]
    report.print_table(
        "Tracker.update with tactile surfaces (synthetic)", columns, run(given.seconds), report.machine()
    )


if __name__ == "__main__":
    main()
