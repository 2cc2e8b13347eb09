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
    same_minimum: tuple[float, float] = (0.002, float(np.deg2rad(3.0)))
    """Two minima of one mode are distinct when they differ by more than this [m], [rad]: on a scan, and where three
    contacts leave much open, a mode has several."""
    unlikely: float = 7.0  # a minimum whose log weight is so much below the largest is no part of a mode
    negligible: float = 20.0  # one whose log weight is so much below the largest is no hypothesis
    dear: float = 100.0  # a minimum that costs so much more than the cheapest is not weighed
    first_steps: int = 2  # of phase 1, after which a start may already be where another one ended


class AcceptanceOptions(NamedTuple):
    """`AcceptanceOptions` say when the minimum that one start led to is enough."""

    alarm: float = 1e-3
    """Level of the χ² test by which evidence is called inconsistent."""
    pool: float = 0.5 * alarm
    """The part of that level that is for the test of all evidence together."""
    each: float = 0.25 * alarm
    """The part of it that is for the tests of single contacts together."""
    kind: float = 0.05 * alarm
    """The part of it that is for the test of each of five kinds of evidence against the rest."""
    recheck_p: float = 0.003
    """Level of the χ² test by which a wrong contact is searched for; a false alarm costs nothing but time."""
    doubt_p: float = 0.2
    """Level of the χ² test by which the answer from one start is doubted, where the prior is the widest for which one
    start may be enough. Two of three problems on an L-shaped mesh, with a prior of 0.22 diameters, raise no doubt."""
    doubt_plain_p: float = 0.02
    """The same on a box, a cylinder or a sphere: of 900 answers there that only the level above doubts, 16 starts led
    to a better one no more often than of those that it does not."""
    confirming: int = 7  # draws from the prior that all lead to a doubted answer before it is given
    coarse_p: float = 0.1
    """The same of the cost on the coarse field, divided by `coarse_factor`."""
    coarse_factor: float = 5.0
    decisive: float = 16.27
    """A contact is wrong when the cost falls by more than this without it: for a right one once in 1000 times."""
    few_rows: int = 9
    """Rows of evidence that leave so much open that there may be several minima: three contacts."""
    few_contacts: int = 4
    """Contacts that may, with 12 rows or fewer."""
    weak_width: float = 0.04
    """Width of the prior [diameters] above which the one minimum that a start led to is then not enough. With 5 mm and
    4° 10 % of the answers from one start on a tuna can were beyond their 99.9 % region, and 1 % from many."""


class RegistrationOptions(NamedTuple):
    """`RegistrationOptions` say how many contacts are registered, some of them wrong."""

    wrong_cost: float = 16.27
    """Squared residuals above which a contact is rather wrong: of a right one once in 1000 times."""
    wrong_distance: float = 10.83
    """The same of a contact without a normal."""
    wrong_group: float = 22.46
    """The same of the error of a group."""
    flip_cost: float = 12.0
    """What it costs, in squared residuals, that the normal of a contact says nothing."""
    median_square: float = 2.37
    """Of three standard normal residuals."""
    sharper: float = 4.0
    """By which factor, at least, the covariances come nearer to the declared ones from one descent to the next."""
    max_steps: int = 30
    small_step: float = 0.02
    """A step that is small ends a descent [standard deviations]."""
    wide_sigma: float = 0.01
    """Standard deviation, as a part of the radius, from which on the cost beside the pose is read."""
    many_rows: int = 60
    """Rows from which on their squared residuals tell how wrong the declared covariances are."""


MATCH, DESCENT, SEARCH = MatchOptions(), DescentOptions(), SearchOptions()
ACCEPTANCE, REGISTRATION = AcceptanceOptions(), RegistrationOptions()
