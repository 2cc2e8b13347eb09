"""When the two phases end, and how the posterior is read."""

import numpy as np

MAX_TURN = 0.7
"""Longest turn of one step [rad]: beyond it the linearisation says nothing."""
MATCH_STEPS, MATCH_TOLERANCE = 8, 0.02
"""Most steps of phase 1, and the step [radii] that ends it."""
WIDEST_OF_ONE = 0.225
"""A prior narrower than this part of the diameter needs one start."""
COARSE_LIMITS, FINE_LIMITS = (2, 0.3), (50, 0.03)
"""Most steps of a descent, and the step [standard deviations] that ends it; the coarse field is off by more anyway."""
SHORT_STEP = 2e-5
"""A step is short when it moves no part of the object by more than this many radii."""
OPEN = 1 / 3
"""A direction is unobservable when touch alone leaves it a standard deviation above this part of the radius."""
KNOWN = 1e-12
"""An information this much smaller than the largest [1/m²] is none."""
STRIDE, SECANT_PASSES = 1.5, 3
"""How many deviations from a mode its cost is read, and how often at most, each time with the last deviations."""
LEAST_FACTOR = 0.05
"""The most that one pass lowers an information."""
CANDIDATE_APART = (0.002, float(np.deg2rad(2.0)))
"""Two descents are worth finishing both when further apart than this [m] or turned by more than this [rad]."""
MATCHED_APART = (0.001, float(np.deg2rad(1.0)))
"""After phase 1 two are worth going on with both when further apart than this."""
DEPARTS, FAR = 1.5, 2.3
"""A mode is no Gaussian when the cost beside it rises by this much more than a Gaussian's; where one is none, walls are
looked for so many deviations away, too."""
SLIDE, NARROW = 0.02, 0.02
"""Such a direction is worth an integral when its deviation is above this part of the radius; it is done with one above
the other, if anything is."""
MOST_OPEN, MOST_MEANS = 3, 3
"""Directions along which a mode is integrated, the widest; modes whose means are taken, the likeliest."""
PLACES = (4.0, 2.0, 1.3)
"""Places in a deviation along one, two or three directions."""
DEPTH = 6.0
"""A place that costs this much more than the best leads no further."""
GIVE = 3.0
"""Deviations by which the deepest dent of a bumpy model may be below the place that is right: 1.5 below what is usual,
as the least of ten or so is, that 1.5 above it."""
ROUNDS, MOST_PLACES = 5, 600
"""Lattices that are laid until one is fine enough, and places of each at most."""
REACH = (200, 40, 15)
"""Places to either side of the mode, along one, two or three directions."""
RISE, PROBES, SWEEPS = 2.0, 6, 2
"""A direction reaches as far as its cost rises by this; how often it is read to either side to find that, and how
often all directions are followed."""
SPREAD = (0.6, 0.8, 0.8)
"""A deviation in such reaches, along one, two or three directions."""
LIGHT = 7.0
"""A mode whose log weight is this much less than another's stays its maximum."""
NEAR2 = 16.0
"""A mode so near to a place, in squared deviations across the slide, belongs to it."""
LOOK_REACH, LOOK_SLOPE = 0.2, 1.25
"""Points of the hand farther than this [radii] are looked at again when the object has moved by as much; a grid's
distance rises by at most so many metres a metre."""
