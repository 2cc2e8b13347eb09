"""Correction: contacts and vision to a pose with its uncertainty."""

from handsight.correction.correct import METHODS, MOST_SAMPLES, correct_pose, correct_poses, refine_pose
from handsight.correction.depth import DepthPoints
from handsight.correction.estimate import Hypothesis, PoseEstimate, PosePrior, Residuals
from handsight.correction.mean import ANSWERS
from handsight.correction.outside import Outside, Plane
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import TwoPhase
from handsight.correction.skin import SkinEvidence
from handsight.correction.weight import WeightEvidence

__all__ = [
    "ANSWERS",
    "METHODS",
    "MOST_SAMPLES",
    "DepthPoints",
    "Hypothesis",
    "Outside",
    "PaperMethod",
    "Plane",
    "PoseEstimate",
    "PosePrior",
    "Residuals",
    "SkinEvidence",
    "TwoPhase",
    "WeightEvidence",
    "correct_pose",
    "correct_poses",
    "refine_pose",
]
