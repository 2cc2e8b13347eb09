"""Correction: contacts and vision to a pose with its uncertainty."""

from handsight.correction.batch import correct_poses
from handsight.correction.correct import METHODS, MOST_SAMPLES, correct_pose, refine_pose
from handsight.correction.estimate import Hypothesis, PoseEstimate, PosePrior, Residuals
from handsight.correction.mean import ANSWERS
from handsight.correction.outside import Outside, Plane
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import TwoPhase
from handsight.correction.weight import WeightEvidence

__all__ = [
    "ANSWERS",
    "METHODS",
    "MOST_SAMPLES",
    "Hypothesis",
    "Outside",
    "PaperMethod",
    "Plane",
    "PoseEstimate",
    "PosePrior",
    "Residuals",
    "TwoPhase",
    "WeightEvidence",
    "correct_pose",
    "correct_poses",
    "refine_pose",
]
