"""One correction against one descent of many, and against one with points of the hand; on one core."""

from dataclasses import replace
from typing import Any

import numpy as np

import handsight as hs
from benchmarks import timing, workload
from benchmarks.kernels import alone, descents
from testbed import scenes

HAND = 100
"""Points of the hand."""
COUNT = 4096
"""Descents of a batch."""
Row = dict[str, Any]


def run(seconds: float) -> tuple[list[Row], dict[str, Any]]:
    """Returns rows and ratios.

    Each correction follows a batch in turn: one that follows another finds what they share in the cache.
    """
    problem = workload.draw("box", workload.NEAR, 1)
    scene = problem.scene
    hand = scenes.behind_contacts(scene, HAND)
    given = problem.model, scene.contacts
    many = descents(problem, COUNT)
    held = descents(replace(problem, outside=hand), COUNT)
    calls = [
        ("one correction", lambda: hs.correct_pose(*given, vision=scene.vision)),
        ("descents", many),
        ("with a hand", lambda: hs.correct_pose(*given, vision=scene.vision, outside=hand)),
        ("descents with a hand", held),
    ]
    with alone():
        times = timing.in_turn(calls, seconds)
    single = times["one correction"]
    with_hand = times["with a hand"]
    each = times["descents"] / COUNT
    each_held = times["descents with a hand"] / COUNT
    rows = [
        {"name": "one correction, the public call", **timing.summary(single)},
        {"name": f"the same with {HAND} points of the hand", **timing.summary(with_hand)},
        {"name": "a descent of many", "per_second": 1 / float(np.median(each)), **timing.summary(each)},
        {"name": f"a descent of many with {HAND} points of the hand"}
        | {"per_second": 1 / float(np.median(each_held)), **timing.summary(each_held)},
    ]
    return rows, {
        "descent of many / single": timing.ratio(each, single),
        f"{HAND} points of the hand / none": timing.ratio(with_hand, single),
    }
