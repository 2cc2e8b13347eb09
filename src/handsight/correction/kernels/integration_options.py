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
    """`IntegrationOptions` say how a mode is integrated along its flat directions, on a line or a lattice of points."""

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
    first_step: float = 1.5
    """The step from the mode to either side, on an exact surface [standard deviations by the slopes there]."""
    wall_fall: float = 4.0
    """Between two points whose logarithms of the density differ by more there may be a wall."""
    wall_depth: float = 2.0
    """A place is beyond it where the logarithm, by the cost alone, is this much below that of the point before."""
    halvings: int = 6
    """How often the gap is halved in which a wall is."""
    given_up: float = 30.0
    """Where it is this much below the largest, the other coordinates stay as they are."""
    max_fall: float = 5.0
    """A line ends where the logarithm of the density is this much below the largest."""
    small_fall: float = 0.3
    """Where it falls by less from one point to the next, the line's end goes on by twice as far."""
    misplaced: float = 0.06
    """Part of the integral that may be at the wrong place in one gap: its length times the densities' difference, and,
    where that falls smoothly, times how much the bends around it differ."""
    deepest: float = 8.0
    """The logarithm is interpolated as if it fell no further below the largest: a wall is then amid its gap."""
    steps_across: int = 3
    """Most steps to the best of the other directions."""
    large_fall: float = 1.0
    """The next one is taken after a step by which the cost falls by more than this."""
    parts: int = 6
    """Places at which the density is interpolated in a gap."""
    points_per_sigma: tuple[tuple[float, float], tuple[float, float]] = (1.4, 1.3), (2.0, 1.3)
    """Lattice points in a standard deviation, along two or three directions, on an exact surface and on a grid."""
    max_cost: float = 6.0
    """The lattice does not grow from a point that costs this much more than the best."""
    bump_sigmas: float = 3.0
    """By how many standard deviations of a noisy model's cost its deepest dent may be below the right pose: 1.5 from
    the mean to the least of about ten dents, and 1.5 from the mean to the cost at the right pose."""
    max_lattices: int = 5
    """Lattices that are tried until one is fine enough."""
    max_points: tuple[int, int] = (40, 600)
    """Points of a line, and of one lattice."""
    max_extent: tuple[int, int] = (40, 15)
    """Points of a lattice to either side of the mode, along two or three directions."""
    rise: float = 2.0
    """A direction reaches as far as its cost rises by this."""
    max_probes: int = 6
    """How often the cost is read to either side to find where."""
    sweeps: int = 2
    """How often all directions are measured."""
    sigma_of_reach: float = 0.8
    """A standard deviation as a part of the reach."""
    min_log_weight: float = 7.0
    """A mode whose log weight is less than another's by more than this is not integrated."""
    same_mode: float = 16.0
    """Another mode this near to a lattice point, in squared standard deviations across the flat directions, is part of
    the same mean."""


CALIBRATION, INTEGRATION = CalibrationOptions(), IntegrationOptions()
