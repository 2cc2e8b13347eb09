"""Correction: from contacts and vision to a pose with its uncertainty."""

from handsight.correction.correct import METHODS, correct_pose, correct_poses, refine_pose
from handsight.correction.estimate import (
    Conflict,
    Hypothesis,
    PoseEstimate,
    PosePrior,
    Residuals,
    bounded_covariance,
)
from handsight.correction.modes import pose_distances
from handsight.correction.outside import MOST_PLANES, MOST_POINTS, Outside, Plane
from handsight.correction.paper import PaperMethod
from handsight.correction.problem import MOST_CONTACTS
from handsight.correction.skin import SkinEvidence
from handsight.correction.weight import WeightEvidence

__all__ = [
    "METHODS",
    "MOST_CONTACTS",
    "MOST_PLANES",
    "MOST_POINTS",
    "Conflict",
    "Hypothesis",
    "Outside",
    "PaperMethod",
    "Plane",
    "PoseEstimate",
    "PosePrior",
    "Residuals",
    "SkinEvidence",
    "WeightEvidence",
    "bounded_covariance",
    "correct_pose",
    "correct_poses",
    "pose_distances",
    "refine_pose",
]
