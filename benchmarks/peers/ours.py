"""handsight itself: the public call, and its compiled solve alone."""

import importlib
import inspect

import handsight as hs
from benchmarks.peers import Skipped
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

    def __init__(self) -> None:
        """Raises Skipped where this handsight has no such kernel."""
        # THE PLACE for the kernel: `kernel_call(model, contacts, vision)` answers a call that runs the compiled solve
        # of that problem alone and answers its pose as `workload.pose_of` reads it (None: timed, but not judged).
        try:
            self._call = importlib.import_module("handsight.correction.compiled").kernel_call
        except (ImportError, AttributeError):
            raise Skipped("this handsight has no handsight.correction.compiled.kernel_call") from None

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model is all."""

    def ready(self, problem: Problem) -> Solve:
        """The kernel with its inputs already laid out."""
        return self._call(problem.model, problem.contacts, problem.vision)


def with_starts(problem: Problem, starts: int) -> Solve:
    """Both phases in a batch of `starts` draws of the prior, on all cores, from the public door."""
    method = hs.TwoPhase(starts=starts, reject_outliers=False)
    model, contacts, vision, outside = problem.model, problem.contacts, problem.vision, problem.outside
    return lambda: (
        hs.correct_pose(model, contacts, vision=vision, outside=outside, method=method).T_palm_object
    )


def is_compiled() -> bool:
    """Whether this handsight has compiled kernels, and so a NumPy twin to choose."""
    return "compiled" in inspect.signature(hs.TwoPhase).parameters
