"""Open3D's usual first pose: FPFH features, RANSAC over their matches, point-to-plane ICP, by its manual's recipe.

Model and scene are clouds of 5 mm voxels. RANSAC draws three matches, checks the lengths of their edges and their
distances, and ends after 4 million draws or at a confidence of .999. The model's features are made beforehand.
"""

import numpy as np
import open3d as o3d

import handsight as hs
from benchmarks.peers.open3d_icp import cloud_of
from benchmarks.workload import Solve
from handsight import se3
from handsight.vision.object.region import Scene

registration = o3d.pipelines.registration
VOXEL = 5e-3
"""[m]"""
NORMALS = o3d.geometry.KDTreeSearchParamHybrid(2 * VOXEL, 30)
AROUND = o3d.geometry.KDTreeSearchParamHybrid(5 * VOXEL, 100)
NEAR, EDGES, DRAWS, CONFIDENCE = 1.5 * VOXEL, 0.9, 4_000_000, 0.999


class FpfhRansacIcp:
    """The best guess alone: it has no modes."""

    name = "Open3D FPFH + RANSAC + ICP"

    def prepare(self, model: hs.ObjectModel) -> None:
        """The model's cloud with its own normals, as dense as a scene's, and its features."""
        self._model = cloud_of(*model.sample(int(8 * model.area / VOXEL**2))).voxel_down_sample(VOXEL)
        self._model.normalize_normals()
        self._features = registration.compute_fpfh_feature(self._model, AROUND)

    def ready(self, scene: Scene) -> Solve:
        """One search, from the points of the scene's parts on."""
        cloud = cloud_of(points_of(scene))

        def solve() -> np.ndarray | None:
            o3d.utility.random.seed(0)
            seen = cloud.voxel_down_sample(VOXEL)
            if len(seen.points) < 3:
                return None
            seen.estimate_normals(NORMALS)
            seen.orient_normals_towards_camera_location(np.zeros(3))
            first = self._guess(seen)
            plane = registration.TransformationEstimationPointToPlane()
            found = registration.registration_icp(seen, self._model, NEAR, first, plane)
            return se3.inverse(np.asarray(found.transformation))

        return solve

    def _guess(self, seen: o3d.geometry.PointCloud) -> np.ndarray:
        """T_object_camera that most of the measured points agree on."""
        features = registration.compute_fpfh_feature(seen, AROUND)
        checks = [
            registration.CorrespondenceCheckerBasedOnEdgeLength(EDGES),
            registration.CorrespondenceCheckerBasedOnDistance(NEAR),
        ]
        found = registration.registration_ransac_based_on_feature_matching(
            seen,
            self._model,
            features,
            self._features,
            mutual_filter=False,
            max_correspondence_distance=NEAR,
            estimation_method=registration.TransformationEstimationPointToPoint(False),
            ransac_n=3,
            checkers=checks,
            criteria=registration.RANSACConvergenceCriteria(DRAWS, CONFIDENCE),
        )
        return np.asarray(found.transformation)


def points_of(scene: Scene) -> np.ndarray:
    """(n, 3) in the camera [m]: of every pixel that may be the object's."""
    there = scene.labels >= 0
    z = scene.depth[there].astype(np.float64)
    return np.column_stack([scene.camera.rays[there] * z[:, None], z])
