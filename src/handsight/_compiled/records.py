"""The fixed-size values that kernels take, as NumPy structured types; all in SI units.

Kernels read their fields by name (`model.radius`, `contact.normal`). Python fills them once, where users' values are
checked. A kernel makes the records of its own intermediate values by `stack.local`; they live until it returns.
"""

import numpy as np

SAMPLES = 256
"""Surface samples of an object, with which phase 1 matches contacts."""
MOST_ROTATIONS = 121
"""Elements of the largest discrete symmetry group that kernels handle."""


def record(*fields: tuple[object, ...]) -> np.dtype[np.void]:
    """Returns a structured type, aligned as compiled code aligns it."""
    return np.dtype(list(fields), align=True)


POSE = record(("rotation", "f8", (3, 3)), ("position", "f8", (3,)))

# Kinds of distance field. An exact one has half sizes (box), radius and half height (cylinder) or radius (sphere) in
# `origin`, and no nodes. A sheet is a grid around a surface that has no inside; its signs tell the surface's two sides.
GRID = 0
BOX = 1
CYLINDER = 2
SPHERE = 3
SHEET = 4
FIELD = record(
    ("kind", "i8"),
    ("origin", "f8", (3,)),
    ("cell", "f8"),
    ("inverse_cell", "f8"),
    ("shape", "i8", (3,)),
    ("nodes", "i8"),  # index of its first node among those of the object
    ("blur", "f8"),  # by how much the distances of two nodes of a sheet may be too large together [m]
    ("least_radius", "f8"),  # of curvature, of an exact field [m]
    ("variance_distance", "f8"),  # of the field's error on the surface, of a coarse one on faces [m²]
    ("variance_normal", "f8"),  # [rad²]
)

# Kinds of symmetry: none, finitely many rotations, an axis through the origin (and finitely many); others are left to
# Python.
NO_SYMMETRY = 0
DISCRETE = 1
AXIS = 2
OTHER_SYMMETRY = 3
SYMMETRY = record(
    ("kind", "i8"),
    ("axes", "i8"),  # number of continuous axes
    ("pivot", "f8", (3,)),  # a point on all of them
    ("axis", "f8", (3, 3)),  # their directions
    ("rotations", "i8"),  # number of elements of the discrete group
    ("rotation", "f8", (MOST_ROTATIONS, 3, 4)),
)

# Error of the fine field, place by place: four variances at each node of a grid.
FIELD_ERROR = record(
    ("least_distance", "f8"),
    ("least_normal", "f8"),
    ("inverse_cell", "f8"),  # 0: the error is the same everywhere
    ("origin", "f8", (3,)),
    ("shape", "i8", (3,)),
    ("nodes", "i8"),
)

# One object. The nodes of its grids are in an array of their own, float32.
MODEL = record(
    ("coarse", FIELD),
    ("fine", FIELD),
    ("radius", "f8"),
    ("center", "f8", (3,)),
    ("bounds", "f8", (2, 3)),  # least and greatest coordinates
    ("edge_curvature2", "f8"),  # squared curvature above which the surface counts as an edge
    ("error", FIELD_ERROR),
    ("symmetry", SYMMETRY),
    # In phase 1, the weight of the squared difference of normals against the squared distance [m²].
    ("normal_weight2", "f8"),
    ("band", "f8"),  # tangential distance to a sample that costs nothing [m]
    ("tangential_weight", "f8"),  # of the squared distance beyond it [1/m²]
    ("sample_variance_distance", "f8"),  # of a sample's plane [m²] and of its normal, per axis [rad²]
    ("sample_variance_normal", "f8"),
    ("samples", "f8", (SAMPLES, 2, 3)),  # point, normal
    ("scan", "f4", (7, SAMPLES)),  # squared length, point, normal
)

