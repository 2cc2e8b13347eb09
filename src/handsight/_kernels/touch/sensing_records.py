"""What contact sensing's kernels take and give, as records; without numba, for those who make them."""

import numpy as np

FINGERTIP = np.dtype(
    [
        ("semi_axes", "f8", (3,)),
        ("cap", "f8"),  # least z that is sensed [m], or -inf
        ("max_friction", "f8"),  # or inf
        ("min_force", "f8"),  # [N]
        ("R_surface_sensor", "f8", (3, 3)),
        ("origin_surface", "f8", (3,)),  # the sensor's [m]
    ]
)
TIP_CONTACT = np.dtype(
    [
        ("point", "f8", (3,)),
        ("normal", "f8", (3,)),
        ("force", "f8", (3,)),
        ("force_normal", "f8"),
        ("torque", "f8"),  # local, about the normal
    ]
)
"""A contact in its tip's frame; SI."""
FINGER = np.dtype(
    [
        ("tip", FINGERTIP),
        ("R_tip_surface", "f8", (3, 3)),
        ("center_tip", "f8", (3,)),  # the surface's, in the frame of the body that it moves with [m]
        ("sign", "f8"),  # 1 where readings are of the tip on the sensor, -1 where of the sensor on the tip
        ("bias", "f8", (6,)),  # [N], [N m]
        ("mass", "f8"),
        ("center_of_mass", "f8", (3,)),  # in the sensor's frame [m]
        ("sigmas", "f8", (6,)),  # of a reading
        ("variance_point", "f8"),  # per axis, what sensor and joints do not explain [m²]
        ("variance_normal", "f8"),  # [rad²]
    ]
)
PALM_CONTACT = np.dtype(
    [
        ("reason", "i8"),
        ("gap", "f8"),  # distance to the nearest other tip [m]
        ("point", "f8", (3,)),
        ("normal", "f8", (3,)),
        ("covariance", "f8", (6, 6)),  # of (point, normal)
        ("load", "f8", (5,)),  # tangential force (3,), normal force [N], torque about the normal [N m]
    ]
)
"""What a finger feels, in the palm; only `reason` and `gap` where that is no contact."""
