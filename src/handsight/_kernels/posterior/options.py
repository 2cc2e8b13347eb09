"""Options: how the information of a mode is calibrated, and how a mode that is not Gaussian is integrated."""

from typing import NamedTuple


class CalibrationOptions(NamedTuple):
    """`CalibrationOptions` say how an information matrix is calibrated by the cost of its own mode."""

    open_sigma: float = 1 / 3
    """A direction is unobservable when touch alone leaves it a standard deviation above this part of the radius."""
    negligible: float = 1e-12
    """An information smaller than the largest by this factor is none."""
    stride: float = 1.5
    """How many standard deviations from a mode its cost is read."""
    secant_passes: int = 3
    """How often the cost is read at most, each time at the standard deviation found last."""
    min_factor: float = 0.05
    """The most by which one pass lowers an information."""
    wide_sigma: float = 0.02
    """A direction may be integrated over when its standard deviation is above this part of the radius."""


class IntegrationOptions(NamedTuple):
    """`IntegrationOptions` say how a mode is integrated along its flat directions, on a lattice of points."""

    max_gaussian_rise: float = 1.5
    """A mode is not Gaussian when the cost beside it rises by more than this factor times a Gaussian's."""
    wall_stride: float = 2.3
    """The cost is also read at so many standard deviations, where walls may be."""
    narrow_sigma: float = 0.02
    """A direction is integrated over only above this standard deviation, as a part of the radius."""
    max_directions: int = 3
    """Flat directions of one mode, the widest."""
    max_modes: int = 3
    """Modes that are integrated, the likeliest."""
    points_per_sigma: tuple[float, float, float] = (4.0, 2.0, 1.3)
    """Lattice points in a standard deviation, along one, two or three directions."""
    max_cost: float = 6.0
    """The lattice does not grow from a point that costs this much more than the best."""
    bump_sigmas: float = 3.0
    """By how many standard deviations of a noisy model's cost its deepest dent may be below the right pose: 1.5 from
    the mean to the least of about ten dents, and 1.5 from the mean to the cost at the right pose."""
    max_lattices: int = 5
    """Lattices that are tried until one is fine enough."""
    max_points: int = 600
    """Points of one lattice."""
    max_extent: tuple[int, int, int] = (200, 40, 15)
    """Points to either side of the mode, along one, two or three directions."""
    rise: float = 2.0
    """A direction reaches as far as its cost rises by this."""
    max_probes: int = 6
    """How often the cost is read to either side to find where."""
    sweeps: int = 2
    """How often all directions are measured."""
    sigma_of_reach: tuple[float, float, float] = (0.6, 0.8, 0.8)
    """A standard deviation as a part of the reach, along one, two or three directions."""
    min_log_weight: float = 7.0
    """A mode whose log weight is less than another's by more than this is not integrated."""
    same_mode: float = 16.0
    """Another mode this near to a lattice point, in squared standard deviations across the flat directions, is part of
    the same mean."""


CALIBRATION, INTEGRATION = CalibrationOptions(), IntegrationOptions()
