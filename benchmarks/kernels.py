"""What the benchmarks take from inside handsight: its compiled kernels, nowhere else imported here."""

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

import handsight as hs
from handsight._kernels import layout as at
from handsight._kernels import many, solve
from handsight._kernels.compiled import FAST
from handsight._kernels.threads import alone
from handsight._kernels.touch import WHITE
from handsight.correction import compiled
from handsight.correction.compiled import kernel_call
from handsight.correction.modes import unobservable
from handsight.correction.pack import packed, packed_contacts, packed_prior
from handsight.correction.starts import WIDEST_OF_ONE
from handsight.correction.two_phase import Problem

__all__ = ["Evaluation", "alone", "fits_at_once", "kernel_call", "stages", "unobservable"]

NONE = np.empty((0, 3))
Call = Callable[[], Any]


def fits_at_once(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> bool:
    """Whether a single start is enough; else a wrong contact is searched for."""
    return compiled.near(Problem(model, contacts, vision, NONE)) is not None


def stages(model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> dict[str, Call]:
    """The parts of one correction, each as a call."""
    numbers, singles = packed(model)
    rows, prior = packed_contacts(contacts), packed_prior(vision)
    begins, out = np.array((0, len(rows))), np.empty((1, at.RESIDUALS + 2 * len(contacts)))
    nothing = compiled.NOWHERE, compiled.NO_HAND
    given = numbers, singles, rows, begins, prior, *nothing, WIDEST_OF_ONE, out, 0, 1
    return {
        "inputs laid out": lambda: (packed_contacts(contacts), packed_prior(vision)),
        "kernel": lambda: many.correct_all(*given),
        "of it the two phases": kernel_call(model, contacts, vision),
        "estimate made": lambda: compiled.answer_of_one(contacts, out[0]),
    }


class Evaluation:
    """The normal equations of contacts and vision at one pose, evaluated again and again."""

    def __init__(self, model: hs.ObjectModel, contacts: hs.Contacts, vision: hs.PosePrior) -> None:
        p = compiled._Packed(Problem(model, contacts, vision, NONE))
        weight = np.tile(np.eye(4).reshape(-1), len(contacts))
        pose = compiled.packed_poses(vision.T_palm_object[None])[0]
        equations, work = np.empty(at.EQUATIONS), np.empty(solve.WORK)
        self._given = (
            p.model, p.singles, p.contacts, weight, p.sight, p.hand, p.center, pose, equations, work
        )  # fmt: skip
        self.bytes = len(contacts) * 8 * (at.CONTACT - 36 + WHITE) + 8 * (at.SIGHT + at.EQUATIONS)
        """Read in double precision: contacts, their weights, vision, the equations."""

    def __call__(self, n: int) -> float:
        """n evaluations, each at a pose a hair from the last."""
        return _evaluations(n, self._given)


@numba.njit(error_model="numpy", fastmath=FAST)
def _evaluations(n, given):
    model, singles, contacts, weight, sight, hand, center, pose, equations, work = given
    for _ in range(n):
        pose[9] += 1e-9
        solve.evaluate(model, singles, at.FINE, contacts, weight, sight, hand, center, pose, equations, work)
    return equations[at.COST]
