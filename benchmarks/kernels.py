"""What the benchmarks take from inside handsight: its compiled kernels, nowhere else imported here."""

from collections.abc import Callable
from typing import Any

import numpy as np

import handsight as hs
from benchmarks.workload import Problem as Drawn
from handsight._compiled import records
from handsight._compiled.threads import alone
from handsight.correction.kernels import batch
from handsight.correction.outside import NO_OUTSIDE, outside_records
from handsight.correction.problem import Problem
from handsight.correction.solve import solve
from handsight.correction.starts import from_prior
from handsight.tracking.warm import GROUPS

__all__ = ["GROUPS", "alone", "descents", "kernel_call"]

Call = Callable[[], Any]


def kernel_call(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> Call:
    """Returns a function that runs the two phases of one problem, and nothing else."""
    rows, residuals = np.zeros(1, dtype=records.PROBLEM), np.empty((len(contacts), 2))
    rows["pose_only"] = True
    given = model.record.model, model.record.nodes, contacts.record, vision.record, NO_OUTSIDE

    def call() -> None:
        batch.correct(*given, rows, residuals)

    return call


def descents(problem: Drawn, count: int) -> Call:
    """Returns a function that runs both phases from `count` draws of the prior."""
    model, contacts, vision = problem.model, problem.contacts, problem.vision
    outside = outside_records(model, contacts, problem.outside)
    evidence = Problem(model, contacts, vision, outside)
    starts = from_prior(vision, count)[None]
    everyone = np.ones((1, len(contacts)), dtype=bool)
    return lambda: solve(evidence, starts, everyone)
