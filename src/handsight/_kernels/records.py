"""The fixed-size values that kernels take, as NumPy structured types. All SI.

A kernel reads their fields by name (`model.radius`, `contact.normal`); Python fills them in once, at the public door. A
kernel's own workspace is a record of `simd.local`, which lives until the kernel returns.
"""

import numpy as np

SAMPLES = 256
"""Surface samples of an object that phase 1 matches contacts with."""
MOST_DEPTH_POINTS = 48
"""Depth points of one correction: more tell no more of a pose, for their errors are common to many."""
MOST_ROTATIONS = 121
"""Elements of the largest discrete symmetry group that kernels know."""


def record(*fields: tuple[object, ...]) -> np.dtype[np.void]:
    """Returns a structured type, aligned as compiled code has it."""
    return np.dtype(list(fields), align=True)


POSE = record(("rotation", "f8", (3, 3)), ("position", "f8", (3,)))

# Kinds of field. An exact one has its half sizes (box), radius and half height (cylinder) or radius (sphere) in
# `origin`, and no nodes. A sheet is a grid around a surface that has no inside: its signs are sides.
GRID, BOX, CYLINDER, SPHERE, SHEET = 0, 1, 2, 3, 4
FIELD = record(
    ("kind", "i8"),
    ("origin", "f8", (3,)),
    ("cell", "f8"),
    ("inverse_cell", "f8"),
    ("shape", "i8", (3,)),
    ("nodes", "i8"),  # where they begin among the object's
    ("blur", "f8"),  # by how much a sheet's distances may add up to too much
    ("least_radius", "f8"),  # of curvature, of an exact field
    ("variance_distance", "f8"),  # how far it is off the surface: a coarse field on faces
    ("variance_normal", "f8"),
)

# What of the symmetries kernels know: none, finitely many, an axis through the origin (and finitely many).
NO_SYMMETRY, DISCRETE, AXIS, OTHER_SYMMETRY = 0, 1, 2, 3
SYMMETRY = record(
    ("kind", "i8"),
    ("axes", "i8"),  # how many continuous axes
    ("pivot", "f8", (3,)),  # a point that all of them go through
    ("axis", "f8", (3, 3)),  # their directions
    ("rotations", "i8"),  # how many elements the discrete group has
    ("rotation", "f8", (MOST_ROTATIONS, 3, 4)),
)

# How far the fine field is off the surface, place by place: four variances at each node of a grid.
FIELD_ERROR = record(
    ("least_distance", "f8"),
    ("least_normal", "f8"),
    ("inverse_cell", "f8"),  # 0: the same everywhere
    ("origin", "f8", (3,)),
    ("shape", "i8", (3,)),
    ("nodes", "i8"),
)

# One object. Its grids' nodes are an array of their own, float32.
MODEL = record(
    ("coarse", FIELD),
    ("fine", FIELD),
    ("radius", "f8"),
    ("center", "f8", (3,)),
    ("bounds", "f8", (2, 3)),  # of a box around all of it
    ("edge_curvature2", "f8"),  # squared curvature from which on the surface counts as an edge
    ("error", FIELD_ERROR),
    ("symmetry", SYMMETRY),
    ("normal_weight2", "f8"),  # of the length that a unit of normal counts as in phase 1 [m²]
    ("band", "f8"),  # tangential distance to a sample that costs nothing [m]
    ("tangential_weight", "f8"),  # of what is beyond it, squared [1/m²]
    ("sample_variance_distance", "f8"),  # of a sample's plane [m²] and of its normal, per axis [rad²]
    ("sample_variance_normal", "f8"),
    ("samples", "f8", (SAMPLES, 2, 3)),  # point, normal
    ("scan", "f4", (7, SAMPLES)),  # squared length, point, normal
)

