"""The paper's method (IROS 2013, eq. 1-6) compiled with numba."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

import handsight as hs
from benchmarks.peers import paper_kernels
from benchmarks.workload import Problem, Solve

MOST_CONTACTS = 12


@dataclass
class PaperCompiled:
    """Levenberg-Marquardt or gradient descent on regions of a cloud; vision is the start and nothing more."""

    method: hs.PaperMethod = field(default_factory=hs.PaperMethod)
    uses_normals = True
    uses_prior = False

    @property
    def name(self) -> str:
        """As tables call it."""
        return f"paper {self.method.optimizer.upper()}, compiled"

    def prepare(self, model: hs.ObjectModel) -> None:
        """The cloud, drawn as handsight's own PaperMethod draws it, and space for the regions."""
        points, normals = model.sample(self.method.cloud_size)
        self._cloud = np.ascontiguousarray(np.hstack([points, normals]).T)
        self._center = np.ascontiguousarray(model.center_object)
        self._space = np.empty((MOST_CONTACTS, 6, len(points))), np.empty(len(points))

    def ready(self, problem: Problem) -> Solve:
        """Regions and descent; the cloud stays."""
        result = self.full(problem)
        return lambda: result()[0]

    def full(self, problem: Problem) -> Callable[[], tuple[np.ndarray, int, bool]]:
        """A call that answers pose, steps and whether it came to rest."""
        m = self.method
        options = np.array([m.damping, m.learning_rate, m.step, 100 * m.tolerance, m.optimizer == "gd",
                            m.max_iterations, m.patience, m.epsilon, m.min_points,
                            100 * m.w_n if m.normals else 0.0], dtype=np.float64)  # fmt: skip
        cloud, center, space = self._cloud, self._center, self._space
        contacts = np.hstack([problem.contacts.points_palm, problem.contacts.normals_palm])
        T = np.ascontiguousarray(problem.vision.T_palm_object)
        return lambda: paper_kernels.correct(cloud, contacts, T, center, options, space)
