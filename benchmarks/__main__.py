"""`python -m benchmarks`: handsight against its peers."""

import argparse
import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks import correction, gate, kernels, peers, searches, startup, tables, timing
from testbed import report

Row = dict[str, Any]
QUICK = {"correction": 30.0, "batch": 3.0, "blind": 6.0, "closest": 6.0}
FULL = {"correction": 160.0, "batch": 10.0, "blind": 80.0, "closest": 30.0}
"""Seconds; startup takes what its processes take."""
NAMES = (*FULL, "startup")


def say(text: str) -> None:
    """Prints progress immediately."""
    print(text, flush=True)


def parsed(arguments: list[str] | None = None) -> argparse.Namespace:
    """Returns the parsed arguments."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="handsight against its peers")
    add = parser.add_argument
    quick = "two minutes instead of fifteen"
    only = f"one of {', '.join(NAMES)}; repeatable"
    update = "write this run's ratios to baseline.json (with --quick: the gate's own sizes)"
    add("--quick", action="store_true", help=quick)
    add("--gate", action="store_true", help="exit 1 where a ratio is 25 %% worse than in baseline.json")
    add("--only", action="append", choices=NAMES, metavar="NAME", help=only)
    add("--output", type=Path, default=Path("results/benchmarks"), metavar="DIR", help="default: %(default)s")
    add("--update-baseline", action="store_true", help=update)
    return parser.parse_args(arguments)


def sections(options: argparse.Namespace) -> list[str]:
    """Returns the sections to run: all, the given ones, or with the gate alone those that it compares."""
    names = [name for name in NAMES if name in (options.only or NAMES)]
    if options.gate and not options.only:
        names = [name for name in names if name in gate.GATED.values()]
    return names


@dataclass
class Suite:
    """One run: its peers and settings, and its results."""

    quick: bool
    results: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Finds the peers, and the settings chosen for them."""
        self.peers, missing = peers.made()
        for name, why in missing.items():
            say(f"skipped {name}: {why}")
        self.chosen = correction.stored()
        self.seconds = QUICK if self.quick else FULL
        self.results = {"machine": timing.description(), "quick": self.quick, "sections": {}, "ratios": {}}
        self.results |= {"skipped": missing, "seconds": {}, "frontier": self.chosen}

    def warm(self) -> None:
        """Compiles all that is not yet compiled, outside all times."""
        begin = time.perf_counter()
        for warm in kernels.GROUPS.values():
            warm()
        say(f"compiled, or loaded what was, in {time.perf_counter() - begin:.1f} s")

    def run(self, name: str) -> None:
        """Measures one section into the results."""
        say(f"{name} ...")
        begin = time.perf_counter()
        self.results["sections"][name], ratios = self.measured(name)
        self.results["ratios"] |= ratios
        took = self.results["seconds"][name] = round(time.perf_counter() - begin, 1)
        say(f"{name}: {took:.0f} s")

    def measured(self, name: str) -> tuple[list[Row], Row]:
        """Returns the rows and the ratios of one section."""
        quick, seconds = self.quick, self.seconds.get(name, 0.0)
        if name == "correction":
            return correction.run(self.peers, self.chosen, 120 if quick else 500, seconds)
        if name == "batch":
            return searches.batch(seconds)
        if name == "blind":
            return searches.blind(6 if quick else 60, seconds), {}
        if name == "closest":
            return searches.closest(10_000 if quick else 100_000, seconds)
        return startup.run(2 if quick else 9, compile_too=not quick), {}


def passes(run: Suite, baseline: dict[str, Any]) -> bool:
    """Returns whether nothing got slower; a ratio that seems to is measured again, and the best measurement counts."""
    for _ in range(gate.MEASUREMENTS - 1):
        lost, before = gate.losses(run.results["ratios"], baseline), dict(run.results["ratios"])
        for sentence in lost.values():
            say(f"{sentence}; measured once more")
        for section in dict.fromkeys(gate.GATED[name] for name in lost):
            run.run(section)
        for name, again in run.results["ratios"].items():
            run.results["ratios"][name] = min(before[name], again, key=lambda r: r["ratio"])
    tables.gated(run.results, baseline)
    failures = [*gate.losses(run.results["ratios"], baseline).values(), *gate.fallen(run.results, baseline)]
    for failure in failures:
        say(f"LOST: {failure}")
    say("gate: " + ("failed" if failures else f"passed, no ratio more than {100 * gate.LOSS:.0f} % worse"))
    return not failures


def write(run: Suite, folder: Path) -> None:
    """Writes the results as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "benchmarks.json"
    path.write_text(json.dumps(run.results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    report.wrote(path)


def main(arguments: list[str] | None = None) -> int:
    """Runs the sections; returns the exit code."""
    options = parsed(arguments)
    baseline = gate.stored()
    if options.gate and baseline is None:
        say(f"{gate.FILE.name}: there is no baseline; make one with --update-baseline")
        return 1
    begin = time.perf_counter()
    run = Suite(options.quick)
    run.warm()
    if options.gate and not options.only:
        run.peers = {key: peer for key, peer in run.peers.items() if key in gate.PEERS}
    for name in sections(options):
        run.run(name)
    tables.everything(run.results)
    passed = passes(run, baseline) if options.gate and baseline else True
    write(run, options.output)
    if options.update_baseline:
        text = json.dumps(gate.baseline_of(run.results), indent=1, ensure_ascii=False)
        gate.FILE.write_text(text + "\n", encoding="utf-8")
        report.wrote(gate.FILE)
    say(f"{time.perf_counter() - begin:.0f} s")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
