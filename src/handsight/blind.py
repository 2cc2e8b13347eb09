"""Deprecated: this room is now `handsight.search`."""

from handsight._deprecated import renamed

_NAMES = (
    "Area",
    "Belief",
    "Sweep",
    "Touch",
    "best_sweep",
    "candidates",
    "cast",
    "expected_information",
    "resting",
)
__getattr__ = renamed(__name__, {name: f"handsight.search.{name}" for name in _NAMES})
