"""The sections of a run, each with its share of the time."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from benchmarks import batch, blind, closest, correction, frontier, kernels, machine, peers, startup, workload

Row = dict[str, Any]
QUICK = {"correction": 30.0, "batch": 3.0, "blind": 6.0, "closest": 6.0}
FULL = {"correction": 160.0, "batch": 10.0, "blind": 80.0, "closest": 30.0}
"""Seconds; startup takes what its processes take."""
NAMES = (*FULL, "startup")


@dataclass
class Suite:
    """One run: its peers and settings, and its results."""

    quick: bool
    say: Callable[[str], None]
    results: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Finds the peers, and the settings chosen for them."""
        self.peers, missing = peers.made()
        for name, why in missing.items():
            self.say(f"skipped {name}: {why}")
        self.chosen = frontier.stored()
        self.seconds = QUICK if self.quick else FULL
        self.results = {"machine": machine.description(), "quick": self.quick, "sections": {}, "ratios": {}}
        self.results |= {"skipped": missing, "seconds": {}, "frontier": self.chosen}

    def warm(self) -> None:
        """Compiles all that is not yet compiled, outside all times."""
        begin = time.perf_counter()
        for warm in kernels.GROUPS.values():
            warm()
        self.say(f"compiled, or loaded what was, in {time.perf_counter() - begin:.1f} s")

    def run(self, name: str) -> None:
        """Measures one section into the results."""
        self.say(f"{name} ...")
        begin = time.perf_counter()
        getattr(self, f"_{name}")()
        took = self.results["seconds"][name] = round(time.perf_counter() - begin, 1)
        self.say(f"{name}: {took:.0f} s")

    def _kept(self, name: str, measured: tuple[Any, ...]) -> None:
        self.results["sections"][name] = measured[0]
        self.results["ratios"] |= measured[1]

    def _correction(self) -> None:
        errors, problems = [workload.NEAR, workload.FAR], 120 if self.quick else 500
        self._kept(
            "correction",
            correction.run(self.peers, self.chosen, errors, problems, self.seconds["correction"]),
        )

    def _batch(self) -> None:
        self._kept("batch", batch.run(self.seconds["batch"]))

    def _blind(self) -> None:
        self.results["sections"]["blind"] = blind.run(6 if self.quick else 60, self.seconds["blind"])

    def _closest(self) -> None:
        self._kept("closest", closest.run(10_000 if self.quick else 100_000, self.seconds["closest"]))

    def _startup(self) -> None:
        self.results["sections"]["startup"] = startup.run(2 if self.quick else 9, compile_too=not self.quick)
