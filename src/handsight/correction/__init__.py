"""Correction: contacts and vision to a pose with its uncertainty."""

from handsight.correction.batch import correct_poses
from handsight.correction.correct import METHODS, correct_pose, follow_pose
from handsight.correction.estimate import Hypothesis, PoseEstimate, PosePrior, Residuals
from handsight.correction.paper import PaperMethod
from handsight.correction.two_phase import TwoPhase

__all__ = [
    "METHODS",
    "Hypothesis",
    "PaperMethod",
    "PoseEstimate",
    "PosePrior",
    "Residuals",
    "TwoPhase",
    "correct_pose",
    "correct_poses",
    "follow_pose",
]
