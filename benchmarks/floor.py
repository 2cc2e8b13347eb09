"""One evaluation of phase 2 by count, against what a core can do, and the cache lines of a correction:
`python -m benchmarks.floor`.

An evaluation is the normal equations of five contacts and vision at one pose: what a Levenberg-Marquardt step costs.
Counted are the additions and multiplications that the formulas ask for, and the bytes that they must read; measured is
the kernel, hot, on one core, and what the same core reaches on nothing but fused multiply-adds in registers.
"""

import time

import numba
import numpy as np

from benchmarks import workload
from benchmarks.kernels import Evaluation, touched
from benchmarks.shapes import bumpy
from handsight import ObjectModel
from testbed import report

CONTACTS = 5
TRANSFORM = 9 + 9
"""A point into the object's frame."""
TURN = 15 + 12 + 2 * 45 + 42
"""Gradient and Hessian into the palm's frame, the unit normal and its derivative."""
SPLINE = 3 * 21 + 2 * (16 * 4 * 3 + 4 * 4 * 6 + 4 * 10) + 19
"""Weights of three axes, 64 nodes summed axis after axis, ten derivatives scaled."""
ROWS = 6 + 4 * 9 + 6 + 4
"""The lever, four crosses, the normal's own turn, residuals."""
SUMS = 2 * (4 * 4 * 7 + 4 * 28)
"""Four weighted rows of seven, and their outer products."""
VISION = 2 * (6 * 6 * 7 + 6 * 28) + 120
NODES = CONTACTS * 64 * 4
"""Read besides where the field is a grid, in single precision."""


def flops(grid: bool) -> int:
    """Returns the operations of one evaluation, without the few of an exact field."""
    return CONTACTS * (TRANSFORM + TURN + ROWS + SUMS + (SPLINE if grid else 0)) + VISION


@numba.njit(fastmath=True)
def multiplied(n):
    """Computes n times 64 independent fused multiply-adds."""
    x = np.linspace(0.1, 0.2, 64)
    for _ in range(n):
        for k in range(64):
            x[k] = x[k] * 0.999 + 0.001
    return x.sum()


def best(call, n: int) -> float:
    """Returns the least time of one of the n evaluations of a call [s]."""
    call(n)
    times = []
    for _ in range(25):
        begin = time.perf_counter()
        call(n)
        times.append(time.perf_counter() - begin)
    return min(times) / n


def main() -> None:
    """Prints the table."""
    peak = 2 * 64 / best(multiplied, 20_000)
    things = [("box (exact field)", workload.models()["box"], False)]
    things.append(("bumpy ball, 5 120 triangles (grid)", ObjectModel.from_mesh(*bumpy(4)), True))
    rows = []
    given = workload.draw("box", workload.NEAR, 1)
    for name, model, grid in things:
        evaluation, count = Evaluation(model, given.contacts, given.vision), flops(grid)
        seconds = best(evaluation, 2000)
        rows.append(
            [name, count, evaluation.bytes + grid * NODES, f"{1e9 * seconds:.0f}", f"{count / seconds / 1e9:.1f}",
             f"{100 * count / seconds / peak:.0f} %"]
        )  # fmt: skip
    report.print_table(
        "One evaluation of phase 2: five contacts and vision",
        ["object", "flops", "bytes", "ns", "Gflop/s", "of the peak"],
        rows,
        f"Peak: {peak / 1e9:.0f} Gflop/s, fused multiply-adds in registers, one core. {report.machine()}",
    )
    given = workload.draw("can", workload.NEAR, 0)
    sizes = touched(given.model, given.contacts)
    sizes["all"] = sum(sizes.values())
    report.print_table(
        "Data of one correction: five contacts and vision, a mean of nine points",
        ["records of", "bytes", "cache lines of 64"],
        [[name, count, -(-count // 64)] for name, count in sizes.items()],
    )


if __name__ == "__main__":
    main()
