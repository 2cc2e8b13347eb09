"""OpenCV's first pose: point-pair votes (Drost and others, CVPR 2010) and its own ICP, `cv2.ppf_match_3d`.

Model and scene are sampled at 10 % of the model's diameter, for it to train within seconds (its manual's example: 5 %).
Every second point of the scene votes; its ten best poses are refined. It gets the scene's points with the
normals that ours has there, in millimetres.
"""

import cv2
import numpy as np
from cv2 import ppf_match_3d as ppf

import handsight as hs
from benchmarks.workload import Solve
from handsight.vision.object.region import Scene, observed_points

STEP, VOTING = 0.1, 0.5
"""Between points [diameters of the model]; the share of the scene's points that vote."""
SAMPLES, SPACING, MOST_POINTS = 2000, 3e-3, 20_000
"""Of the model, and of the scene, how far apart [m] and how many at most, before OpenCV samples them."""
REFINED, ITERATIONS, TOLERANCE, REJECTION, LEVELS = 10, 100, 0.005, 2.5, 6
"""Poses that ICP refines, and how: the numbers of its manual's example."""
MM = 1e3


class PpfVotesIcp:
    """The refined pose that most votes are for."""

    name = "OpenCV ppf_match_3d + ICP"

    def prepare(self, model: hs.ObjectModel) -> None:
        """Trains on points of the model."""
        cv2.setNumThreads(1)
        points, normals = model.sample(SAMPLES)
        self._model = np.hstack([MM * points, normals]).astype(np.float32)
        self._detector = ppf.PPF3DDetector(STEP, STEP)
        self._detector.trainModel(self._model)
        self._icp = ppf.ICP(ITERATIONS, TOLERANCE, REJECTION, LEVELS)

    def ready(self, scene: Scene) -> Solve:
        """One search, from the points of the scene's parts on."""

        def solve() -> np.ndarray | None:
            seen = observed_points(scene, SPACING, MOST_POINTS)
            seen = seen[(seen["normal"] != 0).any(axis=1)]
            points = np.hstack([MM * seen["point"], seen["normal"]]).astype(np.float32)
            guesses = self._detector.match(points, VOTING, STEP)[:REFINED] if len(points) >= REFINED else []
            if not guesses:
                return None
            _, refined = self._icp.registerModelToScene(self._model, points, guesses)
            T = np.array(min(refined, key=lambda guess: guess.residual).pose)
            T[:3, 3] /= MM
            return T

        return solve
