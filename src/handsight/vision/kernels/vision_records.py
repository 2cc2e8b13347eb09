"""The fixed-size values that the kernels of vision take, as NumPy structured types. SI, pixels where stated."""

from handsight._compiled.records import POSE, record

TABLE, HAND, OUT = -3, -2, -1
"""Labels of pixels of the table, of the hand, and of no segment that may be the object; segments have numbers from
0."""

# A point of a depth image.
DEPTH_POINT = record(
    ("point", "f8", (3,)),  # in the camera
    ("normal", "f8", (3,)),  # towards the camera; zero: none
    ("part", "i8"),  # number of its segment
)

# A pose of an object or a hand in the camera, and how well the image supports it; areas are in pixels.
CANDIDATE = record(
    ("pose", POSE),
    ("votes", "f8"),
    ("score", "f8"),
    ("bound", "f8"),  # depth within this of the surface is explained [m]
    ("weight", "f8"),  # sum of the robust weights of the points that its covariance is of
    ("expected", "f8"),  # that the object would fill, without those hidden by the hand
    ("explained", "f8"),
    ("passed", "f8"),  # where the camera sees past it, or the table in front of it
    ("hidden", "f8"),  # by something that is not the hand
    ("unexplained", "f8"),  # where its surface goes on beside it; of a hand: with another normal
    ("smooth", "f8"),  # share of its outline across which the observed surface is smooth
    ("rms", "f8"),  # of the distances of the explained pixels [m]
)

# One of several passes, from coarse to fine, that move a pose to where points lie on a surface; the unit of its bounds
# is given beside it.
STAGE = record(
    ("fine", "i8"),  # whether on the fine field
    ("first_bound", "f8"),  # Tukey's bound of the first step
    ("last_bound", "f8"),  # and of the last, with those of other steps evenly between
    ("steps", "i8"),
    ("stride", "i8"),  # every stride-th point takes part
)

# The errors of depth points, as variances [m²], and the correlation of those that neighbours share; then what the
# covariance of a pose takes beside its points.
DEPTH_ERROR = record(
    ("own", "f8"),  # of each pixel by itself
    ("shared", "f8"),  # in common with its neighbours
    ("smooth", "f8"),  # of a bias that changes over the image
    ("offset", "f8"),  # of a bias of the whole image
    ("shared_decay", "f8"),  # one over the squared correlation length of `shared` [slopes]
    ("smooth_decay", "f8"),  # and of `smooth`
    ("pose", "f8"),  # variance of a pose that no number of points lowers, by (δp, radius δθ) [m²]
    ("normal", "f8"),  # information on turns that the model's normals feign, for each point [rad²]
    ("known_shift", "f8"),  # information that is there without any point, on a shift [1/m²]
    ("known_turn", "f8"),  # and on radius times a turn [1/m²]
)

# A node of a volume that depth images are fused into.
VOXEL = record(
    ("sum", "f4"),  # of weighted distances to the surface, along the rays, positive before it
    ("weight", "f4"),
    ("views", "f4"),  # number of images that had the surface near by
    ("passed", "f4"),  # number of images whose rays went on behind it
)

# The part of a depth image in which an object that is followed is searched.
WINDOW = record(
    ("rows", "i8", (2,)),  # the first, and past the last
    ("columns", "i8", (2,)),
    ("step", "i8"),  # from pixel to pixel, at first
    ("within", "f8"),  # of the surface [m]
    ("plane", "f8", (4,)),  # n·P + offset = 0, n towards the camera
    ("plane_within", "f8"),  # [m]
)
