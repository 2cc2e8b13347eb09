"""Whether handsight got slower: ratios of this run against those of baseline.json.

Only ratios of times taken in the same process and in turn are compared, so that the machine cancels as far as it can.
It does not wholly: newer machines speed compiled code up by more than Python. So the baseline has of each ratio the
larger of the machines that it was measured on.
A ratio is handsight's time over a peer's: one that grew by more than a quarter, in each of three measurements, is a
loss. Corrections are compared hot: taken in turn, what the other work on the machine leaves of the caches moves their
ratios by more than a quarter. Success has a floor as well: a fast wrong answer is no answer.
"""

import json
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("baseline.json")
LOSS = 0.25
MEASUREMENTS = 3
"""How often what seems lost is measured in all, before it is called lost."""
LEAST_SUCCESS = 0.05
"""How much less of the problems may be solved than in the baseline; a quick run draws about a hundred."""
GATED = {
    "ours / paper, hot": "correction",
    "ours / small_gicp, hot": "correction",
    "ours_kernel / paper, hot": "correction",
    "descent of many / single": "batch",
    "field / scipy cKDTree of samples, 2 cores": "closest",
}
"""The ratios that count, and the section that measures each."""
PEERS = {"ours", "ours_kernel", "paper", "small_gicp"}
"""Those that they are made of; a gate alone need not wait for the others."""


def stored(path: Path = FILE) -> dict[str, Any] | None:
    """Returns the committed baseline; None where there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def baseline_of(results: dict[str, Any]) -> dict[str, Any]:
    """Returns the part of a run's results that is kept: ratios, successes, and their peers."""
    return {
        "machine": results["machine"],
        "ratios": {
            name: round(results["ratios"][name]["ratio"], 6) for name in GATED if name in results["ratios"]
        },
        "success": successes(results),
    }


def successes(results: dict[str, Any]) -> dict[str, float]:
    """Returns handsight's share of solved problems, by case."""
    rows = results["sections"].get("correction", [])
    return {f"{r['object']}, {r['error']}": r["success"] for r in rows if r["peer"] == "ours"}


def losses(ratios: dict[str, Any], baseline: dict[str, Any]) -> dict[str, str]:
    """Returns a sentence for each measured ratio that is more than a quarter above the baseline's."""
    found = {}
    for name, was in baseline["ratios"].items():
        if name in GATED and name in ratios:
            now = ratios[name]["ratio"]
            if now > was * (1 + LOSS):
                found[name] = f"{name}: {now:.4g}, was {was:.4g} ({100 * (now / was - 1):+.0f} %)"
    return found


def fallen(results: dict[str, Any], baseline: dict[str, Any]) -> list[str]:
    """Returns a sentence for each case in which fewer problems are solved."""
    now = successes(results)
    return [
        f"{case}: {now[case]:.3f} of the problems solved, were {was:.3f}"
        for case, was in baseline["success"].items()
        if case in now and now[case] < was - LEAST_SUCCESS
    ]


def compared(ratios: dict[str, Any], baseline: dict[str, Any]) -> list[list[str]]:
    """Returns rows of the table: name, present ratio with its interval, former ratio, change."""
    rows = []
    for name, was in baseline["ratios"].items():
        if name not in ratios:
            rows.append([name, "not measured here", f"{was:.4g}", ""])
            continue
        now = ratios[name]
        change = f"{100 * (now['ratio'] / was - 1):+.0f} %"
        rows.append([name, f"{now['ratio']:.4g} ({now['low']:.4g}-{now['high']:.4g})", f"{was:.4g}", change])
    return rows