CONTACT = record(
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("has_normal", "i8"),
    ("used", "i8"),  # whether it is evidence; 0 for an outlier
    ("covariance", "f8", (6, 6)),  # of (point, normal)
    ("gain", "f8"),  # written by kernels: by how much χ² falls, to first order, when it is left out
)
# Where the loads on the fingertips say that the object's centre of mass is in the palm.
OBJECT_WEIGHT = record(
    ("known", "i8"),
    ("center_object", "f8", (3,)),
    ("center_palm", "f8", (3,)),
    ("information", "f8", (3, 3)),  # of the difference of the two, in the palm [1/m²]
)
# A pose and its covariance before touch is taken into account: vision's, or the last estimate.
PRIOR = record(("pose", POSE), ("covariance", "f8", (6, 6)))
# Evidence of which a correction has at most one of each kind; `has_prior` and `weight.known` tell which.
CONSTRAINTS = record(("prior", PRIOR), ("has_prior", "i8"), ("weight", OBJECT_WEIGHT))
# What cannot be inside the object: a point of the hand, the points of one link following each other; or a plane, given
# by any of its points, and all behind it.
OUTSIDE = record(
    ("point", "f8", (3,)),
    ("sigma", "f8"),
    ("is_plane", "i8"),
    ("normal", "f8", (3,)),
    ("link", "i8"),  # number of its link, whose points share one error
    ("slack", "f8"),  # how deep inside it may be [m], as the link may be that much smaller than its shape
    ("clearance", "f8"),  # from the object, when it was last computed [m]
)
# At which pose of the object, and on which field, the clearances of points outside were measured.
MEASURED = record(
    ("pose", POSE),
    ("nodes", "i8"),
    ("points", "i8"),  # number of points, which come before planes
    ("least", "f8"),  # the smallest clearance [m]
    ("move", "f8"),  # how far the object has moved since, at most [m]
)

# What a correction computes from a contact.
TERM = record(
    ("contact", CONTACT),
    ("variance_point", "f8"),  # mean, per axis
    ("variance_normal", "f8"),  # mean, per tangent axis
    ("isotropic", "i8"),  # whether the point's covariance is isotropic and not correlated with the normal
    ("crowd", "f8"),  # number of contacts near it on the surface, which share the model's error
    ("variance_distance", "f8"),  # of the distance alone, as of the last whitening
    ("weight", "f8", (4, 4)),  # inverse covariance of (distance, normal)
    ("log_spread", "f8"),  # log det of that covariance
    ("equations", "f8", (7, 8)),  # the contact's normal equations by (δp, δθ)
)

# Contacts that share the error of the link that they are on: a shift and a turn of all of them, by which they are
# moved to where they are taken to be.
GROUP = record(
    ("pose", POSE),
    ("error", "f8", (6,)),  # the sum of the steps (τ, radius ω) that led to that pose
    ("information", "f8", (6, 6)),  # of the error
    (
        "softness",
        "f8",
    ),  # the factor on the covariances of the error and of its contacts, from which a descent starts
    ("square", "f8"),  # the error's squared length [σ²]
    ("weight", "f8"),  # the probability that the error is as declared, and not any
    ("equations", "f8", (7, 8)),  # of the group's contacts
    ("spurious", "f8", (7, 8)),
    ("factor", "f8", (6, 6)),  # of the information about the group's own pose
)

# The prior of an object with its symmetries: vision's, or the weak one on the position where there is no vision.
NO_PRIOR = 0
VISION_PRIOR = 1
WEAK_PRIOR = 2
PRIOR_TERM = record(
    ("kind", "i8"),
    ("has_axis", "i8"),
    ("pivot_object", "f8", (3,)),
    ("axis_object", "f8", (3,)),
    ("pivot_palm", "f8", (3,)),
    ("rotation", "f8", (3, 3)),
    ("information", "f8", (6, 6)),
)

_ENDED = (
    ("pose", POSE),
    ("set", "i8"),  # number of the set of contacts that it uses
    ("cost", "f8"),  # sum of squared residuals
    ("iterations", "i8"),
    ("converged", "i8"),
    ("log_weight", "f8"),  # of the mode: log of exp(-cost/2) √det Σ
    ("posterior_cost", "f8"),  # minus two log of the density, up to a constant
    ("gain", "f8"),  # by how much χ² falls at most, to first order, when one contact is left out
    ("walls", "i8"),  # number of links and planes that the object is within, each a row of evidence
)
# One descent among many: its pose, and how it ended.
DESCENT = record(*_ENDED)

# What is known of the minimum that one start led to: a better one is likely to exist, none is, or it takes more tests.
DOUBTED = 0
ENOUGH = 1
UNDECIDED = 2
# A pose with its uncertainty; its first fields are those of the descent that led to it.
ANSWER = record(
    *_ENDED,
    ("T_palm_object", "f8", (4, 4)),
    ("information", "f8", (6, 6)),
    ("covariance", "f8", (6, 6)),
    ("first_order", "i8"),  # whether these are from the Jacobian alone, at a pose that is no minimum
    ("mean", "i8"),  # whether it becomes the mode's mean where that is not Gaussian
    ("complete", "i8"),  # whether there is a covariance
    ("unobservable", "f8", (6, 6)),
    ("open_count", "i8"),  # number of unobservable directions: the first rows of these
    ("coarse_cost", "f8"),  # squared residuals on the coarse field, after phase 1 and two steps
    ("chi2", "f8"),
    ("weight", "f8"),  # of the mode among those reported
    ("departure", "f8"),  # from a Gaussian: how much more the cost rises beside the mode, as a ratio
    ("prior_gain", "f8"),  # by how much it falls when the prior is left out
    ("outside_gain", "f8"),  # by how much it falls when all outside evidence is left out
    ("width", "f8"),  # how uncertain the prior leaves a point of the surface [diameters]
    ("rows", "i8"),  # number of rows of contact evidence
    ("verdict", "i8"),  # on the descent of one start
)

