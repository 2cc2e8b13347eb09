"""Brings every door of the corpus inputs that nobody has seen: `python -m tests.fuzz --seconds 600`."""

import argparse
import secrets
import sys
import time
import traceback
from collections import Counter

from handsight.tracking.warm import GROUPS
from tests.corpus.door import Fault, knock
from tests.corpus.doors import DOORS


def main() -> int:
    """Prints each kind of fault with what repeats it, and how many inputs each door was brought."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long (default: 60)")
    parser.add_argument("--door", help="only doors whose name has this in it")
    parser.add_argument("--seed", type=int, help="only this input, as a fault names it")
    given = parser.parse_args()
    doors = [door for door in DOORS if given.door is None or given.door in door.name]
    if not doors:
        parser.error(f"--door: expected part of one of {', '.join(door.name for door in DOORS)}")
    for warm in GROUPS.values():
        warm()  # an input's time is its own
    began, seen = time.monotonic(), Counter[tuple[str, str]]()
    brought, answered = dict.fromkeys(doors, 0), dict.fromkeys(doors, 0)
    try:
        while given.seed is not None or time.monotonic() - began < given.seconds:
            for door in doors:
                seed = secrets.randbits(40) if given.seed is None else given.seed
                brought[door] += 1
                try:
                    answered[door] += knock(door, seed)
                except (Fault, AssertionError) as fault:
                    kind = (door.name, where(fault))
                    seen[kind] += 1
                    if seen[kind] == 1:
                        print(f"{fault}\n  again: python -m tests.fuzz --door {door.name!r} --seed {seed}")
                    if given.seed is not None:
                        traceback.print_exception(fault)
            if given.seed is not None:
                break
    except KeyboardInterrupt:
        pass
    for door in doors:
        print(f"{brought[door]:8d} inputs, {answered[door]:8d} answered  {door.name}")
    spent = time.monotonic() - began
    print(f"{seen.total()} faults, {len(seen)} kinds, in {sum(brought.values())} inputs, {spent:.0f} s")
    return 1 if seen else 0


def where(fault: BaseException) -> str:
    """The file and line a fault came from: two from one line are one kind."""
    deepest = traceback.extract_tb((fault.__cause__ or fault).__traceback__)[-1]
    return f"{deepest.filename}:{deepest.lineno}"


if __name__ == "__main__":
    sys.exit(main())
