"""What a change has cost: this tree and an older one on the same problems, compared one by one.

`python -m experiments.price --against FOLDER` draws the problems of each kind once, with this tree. Two processes
answer them, one with FOLDER/src and one with this tree's, by public names that both have (`shared/price_answers.py`).
A row for each kind; `--list` says what is counted as right, and the unit of errors:

  n          answers that are judged; of recordings and sequences one each
  identical  share of the problems whose answers are the same, bit for bit
  right      share that is right, old and new; p of an exact test of those that one tree alone has right (McNemar)
  error      median error, old and new; p of a sign test of the pairs whose errors differ by more than 0.001;
             most: the largest difference
  verdict    same (bit for bit), within noise, better or worse (p < .01), or what a tree lacks

The exit code is 1 where a row is worse.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from experiments.shared.price_answers import ERROR, Answer, read
from experiments.shared.price_kinds import KINDS, Kind, Score
from testbed import report, ycb

ROOT = Path(__file__).resolve().parents[1]
LEVEL = 0.01
"""Probability of a test below which a difference is beyond noise."""
TIE = 1e-3
"""Errors that differ by less are equal, in the kind's unit: rounding."""
ALONE = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Each tree has one core, and sums in the same order."""


@dataclass(frozen=True)
class Row:
    """How the answers of two trees to one kind of problems differ."""

    kind: str
    verdict: str
    n: int = 0
    identical: float = math.nan
    right: tuple[float, float] = (math.nan, math.nan)
    p_right: float = 1.0
    error: tuple[float, float] = (math.nan, math.nan)
    p_error: float = 1.0
    most: float = math.nan
    """The largest difference of an error."""


def drawn(folder: Path, name: str, count: int) -> str:
    """Writes the problems of a kind; returns why there are none, else nothing."""
    (folder / name).mkdir(parents=True)
    try:
        for k, problem in enumerate(KINDS[name].problems(0, count)):
            np.savez_compressed(folder / name / f"{k:06d}.npz", **problem)
    except SystemExit:
        return "the data are not here"
    except Exception as error:  # another kind may be drawn all the same
        return f"not drawn: {type(error).__name__}: {error}"
    return ""


def environment(tree: Path, cache: Path) -> dict[str, str]:
    """Returns the environment of a process that takes handsight from a tree."""
    usual = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "handsight")
    kernels = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("HANDSIGHT_CACHE") or str(usual)
    # What a tree has computed of objects would hide that another one computes it otherwise.
    own = {"PYTHONPATH": str(tree / "src"), "NUMBA_CACHE_DIR": kernels, "HANDSIGHT_CACHE": str(cache)}
    return os.environ | ALONE | own


def answering(tree: Path, kinds: Iterable[str], problems: Path, results: Path) -> subprocess.Popen[bytes]:
    """Returns a process in which a tree answers the problems of some kinds."""
    results.mkdir(exist_ok=True)
    ways = {name: KINDS[name].way for name in kinds}
    (results / "kinds.json").write_text(json.dumps(ways), encoding="utf-8")
    worker = ROOT / "experiments" / "shared" / "price_answers.py"
    command = [sys.executable, "-P", str(worker), str(problems), str(results)]
    return subprocess.Popen(command, env=environment(tree, results / "cache"))


def answers_of(results: Path, name: str, count: int) -> list[Answer]:
    """Returns a tree's answers to the problems of a kind, and an error for each that has none."""
    path = results / f"{name}.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    found: list[Answer] = [json.loads(line) for line in lines]
    return found + [{ERROR: "the process has ended"}] * (count - len(found))


def judged(kind: Kind, problem: Any, answer: Answer) -> Score:
    """Returns the score of an answer; an error is wrong."""
    return Score(False, math.inf) if ERROR in answer else kind.score(problem, answer)


def sign_test(lost: int, won: int) -> float:
    """Returns the probability of so uneven a division, if both were as likely."""
    return float(binomtest(lost, lost + won).pvalue) if lost + won else 1.0


