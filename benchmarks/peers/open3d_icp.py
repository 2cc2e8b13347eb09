"""Open3D's point-to-plane ICP of the contacts onto the object's cloud.

`registration_icp` builds the tree of its target inside every call and offers no way to keep it; that is in its time.
It uses the threads that Open3D chooses. Its steps are not damped: five contacts give five equations for six unknowns,
and where that is singular it leaves the object.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d

import handsight as hs
from benchmarks.workload import Problem, Solve
from handsight import se3

registration = o3d.pipelines.registration
o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)


def cloud_of(points: np.ndarray, normals: np.ndarray | None = None) -> Any:
    """An Open3D cloud."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.copy()))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


@dataclass
class Open3DICP:
    """Contact points on a cloud with exact normals; neither the contacts' normals nor the prior count."""

    cloud_size: int = 5000
    farthest: float = 0.1
    """Pairs farther apart are none [m]."""
    name = "Open3D point-to-plane ICP"
    uses_normals = False
    uses_prior = False

    def prepare(self, model: hs.ObjectModel) -> None:
        """The cloud and its normals."""
        self._target = cloud_of(*model.sample(self.cloud_size))

    def ready(self, problem: Problem) -> Solve:
        """One registration from vision's pose."""
        source, target, farthest = cloud_of(problem.contacts.points_palm), self._target, self.farthest
        first = se3.inverse(problem.vision.T_palm_object)
        plane = registration.TransformationEstimationPointToPlane()
        criteria = registration.ICPConvergenceCriteria(1e-6, 1e-6, 50)

        def solve() -> np.ndarray:
            found = registration.registration_icp(source, target, farthest, first, plane, criteria)
            return se3.inverse(np.asarray(found.transformation))

        return solve
