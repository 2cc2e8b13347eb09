"""handsight itself: the public call, and its compiled solve alone."""

import handsight as hs
from benchmarks.kernels import kernel_call
from benchmarks.workload import Problem, Solve


class Ours:
    """`hs.correct_pose` as a user calls it: checks, both phases, modes, covariance."""

    name = "handsight"
    uses_normals = True
    uses_prior = True

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model is all."""

    def ready(self, problem: Problem) -> Solve:
        """The public call with default settings."""
        model, contacts, vision = problem.model, problem.contacts, problem.vision
        outside = problem.outside
        return lambda: hs.correct_pose(model, contacts, vision=vision, outside=outside).T_palm_object


class OursKernel:
    """The compiled two-phase solve from one start: no checks, no outliers, no modes, no covariance."""

    name = "handsight, kernel"
    uses_normals = True
    uses_prior = True

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model is all."""

    def ready(self, problem: Problem) -> Solve:
        """The kernel with its inputs already laid out."""
        return kernel_call(problem.model, problem.contacts, problem.vision)


def with_starts(problem: Problem, starts: int) -> Solve:
    """Both phases in a batch of `starts` draws of the prior, on all cores, from the public door."""
    method = hs.TwoPhase(starts=starts, reject_outliers=False)
    model, contacts, vision, outside = problem.model, problem.contacts, problem.vision, problem.outside
    return lambda: (
        hs.correct_pose(model, contacts, vision=vision, outside=outside, method=method).T_palm_object
    )
