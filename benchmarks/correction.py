"""Pose correction: every peer on the same problems, in turn; time beside success and accuracy."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import timing, workload
from benchmarks.workload import Peer, Problem, Solve, Verdict

HOT_PROBLEMS = 15
Row = dict[str, Any]
SETTINGS = Path(__file__).with_name("frontier.json")
"""Of each peer the fastest setting whose success was within .02 of the best, for each object and error of vision, on
another seed than the reported one."""


def stored(path: Path = SETTINGS) -> Row:
    """Returns the settings that a full run has chosen; none where there is no such file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"peers": {}}


@dataclass
class Entrant:
    """One peer in one case, with its measurements."""

    key: str
    peer: Peer
    setting: Row | None
    seconds: list[float] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    hot: list[float] = field(default_factory=list)

    def run(self, problem: Problem, solve: Solve) -> None:
        """Solves one problem cold and judges the answer."""
        answer, took = timing.once(solve)
        self.seconds.append(took)
        T_hat = workload.pose_of(answer)
        if T_hat is not None:
            self.verdicts.append(workload.judged(problem, T_hat))

    def row(self, object_name: str, error: str) -> Row:
        """Returns the line of the table."""
        hot = {"hot_median_s": float(np.median(self.hot))} if self.hot else {}
        judged = workload.accuracy(self.verdicts) if self.verdicts else {"success": None}
        return {
            "object": object_name,
            "error": error,
            "peer": self.key,
            "name": self.peer.name,
            "uses_normals": self.peer.uses_normals,
            "uses_prior": self.peer.uses_prior,
            "setting": self.setting,
            **timing.summary(self.seconds),
            **hot,
            **judged,
        }


def entrants(peers: dict[str, Peer], object_name: str, error: str, chosen: Row) -> list[Entrant]:
    """Returns the peers with the settings chosen for this case, prepared and compiled."""
    found = []
    for key, peer in peers.items():
        entry = chosen["peers"].get(key, {}).get(f"{object_name}, {error}")
        setting = None if entry is None else entry["chosen"]["setting"]
        found.append(Entrant(key, peer if setting is None else using(peer, setting), setting))
    return found


def using(peer: Any, setting: Row) -> Peer:
    """Returns the same peer with other constants; the paper's are those of its method."""
    method = getattr(peer, "method", None)
    return replace(peer, **setting) if method is None else replace(peer, method=replace(method, **setting))


def run_case(runners: list[Entrant], object_name: str, error: str, problems: int, seconds: float) -> None:
    """Cold trials in turn until all problems are done or the time is up; a slow peer does fewer problems.

    No peer may use more than its even share, but each does at least ten problems; then hot repeats of a few.
    """
    model = workload.models()[object_name]
    for runner in runners:
        runner.peer.prepare(model)
    share = 0.7 * seconds / len(runners)
    with timing.undisturbed(), timing.silent_stderr():
        for runner in runners:
            runner.peer.ready(workload.draw(object_name, error, problems))()
        begin = time.perf_counter()
        for k in range(problems):
            problem = workload.draw(object_name, error, k)
            first = k % len(runners)
            for runner in [*runners[first:], *runners[:first]]:
                done = len(runner.seconds)
                if done < 10 or sum(runner.seconds) < share:
                    runner.run(problem, runner.peer.ready(problem))
            if k > 20 and time.perf_counter() - begin > 0.8 * seconds:
                break
        for k in range(HOT_PROBLEMS):
            problem = workload.draw(object_name, error, k)
            for runner in runners:
                solve = runner.peer.ready(problem)
                budget = 0.2 * seconds / HOT_PROBLEMS / len(runners)
                # The least: what the code costs, whoever else uses the machine.
                runner.hot.append(float(timing.hot(solve, min(budget, 0.1), least=3).min()))


def run(
    peers: dict[str, Peer], chosen: Row, problems: int, seconds: float
) -> tuple[list[Row], dict[str, Any]]:
    """Rows of every case, and the ratios of times on the near start, geometric mean of can and box.

    The ratios of hot times (least of the repeats of each problem), each of one problem, vary less with the machine's
    other work than those of calls in turn.
    """
    rows: list[Row] = []
    near: dict[str, dict[str, list[float]]] = {}
    hot: dict[str, dict[str, list[float]]] = {}
    cases = [(o, e) for o in workload.OBJECTS for e in (workload.NEAR, workload.FAR)]
    for object_name, error in cases:
        runners = entrants(peers, object_name, error, chosen)
        run_case(runners, object_name, error, problems, seconds / len(cases))
        rows += [runner.row(object_name, error) for runner in runners]
        if error == workload.NEAR:
            near[object_name] = {runner.key: runner.seconds for runner in runners}
            hot[object_name] = {runner.key: runner.hot for runner in runners}
    by_problem = ratios(hot, timing.ratio_of_each)
    return rows, ratios(near) | {f"{name}, hot": found for name, found in by_problem.items()}


def ratios(
    near: dict[str, dict[str, list[float]]], of: Callable[..., dict[str, float]] = timing.ratio
) -> dict[str, Any]:
    """Returns the ratios of time ours / peer and kernel / peer, below 1 where ours is faster."""
    found: dict[str, Any] = {}
    for ours in ("ours", "ours_kernel"):
        for peer in ("paper", "open3d", "small_gicp"):
            each = [of(times[ours], times[peer]) for times in near.values() if {ours, peer} <= times.keys()]
            if each:
                mean = {
                    k: float(np.exp(np.mean([np.log(e[k]) for e in each]))) for k in ("ratio", "low", "high")
                }
                found[f"{ours} / {peer}"] = mean | {"pairs": sum(e["pairs"] for e in each)}
    return found