CONTACT = record(
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("has_normal", "i8"),
    ("used", "i8"),  # whether it counts
    ("of_residual", "i8"),  # whether the covariance is of its residuals, errors of model and surface included
    ("covariance", "f8", (6, 6)),  # of (point, normal)
    ("gain", "f8"),  # written: by how much χ² falls, to first order, when it is left out
)
# Where the object's centre of mass is in the palm, as the loads on the fingertips show.
OBJECT_WEIGHT = record(
    ("known", "i8"),
    ("center_object", "f8", (3,)),
    ("center_palm", "f8", (3,)),
    ("information", "f8", (3, 3)),  # of the two together
)
# Points of one depth image, whose errors are shared: each has the variance with which all of them together know no
# more of the pose than that image does.
DEPTH_POINTS = record(("count", "i8"), ("variance", "f8"), ("points", "f8", (MOST_DEPTH_POINTS, 3)))
# A pose and its covariance before touch: vision's, or the last estimate.
PRIOR = record(("pose", POSE), ("covariance", "f8", (6, 6)))
# The evidence of which a correction has at most one of each kind; each says itself whether it is there.
CONSTRAINTS = record(
    ("prior", PRIOR), ("has_prior", "i8"), ("weight", OBJECT_WEIGHT), ("depth", DEPTH_POINTS)
)
# What cannot be inside the object: a point of the hand, those of one link in a row; or a plane and all behind it,
# `point` any of its points.
OUTSIDE = record(
    ("point", "f8", (3,)),
    ("sigma", "f8"),
    ("is_plane", "i8"),
    ("normal", "f8", (3,)),
    ("link", "i8"),  # whose points are wrong together
    ("slack", "f8"),  # how deep inside it may be [m]: the link is that much smaller than its shape
    ("clearance", "f8"),  # from the object, where it was last measured [m]
    ("far", "i8"),  # certainly outside
)

# A contact with what a correction computes from it.
TERM = record(
    ("contact", CONTACT),
    ("variance_point", "f8"),  # mean, per axis
    ("variance_normal", "f8"),  # mean, per tangent axis
    ("isotropic", "i8"),  # the point's covariance is a multiple of 1, and none is shared with the normal
    ("weight", "f8", (4, 4)),  # inverse covariance of (distance, normal)
    ("log_spread", "f8"),  # log det of that covariance
    ("equations", "f8", (7, 8)),  # its own, by (δp, δθ)
)

# A prior as evidence about an object so symmetric: vision's, or the weak one on the position that blind answers take.
NO_PRIOR, VISION_PRIOR, WEAK_PRIOR = 0, 1, 2
PRIOR_TERM = record(
    ("kind", "i8"),
    ("has_axis", "i8"),
    ("pivot_object", "f8", (3,)),
    ("axis_object", "f8", (3,)),
    ("pivot_palm", "f8", (3,)),
    ("rotation", "f8", (3, 3)),
    ("information", "f8", (6, 6)),
)

# One descent among many: where it is, and how it ended.
DESCENT = record(
    ("pose", POSE),
    ("set", "i8"),  # of contacts that count for it
    ("cost", "f8"),  # squared residuals
    ("iterations", "i8"),
    ("converged", "i8"),
    ("log_weight", "f8"),  # of the mode: log of exp(-cost/2) √det Σ
    ("posterior_cost", "f8"),  # minus two log of the density, up to a constant
    ("gain", "f8"),  # the most that χ² falls, to first order, when one contact is left out
)

