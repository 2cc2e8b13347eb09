"""Verdicts on declared values: what a recording tells of each, and whether it contradicts it."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


class DiagnosisOptions(NamedTuple):
    """`DiagnosisOptions` say which instants of a recording are compared, and when a value is called wrong."""

    new_contact: float = 0.01
    """An instant is kept where a finger touches by so much elsewhere in the palm than in all kept instants [m]: others
    have the same errors, as those of a bent tip or of a soft one, and would count them again. On simulated grasps of a
    can, 3 mm made the errors of the estimates three times their sigmas."""
    new_normal: float = float(np.deg2rad(30.0))  # or where the normal is turned by so much [rad]
    min_fingers: int = 3  # an instant has so many fingers or more: fewer determine the pose alone
    min_force: float = 0.3  # each presses by so much [N]: fingers that close are not at rest yet
    max_instants: int = 200  # most instants that are kept
    unfit: float = 0.34  # at most such a share of them is left out where they do not fit the others
    enlarged: float = 1e-4  # by so much a radius is changed for a difference quotient [m]
    louder: float = 1e-3  # by such a share a reading is
    wide_gain: float = 0.15  # sigma of gains with which loads must be those of a weight
    passes: int = 3  # of Gauss and Newton's method
    max_errors: float = 10.0
    """Errors of more of their declared sigmas are no small errors of this hand and this object: a recording tells
    nothing of what it knows to more sigmas only."""
    sigma_size: float = 0.03  # of an object's size, as a share, which models do not declare
    sigma_compliance: float = 2e-4  # of the tips, how far each is pressed in [m/N]; it is no row of the table
    unknown_mass: float = 10.0  # sigma of a mass that is not declared [kg]
    sigma_pose: float = 0.02  # sigma of an instant's pose about the tracked one [m]; see `sigma_turn`
    sigma_turn: float = float(np.deg2rad(20.0))  # [rad]
    measured: float = 1.0
    """A value is measured where the recording's own sigma is below so many declared ones."""
    significant: float = 3.0  # a difference of fewer of the recording's own sigmas is not mentioned
    level: float = 0.01
    """Probability that any right value of a recording is called wrong."""


DIAGNOSIS = DiagnosisOptions()
UNITS = {"mm": 1e3, "°": 180 / math.pi, "%": 100.0, "N": 1.0, "g": 1e3, "ms": 1e3, "": 1.0}
"""So many of each unit are one in SI."""


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A `Diagnosed` is one declared value, and what a recording tells of it."""

    name: str
    """Such as `tip ff radius` or `joint robot0:FFJ2`."""
    unit: str
    declared: float
    sigma: float
    """Standard deviation that is declared, or assumed, of the value."""
    estimated: float
    """The value that the recording alone tells; NaN where it tells nothing."""
    sigma_estimated: float
    """Its standard deviation; infinite where the recording tells nothing."""
    chi2: float
    """Squared deviation of the estimate from the declared value, in units of its variance if that value is right."""
    freedom: int = 1
    """Degrees of freedom of `chi2`: how many numbers it is the length of, such as 3 of a force."""
    wrong: bool = False
    """Whether the recording contradicts the value."""

    @property
    def measured(self) -> bool:
        """Whether the recording tells more of the value than was declared."""
        return self.sigma_estimated < DIAGNOSIS.measured * self.sigma

    def numbers(self) -> dict[str, object]:
        """Returns the value as it is written to a file; None where the recording tells nothing."""
        names = "name", "unit", "declared", "sigma", "estimated", "sigma_estimated", "chi2", "verdict"
        unknown = () if math.isfinite(self.sigma_estimated) else ("estimated", "sigma_estimated")
        return {name: None if name in unknown else getattr(self, name) for name in names}

    @property
    def verdict(self) -> str:
        """What to think of the value, in words."""
        if not self.measured and not self.wrong:
            return "not measured by this recording"
        more = self.estimated - self.declared
        unit = "" if self.unit == "°" else " "
        differs = f"{abs(more):.{1 if abs(more) < 10 else 0}f}{unit}{self.unit} {'larger' if more > 0 else 'smaller'}"
        if self.wrong:
            return f"{differs} than declared"
        significant = abs(more) > DIAGNOSIS.significant * self.sigma_estimated
        return f"{differs}, within ±" if significant else "agrees"


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A `Diagnosis` compares what a rig and a model declare with a recording."""

    values: tuple[Diagnosed, ...]
    instants: int
    """The number of different grasps that were compared."""
    message: str = ""
    """Why the contacts were not compared with what is declared; empty where they were."""

    @property
    def wrong(self) -> tuple[Diagnosed, ...]:
        """The values that the recording contradicts, the worst first."""
        return tuple(sorted((value for value in self.values if value.wrong), key=lambda value: -value.chi2))


def diagnosed(name: str, unit: str, declared: float, prior: float, error: float, sigma: float) -> Diagnosed:
    """Returns a value from its estimate, in SI units.

    `declared`: the value, with its sigma `prior`; `error`: estimated less declared value, with its `sigma`, where that
    estimate includes the declared value as its prior.
    """
    factor = UNITS[unit]
    own = 1 / sigma**2 - 1 / prior**2 if prior > 0 else 0.0  # what is declared exact stays as it is
    if own * (DIAGNOSIS.max_errors * prior) ** 2 < 1:  # the recording tells next to nothing
        return Diagnosed(name, unit, factor * declared, factor * prior, math.nan, math.inf, 0.0)
    estimated, sigma_estimated = declared + error / sigma**2 / own, own**-0.5
    chi2 = error**2 / (prior**2 - sigma**2)
    known = factor * declared, factor * prior, factor * estimated, factor * sigma_estimated
    return Diagnosed(name, unit, *known, chi2)
