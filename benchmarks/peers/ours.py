"""handsight itself: the public call, and its compiled solve alone."""

import numpy as np

import handsight as hs
from benchmarks.kernels import kernel_call
from benchmarks.workload import Problem, Solve
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.first_pose import first_pose
from handsight.vision.object.region import Scene


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


class OursKernel(Ours):
    """The compiled two-phase solve from one start: no checks, no outliers, no modes, no covariance."""

    name = "handsight, kernel"

    def ready(self, problem: Problem) -> Solve:
        """The kernel with its inputs already laid out."""
        return kernel_call(problem.model, problem.contacts, problem.vision)


class OursFirstPose:
    """The likeliest pose of `first_pose`; timed is all from the scene on, all modes with their covariances."""

    name = "handsight"

    def prepare(self, model: hs.ObjectModel) -> None:
        """The object's appearance from all sides."""
        self._model = model
        appearance_of(model)

    def ready(self, scene: Scene) -> Solve:
        """One search."""

        def solve() -> np.ndarray | None:
            found = first_pose(self._model, scene)
            return found.Ts_camera_object[0] if len(found.weights) else None

        return solve
