"""Search by touch: finds an object on a table without a camera, by the most informative sweeps of a fingertip."""

from handsight.search.area import Area, Sweep, Touch, cast, resting, with_symmetries_of_touch
from handsight.search.belief import Belief
from handsight.search.sweep_choice import best_sweep, candidates, expected_information

__all__ = [
    "Area", "Belief", "Sweep", "Touch", "best_sweep", "candidates", "cast", "expected_information",
    "resting", "with_symmetries_of_touch",
]  # fmt: skip
