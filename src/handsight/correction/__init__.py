"""Correction: from contacts and vision to a pose with its uncertainty."""

from handsight.correction.correct import METHODS, MOST_SAMPLES, correct_pose, correct_poses, refine_pose
from handsight.correction.depth import DepthPoints
from handsight.correction.estimate import (
    Conflict,
    Hypothesis,
    PoseEstimate,
    PosePrior,
    Residuals,
    bounded_covariance,
)
from handsight.correction.mean import ANSWERS
from handsight.correction.modes import pose_distances
from handsight.correction.outside import MOST_PLANES, MOST_POINTS, Outside, Plane
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import MOST_CONTACTS, TwoPhase
from handsight.correction.skin import SkinEvidence
from handsight.correction.weight import WeightEvidence

__all__ = [
    "ANSWERS",
    "METHODS",
    "MOST_CONTACTS",
    "MOST_PLANES",
    "MOST_POINTS",
    "MOST_SAMPLES",
    "Conflict",
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
    "bounded_covariance",
    "correct_pose",
    "correct_poses",
    "pose_distances",
    "refine_pose",
]
