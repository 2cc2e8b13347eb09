"""Options of slip detection, and the records of its kernel: loads over time, sensor by sensor."""

import math
from typing import NamedTuple

from handsight._compiled.records import record


class FrictionOptions(NamedTuple):
    """`FrictionOptions` say how a friction coefficient is learnt from turns of the ratio vectors."""

    torsion: float = 0.005
    """e, the largest torque about the normal that a tip can bear, relative to the largest tangential force [m]."""
    min_turn: float = 0.05  # a ratio vector has turned once it has moved by this share of its length
    max_radial: float = 0.3  # and its length has changed by at most this share of that motion
    min_ratio: float = 0.05  # smallest ratio that is counted
    max_ratio: float = 10.0  # largest ratio that is counted
    bin_width: float = 0.01  # width of the bins, in the logarithm of the ratio, in which turns are counted
    band: int = 5  # so many neighbouring bins make a heap
    top: int = 8
    """The limit is the fullest heap among this one, if it is high enough to be the limit, and so many bins below: noise
    spreads the ratios of a slide to both sides."""
    min_turns: int = 5  # fewest turns of a heap
    min_share: float = 0.1
    """The same as a share of the turns in the largest heap that is at most `max_below` bins below: a few turns that are
    spread over higher ratios, as by a tip that touches at two places, are not the limit."""
    max_below: int = 50
    noise: float = 0.02  # by this share the ratio that two fingers have kept up may be above μ
    noise_of_slides: float = 0.1  # the same after slides have shown μ
    keep_up: float = 0.1
    """Time constant with which a kept-up ratio rises [s]: a tip that is hit, or touches at two places for a moment, has
    higher ratios than μ, but not for long."""
    least_sigma: float = 0.02  # of the logarithm of μ: the limit surface is not quite an ellipsoid
    turn_sigma: float = (
        1.0  # the same of one turn, which sticking contacts make too; it falls with the root of turns
    )
    max_sigma: float = 0.25  # the same beyond which μ is in doubt


FRICTION = FrictionOptions()
FIRST = round(math.log(FRICTION.min_ratio) / FRICTION.bin_width)
BINS = round(math.log(FRICTION.max_ratio) / FRICTION.bin_width) - FIRST + 1
"""Number of the first bin of ratios, and how many there are."""


class SlipOptions(NamedTuple):
    """`SlipOptions` say when contacts slip, as thresholds on a finger's ratio."""

    begin_ratio: float = 1.0  # a slip begins when the least ratio, with its noise, is at this
    end_ratio: float = 0.99  # and ends when it has been below this for `min_hold`
    gain_sigmas: float = 2.0
    """A ratio of taxels may be higher than they read by so many standard deviations of their gain. That hides whether a
    finger rests just below its limit or slides; but loads at rest are constant, and those of a slide are not."""
    change_sigmas: float = 1.2  # of taxels' gain, by which loads that are not constant differ from their mean
    rest: float = 0.05  # time constant of that running mean [s]
    stick_ratio: float = 0.4  # a slip ends at once when a ratio is below this
    min_chatter: float = 0.08
    """A finger at its limit bounces if its normal force changes by this share of itself from one reading to the next;
    one that has come to rest at its limit after it slid does not."""
    min_bouncing: int = 3  # fewest such fingers that slip while one other finger sticks
    min_hold: float = 0.008  # at the limit of slipping, ratios fluctuate [s]
    window: float = 0.016  # of the readings from which a ratio is computed; two at least [s]
    ratio_sigma: float = 0.04
    """Readings are averaged only as far as a ratio's noise is above this: the upper half of several is above their true
    mean by 0.7 standard deviations."""
    time_constant: float = 0.01  # of the running mean of vectors from which friction is learnt [s]
    max_gap: float = 0.1  # between two readings: after a longer one the mean starts anew [s]
    min_force: float = 0.2  # normal force above which a finger's ratio counts [N]
    sure_force: float = 0.5  # normal force above which friction is learnt from the ratio [N]
    min_force_sigmas: float = 10.0  # the first is at least so many standard deviations of a reading
    sure_force_sigmas: float = 40.0  # the second is at least so many


SLIP = SlipOptions()

MOST_READINGS = 32
"""The most readings of a window; above 2000 a second it is shorter."""
LOAD_LIMITS = record(
    ("min_force", "f8"),  # normal force above which a sensor's ratio counts [N]
    ("sure_force", "f8"),  # the same above which friction is learnt from it [N]
    ("noise", "f8"),  # of its tangential load [N]
    # Relative error of its ratio; 0: of a six-axis sensor, which has the same gain at every place.
    ("gain", "f8"),
    ("relative", "f8"),  # its μ relative to the common one
)
LOAD_MEMORY = record(
    ("mean", "f8", (5,)),  # running mean of its load; NaN where it had none at the last update
    ("rest", "f8", (5,)),  # the same over `SLIP.rest`
    ("tangential", "f8"),  # √(f_t² + (τ / e)²), averaged as far as its noise requires [N]
    ("normal", "f8"),  # the same of f_n [N]
    ("count", "i8"),  # of its last readings
    ("last", "f8", (MOST_READINGS, 3)),  # their ratios without μ, stamps [s] and normal forces [N]
    # The ratio vector, and normal force [N], from which its next turn is measured; NaN: none.
    ("anchor", "f8", (5,)),
    ("kept_up", "f8"),  # the highest ratio that it has kept up; NaN before it had one
)
LOAD_READ = record(
    ("measured", "i8"),  # whether the load is known
    ("ratio", "f8"),  # without μ; NaN where none counts
    ("highest", "f8"),  # the same with a standard deviation of its noise
    ("turned", "f8"),  # the ratio at which that vector has turned; 0: it has not
)
