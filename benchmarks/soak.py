"""Many lines through `handsight correct` while its workers are killed: `python -m benchmarks.soak --lines 1000000`.

Each line is the same box with three contacts, moved aside by its number, so that an answer says which line it answers;
one in a thousand is malformed and says its number too. Printed: whether each line was answered once and in its place,
how often a worker was killed, and the memory of the command and of its workers. The exit code is 1 where one was not.
"""

import argparse
import json
import random
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, NamedTuple

import psutil
from rich.console import Console
from rich.progress import Progress

from testbed import report

STEP = 1e-4
"""Shift of each line's problem from the one before [m]; answers are far more accurate than that."""
PERIOD = 10_000
"""Lines until the problems begin again, before the object is farther from the palm than a position may be."""
MALFORMED_EVERY = 1000
LOOK_EVERY = 1.0
"""Seconds between two measurements of the memory."""


def line(i: int) -> str:
    """Returns the problem of a number."""
    if i % MALFORMED_EVERY == MALFORMED_EVERY - 1:
        return json.dumps({f"line {i}": 0})
    y = STEP * (i % PERIOD)
    contacts = [
        {"point": [0.03, y + 0.01, 0.03], "normal": [1, 0, 0]},
        {"point": [0.01, y + 0.045, -0.02], "normal": [0, 1, 0]},
        {"point": [0.01, y + 0.02, 0.07], "normal": [0, 0, 1]},
    ]
    prior = {"quaternion_xyzw": [0, 0, 0, 1], "sigma_position": 0.01, "sigma_rotation_deg": 5}
    vision = {"position": [0.004, y, 0.002], **prior}
    return json.dumps({"object": {"box": [0.06, 0.09, 0.14]}, "contacts": contacts, "vision": vision})


def is_answer(i: int, text: str) -> bool:
    """Returns whether a text is the answer to the problem of that number."""
    answer = json.loads(text)
    if i % MALFORMED_EVERY == MALFORMED_EVERY - 1:
        return str(answer.get("error", "")).startswith(f"line {i}: unknown key")
    return "error" not in answer and abs(answer["position"][1] - STEP * (i % PERIOD)) < STEP / 2


@dataclass
class Watch:
    """A `Watch` measures a command from outside, and kills its workers at random."""

    process: psutil.Process
    every: int
    """About the number of answers between two deaths; 0: no worker is killed."""
    rng: random.Random = field(default_factory=lambda: random.Random(0))
    came: int = 0
    killed: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)
    """Memory of the command and of its largest worker at each check [MB]."""
    over: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        """Measures and kills until the command ends."""
        due = self._next()
        while not self.over.wait(LOOK_EVERY):
            sizes = [(resident(worker), worker) for worker in workers(self.process)]
            self.memory.append((resident(self.process), max((size for size, _ in sizes), default=0.0)))
            if self.every and sizes and self.came > due:
                self.rng.choice(sizes)[1].kill()
                self.killed += 1
                due = self._next()

    def _next(self) -> float:
        return self.came + self.every * self.rng.uniform(0.5, 1.5)


class Soaked(NamedTuple):
    """A `Soaked` is the result of a run."""

    watch: Watch
    wrong: int
    """Number of answers that do not belong to their lines."""
    code: int
    seconds: float


def resident(process: psutil.Process) -> float:
    """Returns the megabytes of a process in memory; 0 if it has ended."""
    try:
        return float(process.memory_info().rss) / 1e6
    except psutil.Error:
        return 0.0


def workers(process: psutil.Process) -> list[psutil.Process]:
    """Returns a command's worker processes, without the helpers of Python's multiprocessing; none if it has ended."""
    found = []
    with suppress(psutil.Error):
        for child in process.children():
            with suppress(psutil.Error):
                found += [child] if "spawn_main" in " ".join(child.cmdline()) else []
    return found


def fed(sink: IO[bytes], count: int) -> None:
    """Writes the problems to a stream."""
    with sink:
        for first in range(0, count, 100):
            some = range(first, min(first + 100, count))
            sink.write("".join(f"{line(i)}\n" for i in some).encode())


def soak(count: int, size: int, every: int) -> Soaked:
    """Runs the command and returns the result."""
    arguments = [sys.executable, "-m", "handsight.cli", "correct", "-", "--workers", str(size)]
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said) as command,
        Progress(console=Console(stderr=True), transient=True) as bar,
    ):
        task = bar.add_task(f"{count} lines", total=count)
        assert command.stdin is not None
        assert command.stdout is not None
        watch, began = Watch(psutil.Process(command.pid), every), time.monotonic()
        threads = [
            threading.Thread(target=fed, args=(command.stdin, count), daemon=True),
            threading.Thread(target=watch.run, daemon=True),
        ]
        for thread in threads:
            thread.start()
        wrong = 0
        for text in command.stdout:
            wrong += not is_answer(watch.came, text.decode())
            watch.came += 1
            if watch.came % 1000 == 0:
                message = f"{watch.came} answers, {watch.killed} workers killed"
                bar.update(task, completed=watch.came, description=message)
        code, seconds = command.wait(), time.monotonic() - began
        watch.over.set()
        said.seek(0)
        print(said.read().decode(), end="", file=sys.stderr)
    return Soaked(watch, wrong, code, seconds)


def row(count: int, found: Soaked) -> list[str]:
    """Returns the row of the table; memory is given after a tenth, at the end, and at most."""
    # Medians of the second tenth and the last; the last look of all finds workers that have gone.
    looks = found.watch.memory[:-1] or [(0.0, 0.0)]
    tenth = max(len(looks) // 10, 1)
    parts = (looks[tenth : 2 * tenth] or looks, looks[-tenth:])
    cells = []
    for k in (0, 1):
        early, late = (statistics.median(look[k] for look in part) for part in parts)
        cells.append(f"{early:.0f} / {late:.0f} / {max(look[k] for look in looks):.0f}")
    came = found.watch.came
    numbers = (
        count,
        came,
        found.wrong,
        found.watch.killed,
        round(found.seconds),
        round(came / found.seconds),
    )
    return [*(f"{number:,}".replace(",", " ") for number in numbers), *cells]


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code: 0 where each line was answered once and in its place."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__.splitlines()[0])
    add, default = parser.add_argument, "default: %(default)s"
    add("--lines", type=int, default=20_000, help=default)
    add("--workers", type=int, default=2, help=default)
    add("--kill-every", type=int, default=5_000, metavar="LINES", help=f"0: none is killed; {default}")
    given = parser.parse_args(arguments)
    found = soak(given.lines, given.workers, given.kill_every)
    columns = ["lines", "answers", "wrong", "killed", "seconds", "a second", "command [MB]", "worker [MB]"]
    title = f"handsight correct - --workers {given.workers}; MB after a tenth / at the end / the most"
    report.print_table(title, columns, [row(given.lines, found)], report.machine())
    whole = found.watch.came == given.lines and not found.wrong
    return 0 if whole and found.code == (given.lines >= MALFORMED_EVERY) else 1


if __name__ == "__main__":
    sys.exit(main())
