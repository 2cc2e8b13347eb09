"""The fixed-size values of sight, as NumPy structured types. All SI, pixels where said."""

import numpy as np


def _record(*fields: tuple[object, ...]) -> np.dtype[np.void]:
    return np.dtype(list(fields), align=True)


# A camera: pixels from rays, pixel centres at whole numbers.
CAMERA = _record(
    ("fx", "f8"),
    ("fy", "f8"),
    ("cx", "f8"),
    ("cy", "f8"),
    ("lens", "f8", (8,)),  # k1, k2, p1, p2, k3, k4, k5, k6
    ("reach2", "f8"),  # squared slope of the steepest ray that the lens is known for
)

# A point of a depth image.
SEEN = _record(
    ("point", "f8", (3,)),  # in the camera
    ("normal", "f8", (3,)),  # towards it; zero: none
    ("part", "i8"),  # of the image's connected parts
)

# Where an object is thought to be in the camera, and what the image says of it; pixels are areas.
LOOK = _record(
    ("rotation", "f8", (3, 3)),
    ("position", "f8", (3,)),
    ("votes", "f8"),
    ("score", "f8"),
    ("expected", "f8"),  # pixels that the object would fill, not behind the hand
    ("explained", "f8"),
    ("passed", "f8"),  # where the camera sees past it
    ("hidden", "f8"),  # by what is not the hand
    ("unexplained", "f8"),  # of the parts that it lies on
    ("rms", "f8"),  # of the explained ones' distances [m]
)
