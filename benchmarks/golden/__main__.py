"""`python -m benchmarks.golden`: records golden answers, or compares with them."""

import argparse
import json
import os
import sys
import tempfile
import time
import warnings
from pathlib import Path

from benchmarks import golden, timing
from benchmarks.golden import answers, commands, corrections

GROUPS = {
    "corrections": corrections.answered,
    "recordings": commands.tracked,
    "weighings": commands.weighed,
    "images": commands.located,
}
MACHINE = "machine.json"


def parsed() -> argparse.Namespace:
    """Returns the parsed arguments."""
    about = golden.__doc__.splitlines()[0] if golden.__doc__ else None
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description=about)
    add = parser.add_argument
    add("what", choices=("record", "compare"))
    add("folder", type=Path, metavar="FOLDER")
    add("--only", default=",".join(GROUPS), metavar="GROUPS", help="default: %(default)s")
    add("--quick", action="store_true", help="compare about a tenth of the answers")
    rounding = "accept less than 1e-6 m, 1e-6 rad and 1e-4 of a covariance, and other words"
    add("--rounding", action="store_true", help=rounding)
    given = parser.parse_args()
    given.only = given.only.split(",")
    if unknown := set(given.only) - set(GROUPS):
        parser.error(f"--only: expected {', '.join(GROUPS)}, got {', '.join(unknown)}")
    return given


def record(folder: Path, groups: list[str]) -> None:
    """Writes the answers of these groups."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / MACHINE).write_text(json.dumps(timing.description(), indent=1), encoding="utf-8")
    for group in groups:
        begin = time.perf_counter()
        found = dict(GROUPS[group](folder, quick=False))
        answers.write(folder, group, found)
        print(f"{group}: {len(found)} answers in {time.perf_counter() - begin:.0f} s", flush=True)


def compare(folder: Path, groups: list[str], *, quick: bool, rounding: bool) -> bool:
    """Returns whether the answers of these groups are those that were recorded."""
    before, now = json.loads((folder / MACHINE).read_text(encoding="utf-8")), timing.description()
    for what in ("description", "system", "versions"):
        if before.get(what) != now.get(what):
            print(f"recorded with {what} {before.get(what)}, compared with {now.get(what)}")
    accepted = True
    print(answers.HEADER)
    for group in groups:
        begin = time.perf_counter()
        found = GROUPS[group](folder, quick=quick)
        lines, agree = answers.comparison(folder, group, found, whole=not quick, rounding=rounding)
        print("\n".join([f"{lines[0]}{time.perf_counter() - begin:8.0f}", *lines[1:]]), flush=True)
        accepted &= agree
    print("the same" if accepted else "NOT THE SAME")
    return accepted


def main() -> int:
    """Returns the exit code: 1 where an answer differs."""
    given = parsed()
    warnings.simplefilter("ignore")
    usual = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "handsight")
    os.environ.setdefault("NUMBA_CACHE_DIR", os.environ.get("HANDSIGHT_CACHE") or str(usual))
    with tempfile.TemporaryDirectory() as cache:
        os.environ["HANDSIGHT_CACHE"] = (
            cache  # an object from there would hide that it is built otherwise now
        )
        if given.what == "record":
            record(given.folder, given.only)
            return 0
        return 0 if compare(given.folder, given.only, quick=given.quick, rounding=given.rounding) else 1


if __name__ == "__main__":
    sys.exit(main())
