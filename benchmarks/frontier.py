"""Which settings a peer is compared with: chosen on one seed, reported on another.

Each setting of a peer's grid gets its success and median time on the problems of the choosing seed, for each object and
each error of vision; taken is the fastest within .02 of the best success. Written to frontier.json by a full run, read
by a quick one.
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import timing, workload
from benchmarks.workload import Peer

FILE = Path(__file__).with_name("frontier.json")
WITHIN = 0.02
FIRST, THEN = 40, 200
"""Problems for every setting, and for those that came close."""
CLOSE = 0.1
Row = dict[str, Any]


def case_name(object_name: str, error: str) -> str:
    """Returns the key of one table."""
    return f"{object_name}, {error}"


def measured(
    peer: Peer, object_name: str, error: str, trials: range, seed: int
) -> tuple[list[bool], list[float]]:
    """Returns whether each problem was solved, and its time cold [s]."""
    peer.prepare(workload.models()[object_name])
    found, seconds = [], []
    with timing.undisturbed(), timing.silent_stderr():
        peer.ready(workload.draw(object_name, error, 0, seed))()
        for k in trials:
            problem = workload.draw(object_name, error, k, seed)
            answer, took = timing.once(peer.ready(problem))
            found.append(workload.judged(problem, workload.pose_of(answer)).found)
            seconds.append(took)
    return found, seconds


def swept(peer: Any, object_name: str, error: str, seconds: float) -> list[Row]:
    """Returns a row for each setting that time allowed: setting, success, median_s, problems."""
    end = time.perf_counter() + seconds
    rows: list[Row] = []
    for setting in shuffled(peer.settings()):
        if time.perf_counter() > end - 0.4 * seconds and len(rows) > 3:
            break
        rows.append(row_of(peer.using(setting), setting, object_name, error, FIRST))
    best = max(row["success"] for row in rows)
    close = [row for row in rows if row["success"] >= best - CLOSE]
    for row in sorted(close, key=lambda row: -row["success"]):
        if time.perf_counter() > end:
            break
        row |= row_of(peer.using(row["setting"]), row["setting"], object_name, error, THEN)
    return rows


def shuffled(settings: list[Row]) -> list[Row]:
    """Returns the settings in an order in which a time limit favours none."""
    order = np.random.default_rng(0).permutation(len(settings))
    return [settings[i] for i in order]


def row_of(peer: Peer, setting: Row, object_name: str, error: str, problems: int) -> Row:
    """Returns a setting's success and time on the seed for choosing."""
    found, seconds = measured(peer, object_name, error, range(problems), workload.CHOSEN_ON)
    return {
        "setting": setting,
        "success": float(np.mean(found)),
        "median_s": float(np.median(seconds)),
        "problems": problems,
    }


def chosen(rows: list[Row]) -> Row:
    """Returns the fastest setting within .02 of the best success, among those tried on most problems."""
    most = max(row["problems"] for row in rows)
    sure = [row for row in rows if row["problems"] == most]
    best = max(row["success"] for row in sure)
    return min((row for row in sure if row["success"] >= best - WITHIN), key=lambda row: row["median_s"])


def pareto(rows: list[Row]) -> list[Row]:
    """Returns the settings that no other beats in both time and success, fastest first."""
    front: list[Row] = []
    for row in sorted(rows, key=lambda row: (row["median_s"], -row["success"])):
        if not front or row["success"] > front[-1]["success"]:
            front.append(row)
    return front


def search(peers: dict[str, Any], errors: list[str], seconds: float, say: Callable[[str], None]) -> Row:
    """Returns chosen settings and fronts of each peer that has settings, each with its share of the time."""
    tunable = {key: peer for key, peer in peers.items() if hasattr(peer, "settings")}
    cases = [(o, e) for o in workload.OBJECTS for e in errors]
    weight = {key: len(peer.settings()) ** 0.5 for key, peer in tunable.items()}
    result: Row = {"seed": workload.CHOSEN_ON, "within": WITHIN, "peers": {}}
    for key, peer in tunable.items():
        share = seconds * weight[key] / sum(weight.values()) / len(cases)
        entry = result["peers"][key] = {}
        for object_name, error in cases:
            rows = swept(peer, object_name, error, share)
            best = chosen(rows)
            entry[case_name(object_name, error)] = {"chosen": best, "front": pareto(rows), "tried": len(rows)}
            say(
                f"  {key}, {object_name}, {error}: {len(rows)} of {len(peer.settings())} settings; "
                f"{best['success']:.3f} in {1e6 * best['median_s']:.0f} µs with {best['setting']}"
            )
    return result


def stored(path: Path = FILE) -> Row:
    """Returns the settings that a full run has chosen; none where there is no such file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"peers": {}}


def tuned(key: str, peer: Any, object_name: str, error: str, frontier: Row) -> tuple[Peer, Row | None]:
    """Returns the peer with the setting chosen for this case, if one was, and that setting."""
    entry = frontier["peers"].get(key, {}).get(case_name(object_name, error))
    if entry is None:
        return peer, None
    return peer.using(entry["chosen"]["setting"]), entry["chosen"]["setting"]
