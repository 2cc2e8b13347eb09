"""The fixed-size values of sight, as NumPy structured types. All SI, pixels where said."""

from handsight._kernels.records import POSE, record

# A camera: pixels from rays, pixel centres at whole numbers.
CAMERA = record(
    ("fx", "f8"),
    ("fy", "f8"),
    ("cx", "f8"),
    ("cy", "f8"),
    ("lens", "f8", (8,)),  # k1, k2, p1, p2, k3, k4, k5, k6
    ("reach2", "f8"),  # squared slope of the steepest ray that the lens is known for
)

# A point of a depth image.
DEPTH_POINT = record(
    ("point", "f8", (3,)),  # in the camera
    ("normal", "f8", (3,)),  # towards it; zero: none
    ("part", "i8"),  # of the image's connected parts
)

# Where an object is thought to be in the camera, and what the image says of it; pixels are areas.
CANDIDATE = record(
    ("pose", POSE),
    ("votes", "f8"),
    ("score", "f8"),
    ("bound", "f8"),  # what it explains lies within this [m]
    ("close", "f8"),  # pixels of points that lie on its surface, each by how near
    ("weight", "f8"),  # of the points that say how certain it is
    ("expected", "f8"),  # pixels that the object would fill, not behind the hand
    ("explained", "f8"),
    ("passed", "f8"),  # where the camera sees past it, or the table before it
    ("hidden", "f8"),  # by what is not the hand
    ("unexplained", "f8"),  # of the parts that it lies on
    ("rms", "f8"),  # of the explained ones' distances [m]
)

# A node of a volume that depth images are fused into.
VOXEL = record(
    ("sum", "f4"),  # of weighted distances to the surface, along the rays, positive before it
    ("weight", "f4"),
    ("views", "f4"),  # how many had the surface near by
    ("passed", "f4"),  # how many looked through
)

# Where in a depth image an object that is followed is looked for.
WINDOW = record(
    ("rows", "i8", (2,)),  # the first, and past the last
    ("columns", "i8", (2,)),
    ("step", "i8"),  # between pixels that are looked at, at first
    ("within", "f8"),  # of the surface [m]
    ("plane", "f8", (4,)),  # n·P + offset = 0, n towards the camera
    ("plane_within", "f8"),  # [m]
)
