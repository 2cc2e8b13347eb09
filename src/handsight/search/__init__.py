"""Search by touch: finds an object on a table without a camera, by the most informative sweeps of a fingertip."""

from handsight.search.area import Area, resting
from handsight.search.belief import Belief
from handsight.search.story import open_text, symmetry_text, touch_text
from handsight.search.sweep_choice import best_sweep, candidates, expected_information
from handsight.search.touch import Sweep, Touch, cast, with_symmetries_of_touch

__all__ = [
    "Area", "Belief", "Sweep", "Touch", "best_sweep", "candidates", "cast", "expected_information", "open_text",
    "resting", "symmetry_text", "touch_text", "with_symmetries_of_touch",
]  # fmt: skip
