"""Where the time of one correction goes, hot, on one core: `python -m benchmarks.stages`."""

import time
from collections.abc import Callable

import numpy as np

import handsight as hs
import report
from benchmarks import workload
from handsight._kernels import layout as at
from handsight._kernels import many
from handsight.correction import compiled
from handsight.correction.pack import packed, packed_contacts, packed_prior
from handsight.correction.starts import WIDEST_OF_ONE
from handsight.correction.two_phase import Problem

PROBLEMS, REPEATS = 12, 1500
OTHER = np.ones(2 << 17)
"""2 MiB: more than a core's L2."""


def microseconds(call: Callable[[], object], before: Callable[[], object] = lambda: None) -> float:
    """The median of many repeats; `before` is called before each, and not timed."""
    call()
    times = np.empty(REPEATS)
    for k in range(REPEATS):
        before()
        begin = time.perf_counter()
        call()
        times[k] = time.perf_counter() - begin
    return 1e6 * float(np.median(times))


def stages(problem: workload.Problem) -> list[float]:
    """The whole after other data, and hot; its parts: inputs, kernel, of it the two phases, estimate."""
    model, contacts, vision = problem.model, problem.contacts, problem.vision
    numbers, singles = packed(model)
    rows, prior = packed_contacts(contacts), packed_prior(vision)
    begins, out = np.array((0, len(rows))), np.empty((1, at.RESIDUALS + 2 * len(contacts)))
    nothing = compiled.NOWHERE, compiled.NO_HAND
    given = numbers, singles, rows, begins, prior, *nothing, WIDEST_OF_ONE, out, 0, 1
    return [
        microseconds(lambda: hs.correct_pose(model, contacts, vision=vision), OTHER.sum),
        microseconds(lambda: hs.correct_pose(model, contacts, vision=vision)),
        microseconds(lambda: (packed_contacts(contacts), packed_prior(vision))),
        microseconds(lambda: many.correct_all(*given)),
        microseconds(compiled.kernel_call(model, contacts, vision)),
        microseconds(lambda: compiled.answer_of_one(contacts, out[0])),
    ]


def asked(problem):
    """It as the solver takes it."""
    return Problem(problem.model, problem.contacts, problem.vision, np.empty((0, 3)))


def main() -> None:
    """Prints the table."""
    cells = []
    for name in workload.OBJECTS:
        drawn = [workload.draw(name, workload.NEAR, k) for k in range(PROBLEMS)]
        # Those that fit at once; the others are searched for a wrong contact.
        usual = [p for p in drawn if compiled.near(p) is not None]
        median = np.median([stages(problem) for problem in usual], axis=0)
        cells.append([name, *(f"{value:.1f}" for value in median)])
    columns = [
        "object",
        "after 2 MiB of other data",
        "correct_pose",
        "inputs laid out",
        "kernel",
        "of it the two phases",
        "estimate made",
    ]
    title = f"One correction in µs, hot: five contacts, vision off by {workload.NEAR}"
    report.print_table(title, columns, cells, f"Medians over {PROBLEMS} problems. {report.machine()}")


if __name__ == "__main__":
    main()
