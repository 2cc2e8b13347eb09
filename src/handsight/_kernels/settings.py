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
LOOK_REACH, LOOK_SLOPE = 0.2, 1.25
"""Points of the hand farther than this [radii] are looked at again when the object has moved by as much; a grid's
distance rises by at most so many metres a metre."""