def compared(name: str, problems: Sequence[Any], old: list[Answer], new: list[Answer]) -> Row:
    """Returns the row of a kind."""
    for tree, answers in (("old", old), ("new", new)):
        if answers and all(ERROR in answer for answer in answers):
            return Row(name, f"the {tree} tree: {answers[0][ERROR]:.70}")
    kind = KINDS[name]
    same = [json.dumps(a) == json.dumps(b) for a, b in zip(old, new, strict=True)]
    scores = [[judged(kind, *each) for each in zip(problems, tree, strict=True)] for tree in (old, new)]
    right_old, right_new = (np.array([score.right for score in tree]) for tree in scores)
    errors = np.array([[score.error for score in tree] for tree in scores])
    error_old, error_new = errors[:, ~np.isnan(errors).any(axis=0)]
    with np.errstate(invalid="ignore"):  # both infinite
        change = np.nan_to_num(error_new - error_old, nan=0.0, posinf=math.inf, neginf=-math.inf)
    larger, smaller = int((change > TIE).sum()), int((change < -TIE).sum())
    p_right = sign_test(int((right_old & ~right_new).sum()), int((right_new & ~right_old).sum()))
    p_error = sign_test(larger, smaller)
    shares = float(right_old.mean()), float(right_new.mean())
    lost_shares = loss(shares, kind.wanted) if p_right < LEVEL else 0.0
    lost_errors = float(larger - smaller) if p_error < LEVEL else 0.0
    return Row(
        name,
        "same" if all(same) else verdict_of([lost_shares, lost_errors]),
        n=len(problems),
        identical=float(np.mean(same)),
        right=shares,
        p_right=p_right,
        error=(float(np.median(error_old)), float(np.median(error_new))) if len(change) else Row.error,
        p_error=p_error,
        most=float(np.abs(change).max(initial=0.0)),
    )


def loss(shares: tuple[float, float], wanted: float) -> float:
    """Returns how much farther the new share is from the wanted one than the old share was."""
    return abs(shares[1] - wanted) - abs(shares[0] - wanted)


def verdict_of(losses: Sequence[float]) -> str:
    """Returns what differences beyond noise mean; one of zero is none."""
    if max(losses) > 0:
        return "worse, and better" if min(losses) < 0 else "worse"
    return "better" if min(losses) < 0 else "within noise"


def priced(old: Path, kinds: list[str], *, quick: bool) -> list[Row]:
    """Returns the rows of some kinds."""
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        problems = Path(temporary, "problems")
        counts = [KINDS[name].quick if quick else KINDS[name].count for name in kinds]
        tasks = [(problems, name, count) for name, count in zip(kinds, counts, strict=True)]
        lacking = dict(zip(kinds, ycb.in_parallel(drawn, tasks, "drawing problems"), strict=True))
        there = [name for name in kinds if not lacking[name]]
        results = {tree: Path(temporary, tree) for tree in ("old", "new")}
        trees = {"old": old, "new": ROOT}
        running = [answering(trees[tree], there, problems, results[tree]) for tree in trees]
        for process in running:
            process.wait()
        for name in kinds:
            if lacking[name]:
                rows.append(Row(name, lacking[name]))
                continue
            asked = [read(path) for path in sorted((problems / name).iterdir())]
            rows.append(
                compared(name, asked, *(answers_of(results[tree], name, len(asked)) for tree in trees))
            )
    return rows


def printed(rows: Iterable[Row]) -> None:
    """Prints the table."""
    cells: list[list[object]] = []
    for row in rows:
        shares = " -> ".join(f"{share:.3f}" for share in row.right)
        errors = " -> ".join(f"{error:.3g}" for error in row.error)
        numbers = [shares, f"{row.p_right:.2g}", errors, f"{row.p_error:.2g}", f"{row.most:.2g}"]
        counted = [row.n, f"{row.identical:.3f}", *numbers] if row.n else [""] * 7
        cells.append([row.kind, *counted, row.verdict])
    columns = "kind | n | identical | right | p | error | p | most | verdict"
    report.print_table("Old tree -> this tree", columns, cells)


def main() -> int:
    """Returns the exit code: 1 where a row is worse."""
    arguments = report.parser(__doc__)
    add = arguments.add_argument
    add("--against", type=Path, metavar="FOLDER", help="a checkout of the older tree")
    add("--only", action="append", choices=KINDS, metavar="KIND", help="repeatable (default: all)")
    add("--quick", action="store_true", help="a few problems of each kind")
    add("--list", action="store_true", help="print the kinds")
    given = arguments.parse_args()
    if given.list:
        lines = [[name, kind.count, kind.counted, kind.unit] for name, kind in KINDS.items()]
        report.print_table("Kinds", "kind | problems | right | error", lines)
        return 0
    if given.against is None or not (given.against / "src" / "handsight").is_dir():
        arguments.error(f"--against: expected a folder with src/handsight, got {given.against}")
    rows = priced(given.against.resolve(), given.only or list(KINDS), quick=given.quick)
    printed(rows)
    return int(any(row.verdict.startswith("worse") for row in rows))


if __name__ == "__main__":
    sys.exit(main())
