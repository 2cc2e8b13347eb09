"""A correction as a plain function that solves one problem after another, over as many updates as that takes.

An update solves a few of them. Where the next one is one too many, the function is left, and called again in the next
update with the answers so far. So nothing but these answers is kept, and no update waits for a long search.
"""

from dataclasses import replace

from handsight.checks import Array
from handsight.correction import Outside, PoseEstimate, PosePrior, SkinEvidence
from handsight.correction.correct import corrected, refined
from handsight.correction.outside import outside_records
from handsight.correction.problem import Problem

SOLVE_EVERY = 0.005
"""An update solves one problem for so much time since the last observation [s]: most take less than a fifth of it."""
MOST_SOLVES = 8  # of one update, however long ago the last one was


def solves_in(elapsed: float) -> int:
    """Returns how many problems an update may solve, `elapsed` after the last observation [s]: by stamps and not by the
    clock, so that a recording is answered as it was live."""
    return max(1, int(min(round(elapsed / SOLVE_EVERY, 3), MOST_SOLVES)))


class Unfinished(Exception):
    """A correction has to solve more problems than an update may."""

    def __init__(self, answers: tuple[PoseEstimate | None, ...]) -> None:
        """`answers`: those of the problems that were solved."""
        super().__init__()
        self.answers = answers


class Solver:
    """Corrects a pose by one set of evidence, under one prior after another."""

    def __init__(
        self,
        problem: Problem,
        skin: SkinEvidence | None,
        answers: tuple[PoseEstimate | None, ...],
        most: int,
    ) -> None:
        """`skin`: the tactile arrays of the problem. `answers`: those of problems that were solved in earlier updates,
        after which at most `most` more are solved."""
        self._problem, self._skin = problem, skin
        self._answers = answers
        self._most = len(answers) + most
        self._asked = 0

    def correct(self, prior: PosePrior, links: Outside | None = None) -> PoseEstimate:
        """Returns the pose under a prior; `links`: other points of the hand than the problem's.

        Raises Unfinished.
        """
        if self._is_new():
            problem = replace(self._problem, vision=prior)
            if links is not None:
                outside = outside_records(problem.model, problem.contacts, links, self._skin)
                problem = replace(problem, outside=outside)
            self._answers = (*self._answers, corrected(problem, self._skin))
        answer = self._next()
        assert answer is not None
        return answer

    def refine(self, prior: PosePrior, T_start: Array) -> PoseEstimate | None:
        """Returns the pose near a start (4, 4) under a prior; None where the evidence does not fit there.

        Raises Unfinished.
        """
        if self._is_new():
            answer = refined(replace(self._problem, vision=prior), self._skin, T_start)
            self._answers = (*self._answers, answer)
        return self._next()

    def _is_new(self) -> bool:
        """Returns whether the next problem was not solved yet; raises Unfinished where it must wait."""
        if self._asked == self._most:
            raise Unfinished(self._answers)
        return self._asked == len(self._answers)

    def _next(self) -> PoseEstimate | None:
        self._asked += 1
        return self._answers[self._asked - 1]
