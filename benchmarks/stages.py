"""Where the time of one correction goes, hot, on one core: `python -m benchmarks.stages`."""

import time
from collections.abc import Callable

import numpy as np

import handsight as hs
from benchmarks import kernels, workload
from testbed import report

PROBLEMS, REPEATS = 12, 1500
OTHER = np.ones(2 << 17)
"""2 MiB: more than a core's L2."""


def microseconds(call: Callable[[], object], before: Callable[[], object] = lambda: None) -> float:
    """Returns the median time of many repeats; `before` is called before each, and not timed."""
    call()
    times = np.empty(REPEATS)
    for k in range(REPEATS):
        before()
        begin = time.perf_counter()
        call()
        times[k] = time.perf_counter() - begin
    return 1e6 * float(np.median(times))


def stages(problem: workload.Problem) -> dict[str, float]:
    """Returns the times of a correction after other data, and hot; then those of its parts [µs]."""
    model, contacts, vision = problem.model, problem.contacts, problem.vision

    def correct() -> object:
        return hs.correct_pose(model, contacts, vision=vision)

    whole = {
        "after 2 MiB of other data": microseconds(correct, OTHER.sum),
        "correct_pose": microseconds(correct),
    }
    parts = kernels.stages(model, contacts, vision)
    return whole | {name: microseconds(call) for name, call in parts.items()}


def main() -> None:
    """Prints the table."""
    cells, columns = [], []
    for name in workload.OBJECTS:
        drawn = [workload.draw(name, workload.NEAR, k) for k in range(PROBLEMS)]
        # Those that fit at once; the others are searched for a wrong contact.
        usual = [p for p in drawn if kernels.fits_at_once(p.model, p.contacts, p.vision)]
        found = [stages(problem) for problem in usual]
        columns = list(found[0])
        cells.append([name, *(f"{np.median([f[key] for f in found]):.1f}" for key in columns)])
    title = f"One correction in µs, hot: five contacts, vision off by {workload.NEAR}"
    note = f"Medians over {PROBLEMS} problems. {report.machine()}"
    report.print_table(title, ["object", *columns], cells, note)


if __name__ == "__main__":
    main()
