"""Options of a correction's search: of its two phases, and of when two poses count as the same."""

from typing import NamedTuple

import numpy as np


class MatchOptions(NamedTuple):
    """`MatchOptions` say how phase 1 works: Gauss-Newton on nearest surface samples."""

    max_steps: int = 8
    tolerance: float = 0.02
    """A step that moves no part of the object by more than this many radii ends the phase."""


class DescentOptions(NamedTuple):
    """`DescentOptions` say how phase 2 works: Levenberg-Marquardt, first on the coarse and then on the fine distance
    field."""

    max_turn: float = 0.7
    """Longest turn of one step [rad]: for more the linearisation does not hold."""
    short_step: float = 2e-5
    """A step also counts as small when it moves no part of the object by more than this many radii."""
    coarse: tuple[int, float] = (2, 0.3)
    """Most steps, and the step that is small [standard deviations], on the coarse field, whose own error is larger."""
    fine: tuple[int, float] = (50, 0.03)
    """The same on the fine field."""


class SearchOptions(NamedTuple):
    """`SearchOptions` say which starts are descended from."""

    single_start_width: float = 0.225
    """With a prior narrower than this part of the diameter one start is enough."""
    same_after_match: tuple[float, float] = (0.001, float(np.deg2rad(1.0)))
    """Two poses after phase 1 that differ by less are the same [m], [rad]."""
    same_after_coarse: tuple[float, float] = (0.002, float(np.deg2rad(2.0)))
    """Two descents on the coarse field that end nearer to each other are the same [m], [rad]."""


MATCH, DESCENT, SEARCH = MatchOptions(), DescentOptions(), SearchOptions()
