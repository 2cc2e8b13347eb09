"""Records of tactile surfaces, their patches and their faults; numba is not needed to make them."""

import numpy as np

NEAR, WIDE = 8, 24  # most neighbours of a taxel that touch it, and most of those up to two taxels away
TAXEL = np.dtype([
    ("point", float, 3),  # in the link [m]
    ("axes", float, (3, 3)),  # columns: the taxel's x and y, and the outward normal
    ("bend", float, (3, 3)),  # change of the normal by that of the point [1/m]
    ("slope", float, (2, NEAR)),  # weights of the neighbours' rises over it in the slope along its x and y [1/m]
    ("edge", float, 3),  # mean unit vector to its neighbours: 0 amid them, of length 1 on one side of them
    ("near", np.int64, NEAR),  # neighbours; the number of taxels where there are fewer
    ("wide", np.int64, WIDE),  # those up to two taxels away
    ("beside", np.int64, 4),  # the neighbour towards -x, +x, -y, +y
])  # fmt: skip
"""One taxel of a surface."""
SURFACE = np.dtype([
    *(("scale", float, 3), ("offset", float, 3), ("threshold", float), ("full_scale", float)),
    *(("noise", float), ("variance_point", float), ("variance_normal", float)),
    ("pitch", float),  # side of a taxel [m]
    ("variance_mount", float, 6),  # of the common error, shift [m²] and turn [rad²]
    ("flat", bool),  # whether all normals are parallel
    ("indentation", bool),  # whether readings are indentations [m]
])  # fmt: skip
"""What all taxels of a surface have in common; the names are those of `handsight.contact.TactileSurface`."""
PATCH = np.dtype([
    *((name, float, 3) for name in ("point", "normal", "force")),  # as a `handsight.contact.Contact` has
    ("covariance", float, (6, 6)),
    ("torque", float),  # NaN, as the force is, unless there are three components, none at its full scale
    ("wrench", float, 6),  # the force, and its torque about the link's origin [N m]
    ("total", float),  # sum of the readings along the normals
    ("flat", bool),
])  # fmt: skip
"""Taxels that touch each other, and the contact at their centre of pressure, in the link."""
WATCHED = np.dtype([
    *((name, float, 3) for name in ("mean", "first", "last")),  # reading at rest, at first, and last
    ("varied", bool),  # whether it has changed at rest
    ("still", np.int64),  # readings since its last change
    ("fault", np.int64),  # number in `FAULTS`
])  # fmt: skip
"""What one taxel has read over time."""
FAULTS = ("", "dead", "stuck", "at full scale", "drifting")
_, DEAD, STUCK, FULL, DRIFTING = range(5)
UNKNOWN, LOW, PRESSED, RIM, UNTOUCHED, FAR = range(6)
"""What a taxel says. UNKNOWN: nothing. LOW: nothing, as it is covered: dead, or lower than touched ones to both sides.
PRESSED: a contact. RIM: touched, perhaps at its rim only. UNTOUCHED: the object is not here. FAR: untouched, but not
beside a patch, where a curved surface is too far from the object to say more."""
