"""Blind: where an object stands on a table, found by touch alone; the next touch is the one that tells most."""

from handsight.search.area import Area, resting
from handsight.search.belief import Belief
from handsight.search.information import best_sweep, candidates, expected_information
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
