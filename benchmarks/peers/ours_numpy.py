"""handsight's NumPy twin: the same method, every kernel replaced by the plain code that says what it means."""

import handsight as hs
from benchmarks.peers import Skipped
from benchmarks.peers.ours import is_compiled
from benchmarks.workload import Problem, Solve


class OursNumPy:
    """`hs.correct_pose(..., method=hs.TwoPhase(compiled=False))`."""

    name = "handsight, NumPy twin"
    uses_normals = True
    uses_prior = True

    def __init__(self) -> None:
        """Raises Skipped where NumPy is all there is."""
        if not is_compiled():
            raise Skipped("this handsight has no hs.TwoPhase(compiled=False): NumPy is all it has")
        self._method = hs.TwoPhase(compiled=False)

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model is all."""

    def ready(self, problem: Problem) -> Solve:
        """The public call, kernels left out."""
        model, contacts, vision = problem.model, problem.contacts, problem.vision
        method = self._method
        return lambda: hs.correct_pose(model, contacts, vision=vision, method=method).T_palm_object
