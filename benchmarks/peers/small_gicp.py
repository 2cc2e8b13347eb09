"""small_gicp's PLANE_ICP of the contacts onto the object's cloud, on one thread: five points do not fill two.

Target, its tree and its normals are made beforehand. Normals are those that small_gicp estimates: its Python door takes
no others. For each call with few points it writes a warning to stderr, which goes nowhere while timing (more points by
repeating contacts would silence it, and are slower and find less).
"""

from dataclasses import dataclass

import numpy as np
import small_gicp

import handsight as hs
from benchmarks.workload import Problem, Solve
from handsight import se3


@dataclass
class SmallGICP:
    """Contact points on a cloud; neither the contacts' normals nor the prior count."""

    cloud_size: int = 5000
    farthest: float = 0.1
    """Pairs farther apart are none [m]."""
    iterations: int = 20
    name = "small_gicp PLANE_ICP"
    uses_normals = False
    uses_prior = False

    def prepare(self, model: hs.ObjectModel) -> None:
        """The cloud, its tree and normals."""
        self._target = small_gicp.PointCloud(model.sample(self.cloud_size)[0])
        self._tree = small_gicp.KdTree(self._target)
        small_gicp.estimate_normals(self._target, self._tree, num_neighbors=10)

    def ready(self, problem: Problem) -> Solve:
        """One registration from vision's pose."""
        source = small_gicp.PointCloud(problem.contacts.points_palm)
        target, tree = self._target, self._tree
        first = se3.inverse(problem.vision.T_palm_object)
        options = {
            "registration_type": "PLANE_ICP",
            "max_correspondence_distance": self.farthest,
            "num_threads": 1,
            "max_iterations": self.iterations,
        }

        def solve() -> np.ndarray:
            found = small_gicp.align(target, source, tree, init_T_target_source=first, **options)
            return se3.inverse(found.T_target_source)

        return solve