ANSWER = record(
    ("pose", POSE),
    ("T_palm_object", "f8", (4, 4)),
    ("information", "f8", (6, 6)),
    ("covariance", "f8", (6, 6)),
    ("first_order", "i8"),  # whether these are as the Jacobian says, at a pose that is no minimum
    ("complete", "i8"),  # whether there is a covariance
    ("unobservable", "f8", (6, 6)),
    ("open_count", "i8"),  # how many of these rows count
    ("coarse_cost", "f8"),  # squared residuals on the coarse field, where phase 1 and two steps had led
    ("cost", "f8"),  # squared residuals at the end of the descent
    ("iterations", "i8"),
    ("converged", "i8"),
    ("chi2", "f8"),
    ("posterior_cost", "f8"),
    ("weight", "f8"),  # of the mode among those reported
    ("log_weight", "f8"),  # the same before it is one of several
    ("departure", "f8"),  # from a Gaussian: how much more its cost rises beside it, as a ratio
    ("gain", "f8"),  # the most that χ² falls when one contact is left out
    ("width", "f8"),  # how far the prior lets a point of the surface be [diameters]
    ("rows", "i8"),  # of contact evidence
)

# One problem of a batch and its answer: its constraints, the contacts (from `first` on, before `last`), if `follows` a
# pose near by that was right, and whether the answer's pose is all that is asked for.
PROBLEM = record(
    ("constraints", CONSTRAINTS),
    ("first", "i8"),
    ("last", "i8"),
    ("pose_only", "i8"),
    ("follows", "i8"),
    ("start", POSE),
    ("answer", ANSWER),
)

# Room for the nodes that a spline reads, z fastest.
NODES = record(("values", "f4", (64,)))

# Room for a descent: normal equations, and what is solved with them.
WORKSPACE = record(
    ("now", "f8", (7, 8)), ("next", "f8", (7, 8)), ("factor", "f8", (6, 6)), ("step", "f8", (6,))
)

# Room for the computation of a pose's uncertainty.
UNCERTAINTY = record(
    ("by_touch", "f8", (6, 6)),
    ("equations", "f8", (7, 8)),
    ("matrix", "f8", (6, 6)),
    ("wider", "f8", (6, 6)),
    ("factor", "f8", (6, 6)),
    ("values", "f8", (6,)),
    ("vectors", "f8", (6, 6)),
    ("row", "f8", (6,)),
    ("column", "f8", (6,)),
    ("arc", "f8", (3, 3)),
)

# The directions along which a mode is integrated: columns of (s, radius θ), straight along the object.
FLAT_DIRECTIONS = record(
    ("count", "i8"),  # of directions along, of those across
    ("count_across", "i8"),
    ("along", "f8", (6, 3)),
    ("spacing", "f8", (3,)),  # of the lattice points [m]
    ("lattice", "f8", (6, 3)),  # from a point to the next
    ("across", "f8", (6, 6)),
    ("stretch", "f8", (6,)),  # how much wider these are than the slope at the mode says
    ("proper", "i8"),  # whether all is known: blind, a direction may not be
    ("bump_margin", "f8"),  # how far the dents of a scan may lower the cost of contacts and walls
    ("level", "f8"),  # the cost up to which points therefore count the same
)
# Sums over lattice points: of weights, relative to the largest, times deviations (δp, δθ) and their squares.
SUMS = record(
    ("best", "f8"),  # largest log weight yet
    ("total", "f8"),
    ("first", "f8", (6,)),
    ("second", "f8", (6, 6)),
    ("within", "f8", (6, 6)),
)
# One of them: where on the lattice, and the coordinates across.
LATTICE_POINT = record(("index", "i8", (3,)), ("lateral", "f8", (6,)))

# A joint on the way from a base to a body: its axis and a point on it, in the base, when all joints are at their zero.
CHAIN_JOINT = record(
    ("axis", "f8", (3,)),
    ("point", "f8", (3,)),
    ("zero", "f8"),  # its position there
    ("slides", "i8"),
    ("value", "i8"),  # where among the positions its own is
)

# A pose from vision, or several merged: its own noise, along the axes of the mount (what the camera is fixed to), and
# the variance of the object's random walk in the palm from the prior to it.
MEASUREMENT = record(
    ("T_mount_palm", "f8", (4, 4)),
    ("T_mount_object", "f8", (4, 4)),
    ("covariance", "f8", (6, 6)),
    ("process_noise", "f8", (6,)),
)
