"""What a tracker costs: one update from raw joints and wrenches, many of them, and a recording from its file.

Synthetic: a Shadow hand with five six-axis tips holds a can in MuJoCo. The updates go round the same second of a held
grasp, a millisecond apart, with a seen pose every tenth of a second; "corrected" asks for a hundred corrections a
second. What a sight costs (an update that brings a pose from vision), and a step of a correction, is told apart from
the others by the CPU time of the thread: while a grasp is held, where vision's constant error leaves a wide prior, and
while it is carried and turned, which tells the error. No peer does the same, so there is no ratio but to real time.
"""

import argparse
import gc
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import handsight as hs
from handsight.recording import open_recording
from handsight.rig import Rig
from handsight.simulation import Scenario, model_of, rig_of, simulate
from handsight.tracking import TrackerSettings
from handsight.tracking.replay import Tally, replay
from testbed import report
from testbed.recordings import record

STEP, SEEN_EVERY, RATE, QUANTILES = 1e-3, 0.1, 500.0, (0.5, 0.9, 0.99, 1.0)
KINDS = {
    "held": TrackerSettings(),
    "corrected": TrackerSettings(rate=100),
    "corrected, no points of the hand": TrackerSettings(rate=100, outside=0),
}


def held_grasp() -> tuple[list[hs.Observation], list[hs.Observation]]:
    """Returns observations of a can that is grasped, and of the part in which it is in hand."""
    samples = list(simulate(Scenario(object="can", seed=1)))
    return [s.observation for s in samples], [s.observation for s in samples if s.phase == "hold"]


def stream(held: list[hs.Observation], begin: float, count: int) -> Iterator[hs.Observation]:
    """Yields the part in hand again and again, `STEP` apart."""
    seen = [observation.vision for observation in held if observation.vision is not None]
    every = round(SEEN_EVERY / STEP)
    for k in range(count):
        looked = seen[k // every % len(seen)] if k % every == 0 else None
        yield replace(held[k % len(held)], stamp=begin + STEP * k, vision=looked)


def resident() -> float:
    """Returns the megabytes of this process in memory."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def updated(kind: str, count: int) -> list[str]:
    """Returns a row of the table."""
    grasp, held = held_grasp()
    tracker = hs.Tracker(rig_of(Scenario()), model_of(Scenario()), settings=KINDS[kind])
    for observation in grasp:
        tracker.update(observation)
    took, corrections = np.full(count, np.nan), tracker.corrections  # all of its pages now
    memory, began = [], time.perf_counter()
    for k, observation in enumerate(stream(held, 10.0, count)):
        if k % max(count // 10, 1) == 0:
            memory.append(resident())
        begin = time.perf_counter()
        tracker.update(observation)
        took[k] = time.perf_counter() - begin
    memory.append(resident())
    median, tail = 1e6 * np.quantile(took, [0.5, 0.99])
    kept = f"{count} | {tracker.corrections - corrections} | {median:.0f} | {tail:.0f}"
    rate = count / (time.perf_counter() - began)
    return [kind, *kept.split(" | "), f"{rate:.0f}", f"{memory[1]:.0f}", f"{memory[-1]:.0f}", tracker.state]


def cpu(name: str, scenario: Scenario) -> list[str]:
    """Returns a row: the cost of an update with vision's pose, of another that runs a correction's step, and of one
    that runs none, along a simulated recording; and the median error of the object's middle in its second half [mm].
    """
    tracker, took, kinds, errors = hs.Tracker(rig_of(scenario), model_of(scenario)), [], [], []
    model, middle = tracker.model, np.append(tracker.model.center_object, 1.0)
    gc.collect()
    gc.freeze()  # as a node does
    for sample in simulate(scenario):
        before, begin = tracker.track_state, time.thread_time()
        tracker.update(sample.observation)
        took.append(1e6 * (time.thread_time() - begin))
        ended = tracker.corrections > before.monitor.corrections
        stepped = ended or tracker.track_state.search is not None or before.search is not None
        kinds.append("sight" if sample.observation.vision is not None else "step" if stepped else "none")
        if tracker.estimate is not None:
            T = tracker.estimate.T_palm_object
            errors.append(np.linalg.norm((T - model.nearest(sample.T_palm_object, T)) @ middle))
    costs, off = np.array(took), 1e3 * np.median(errors[len(errors) // 2 :])
    every = [np.quantile(costs[np.array(kinds) == kind], QUANTILES) for kind in ("sight", "step", "none")]
    return [name, *(" ".join(f"{value:4.0f}" for value in each) for each in every), f"{off:.1f}"]


def print_cpu() -> None:
    """Prints the cost of updates with vision's pose."""
    cells = [
        cpu(f"{thing}, {how}", Scenario(object=thing, seed=1, motion=motion, rate=RATE))
        for thing in ("can", "box")
        for how, motion in (("held", "grasp"), ("carried", "manipulate"))
    ]
    title = (
        f"CPU of Tracker.update, {RATE:.0f} a second, ten sights among them: median, 90 %, 99 %, most [µs]"
    )
    columns = " | with a sight | with a step | with neither | off by mm"
    report.print_table(title, columns, cells, report.machine())


def replayed(images: bool, repeats: int) -> list[str]:
    """Returns a row: a recording of 18.4 s (1.9 s with images) from file to poses, a hundred corrections a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "can.mcap"
        scenario = Scenario(object="can", seed=1, motion="grasp" if images else "manipulate", images=images)
        record(scenario, path)
        rig = Rig.from_file(path.with_name("can.rig.yaml"))
        tallies = []
        for _ in range(repeats):
            tracker, tally = hs.Tracker(rig, model_of(scenario), settings=TrackerSettings(rate=100)), Tally()
            with open_recording(path, rig) as recording:
                for _step in replay(recording.observations(), tracker, tally):
                    pass
            tallies.append(tally)
        factors = [tally.recorded / tally.wall for tally in tallies]
        size = path.stat().st_size / 1e6
    return [
        "with RGB-D at 30 Hz" if images else "no images",
        f"{tally.recorded:.1f}",
        f"{size:.1f}",
        str(tracker.corrections),
        f"{np.median(factors):.1f}",
        f"{min(factors):.1f}-{max(factors):.1f}",
    ]


def main() -> None:
    """Prints the tables."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add, positive = arguments.add_argument, report.at_least(1)
    add("--updates", type=positive, default=20_000, help="of each kind (default: %(default)s)")
    add("--repeats", type=positive, default=5, help="of each recording (default: %(default)s)")
    add("--cpu", action="store_true", help="what a sight costs, and nothing else")
    given = arguments.parse_args()
    if not given.cpu:
        cells = [updated(kind, given.updates) for kind in KINDS]
        columns = (
            " | updates | corrections | median µs | 99 % µs | a second | MB at 10 % | MB at the end | state"
        )
        title = "Tracker.update, five fingers on a can (synthetic)"
        report.print_table(title, columns, cells, report.machine())
    print_cpu()
    if not given.cpu:
        cells = [replayed(images, given.repeats) for images in (False, True)]
        columns = " | seconds | MB | corrections | times real time | least-most"
        report.print_table("handsight track without its figure", columns, cells, report.machine())


if __name__ == "__main__":
    main()
