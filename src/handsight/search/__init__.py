"""Search by touch: finds an object on a table without a camera, by the most informative sweeps of a fingertip."""

from handsight.search.area import Area, resting
from handsight.search.belief import Belief
from handsight.search.sweep_choice import best_sweep, candidates, expected_information
from handsight.search.touch import Sweep, Touch, cast

__all__ = [
    "Area",
    "Belief",
    "Sweep",
    "Touch",
    "best_sweep",
    "candidates",
    "cast",
    "expected_information",
    "resting",
]