# How one problem is solved, and its answer: if it `follows`, from the pose `start` that was right a moment ago.
PROBLEM = record(
    ("pose_only", "i8"),  # whether nothing but the pose is computed, for measuring
    ("follows", "i8"),
    ("start", POSE),
    ("answer", ANSWER),
)

# Memory for the nodes that a spline reads, z fastest.
NODES = record(("values", "f4", (64,)))

# Memory of a descent: normal equations, and their solution.
WORKSPACE = record(
    ("now", "f8", (7, 8)), ("next", "f8", (7, 8)), ("factor", "f8", (6, 6)), ("step", "f8", (6,))
)

# Memory for computing a pose's uncertainty.
UNCERTAINTY = record(
    ("by_touch", "f8", (6, 6)),
    ("equations", "f8", (7, 8)),
    ("prior", "f8", (7, 8)),
    ("walls", "f8", (7, 8)),
    ("matrix", "f8", (6, 6)),
    ("wider", "f8", (6, 6)),
    ("factor", "f8", (6, 6)),
    ("values", "f8", (6,)),
    ("vectors", "f8", (6, 6)),
    ("row", "f8", (6,)),
    ("column", "f8", (6,)),
    ("arc", "f8", (3, 3)),
)

# The directions along which a mode is integrated: columns of (shift, radius x rotation) along the object's axes.
FLAT_DIRECTIONS = record(
    ("count", "i8"),  # number of flat directions, and of those across them
    ("count_across", "i8"),
    ("vectors", "f8", (6, 6)),  # eigenvectors of the information at the mode, along the palm's axes
    ("slopes", "f8", (6,)),  # eigenvalues [1/m²]; infinite for spins about declared axes
    ("calibrated", "f8", (6,)),  # the same as the cost shows them
    (
        "rises",
        "f8",
        (6,),
    ),  # ratio of the cost's rise to a Gaussian's; negative where it is not integrated along
    ("along", "f8", (6, 3)),
    ("points_per_sigma", "f8"),  # of the lattice
    ("spacing", "f8", (3,)),  # the same [m]
    ("lattice", "f8", (6, 3)),  # steps from a lattice point to the next ones
    ("across", "f8", (6, 6)),
    ("stretch", "f8", (6,)),  # how much wider the mode is across than the curvature at it says
    ("proper", "i8"),  # whether the prior bounds every direction; without vision it may not
    ("bump_margin", "f8"),  # by how much bumps of a scanned model may lower the cost of contacts and walls
    ("level", "f8"),  # the cost below which lattice points therefore count as equal
    ("most_cost", "f8"),  # above which a point is given up
)
# Sums over points: of weights, relative to the largest, times deviations (δp, δθ) and their products.
SUMS = record(
    ("best", "f8"),  # logarithm of the largest density
    ("total", "f8"),
    ("first", "f8", (6,)),
    ("second", "f8", (6, 6)),
    ("within", "f8", (6, 6)),
)
# A point of a lattice, or of a line: its indices on the lattice, or its place on the line [m], and coordinates across.
LATTICE_POINT = record(
    ("index", "f8", (3,)),
    ("lateral", "f8", (6,)),
    ("cost", "f8"),
    ("log_weight", "f8"),  # of the density there
    ("bend", "f8"),  # half its second derivative along the line
    ("share", "f8"),  # of the integral, relative to the largest density
    ("moved", "f8", (6,)),  # from the mode, by (δp, δθ), and the covariance across the flat directions
    ("within", "f8", (6, 6)),
)

# A joint of the chain from a base to a body: its axis and a point on it, in the base, with all joints at their zero.
CHAIN_JOINT = record(
    ("axis", "f8", (3,)),
    ("point", "f8", (3,)),
    ("zero", "f8"),  # its position then
    ("slides", "i8"),  # whether it is prismatic
    ("value", "i8"),  # index of its position among those of all joints
)

# The intrinsics of a camera: pixels of rays, pixel centres at whole numbers.
CAMERA = record(
    ("fx", "f8"),
    ("fy", "f8"),
    ("cx", "f8"),
    ("cy", "f8"),
    ("lens", "f8", (8,)),  # k1, k2, p1, p2, k3, k4, k5, k6
    ("reach2", "f8"),  # squared slope of the steepest ray that the lens is known for
)
