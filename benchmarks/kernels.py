"""What the benchmarks take from inside handsight: its compiled kernels, nowhere else imported here."""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

import handsight as hs
from handsight._kernels import records
from handsight._kernels.evidence import terms
from handsight._kernels.math.simd import local
from handsight._kernels.math.symmetry import pose_of
from handsight._kernels.runtime.compilation import FAST
from handsight._kernels.runtime.threads import alone
from handsight._kernels.solve import batch
from handsight.correction import PoseEstimate
from handsight.correction.outside import NO_OUTSIDE
from handsight.correction.problem import Problem
from handsight.correction.solve import solve_single_start
from handsight.tracking.warm import GROUPS

__all__ = ["GROUPS", "Evaluation", "alone", "fits_at_once", "kernel_call", "stages", "touched"]

Call = Callable[[], Any]
MEASURED, PRIOR_TERM, TERM, UNCERTAINTY, WORKSPACE = (
    records.MEASURED,
    records.PRIOR_TERM,
    records.TERM,
    records.UNCERTAINTY,
    records.WORKSPACE,
)


def fits_at_once(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> bool:
    """Returns whether a single start is enough; else a wrong contact is searched for."""
    return solve_single_start(Problem(model, contacts, vision, NO_OUTSIDE)) is not None


def kernel_call(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> Call:
    """Returns a function that runs the two phases of one problem, and nothing else."""
    rows, residuals = np.zeros(1, dtype=records.PROBLEM), np.empty((len(contacts), 2))
    rows["pose_only"] = True
    given = model.record.model, model.record.nodes, contacts.record, vision.record, NO_OUTSIDE

    def call() -> None:
        batch.correct_all(*given, rows, residuals)

    return call


def stages(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> dict[str, Call]:
    """Returns the parts of one correction as calls, by name."""
    rows, residuals = np.zeros(2, dtype=records.PROBLEM), np.empty((len(contacts), 2))
    rows["answer"]["mean"] = [1, 0]
    given = model.record.model, model.record.nodes, contacts.record, vision.record, NO_OUTSIDE
    return {
        "kernel": lambda: batch.correct_all(*given, rows[:1], residuals),
        "without a mean": lambda: batch.correct_all(*given, rows[1:], residuals),
        "the two phases": kernel_call(model, contacts, vision),
        "estimate made": lambda: PoseEstimate.trusted(rows[:1]["answer"], residuals),
    }


def touched(model: hs.ObjectModel, contacts: hs.Contacts) -> dict[str, int]:
    """Returns the bytes of the records that one correction with a mean of nine points reads and writes."""
    n = len(contacts)
    scanned = [model.record.model.dtype[name].itemsize for name in ("scan", "coarse", "fine", "error")]
    return {
        "model": sum(scanned),
        "evidence": contacts.record.nbytes + n * TERM.itemsize + records.CONSTRAINTS.itemsize,
        "work": WORKSPACE.itemsize + 4 * UNCERTAINTY.itemsize + PRIOR_TERM.itemsize,
        "mean": records.FLAT_DIRECTIONS.itemsize + 9 * records.LATTICE_POINT.itemsize + records.SUMS.itemsize,
        "answer": records.PROBLEM.itemsize + 16 * n,
    }


class Evaluation:
    """An `Evaluation` computes the normal equations of contacts and vision at one pose, repeatedly."""

    def __init__(self, model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> None:
        self._given = model.record.model, model.record.nodes, contacts.record, vision.record, NO_OUTSIDE
        self.bytes = len(contacts) * 8 * (6 + 1 + 16) + records.PRIOR_TERM.itemsize + 8 * 56
        """Bytes that an evaluation reads in double precision: contacts, their weights, vision, the equations."""

    def __call__(self, n: int) -> float:
        """Computes n evaluations, each at a slightly different pose."""
        return float(_evaluations(n, *self._given))


@numba.njit(error_model="numpy", fastmath=FAST)
def _evaluations(n, model, nodes, contacts, constraints, outside):
    prior, measured, workspace = local(PRIOR_TERM), local(MEASURED), local(WORKSPACE)
    rows = np.empty(len(contacts), TERM)
    center = batch.load_evidence(model[0], contacts, constraints[0], rows, prior, measured)
    evidence = terms.Evidence(model[0], nodes, rows, outside, measured, constraints[0], prior, center)
    R, p = pose_of(constraints[0].prior.pose)
    for k in range(n):
        pose = R, (p[0] + 1e-9 * k, p[1], p[2])
        workspace.now[:] = 0.0
        frame = center, model[0].radius
        terms.add_evidence(evidence, terms.ALL, model[0].fine, pose, frame, k == 0, workspace.now)
    return workspace.now[6, 6]
