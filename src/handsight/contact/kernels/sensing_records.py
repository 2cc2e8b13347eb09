"""The records of contact sensing's kernels, in a module of their own, as importing numba takes half a second."""

import numpy as np

FINGERTIP = np.dtype([
    ("semi_axes", "f8", (3,)),
    ("cap", "f8"),  # least z of a sensed point [m], or -inf
    ("max_friction", "f8"),  # or inf
    ("min_force", "f8"),  # [N]
    ("R_surface_sensor", "f8", (3, 3)),
    ("origin_surface", "f8", (3,)),  # the sensor's [m]
])  # fmt: skip
TIP_CONTACT = np.dtype([
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("force", "f8", (3,)),
    ("force_normal", "f8"),
    ("torque", "f8"),  # local, about the normal
])  # fmt: skip
"""A contact in its tip's frame; SI."""
FINGER = np.dtype([
    ("tip", FINGERTIP),
    ("R_tip_surface", "f8", (3, 3)),
    ("center_tip", "f8", (3,)),  # the surface's centre in the frame of the body to which it is fixed [m]
    ("sign", "f8"),  # 1 where readings are of the tip on the sensor, -1 where of the sensor on the tip
    ("bias", "f8", (6,)),  # [N], [N m]
    ("mass", "f8"),
    ("center_of_mass", "f8", (3,)),  # in the sensor's frame [m]
    ("sigmas", "f8", (6,)),  # of a reading [N], [N m]
    ("sigma_gain", "f8"),  # relative error of a reading, of each axis by itself
    ("variance_point", "f8"),  # per axis, of errors beside those of sensor and joints [m²]
    ("variance_normal", "f8"),  # [rad²]
])  # fmt: skip
PALM_CONTACT = np.dtype([
    ("reason", "i8"),
    ("gap", "f8"),  # distance to the nearest other tip [m]
    ("point", "f8", (3,)),
    ("normal", "f8", (3,)),
    ("covariance", "f8", (6, 6)),  # of (point, normal)
    ("load", "f8", (5,)),  # tangential force (3,), normal force [N], torque about the normal [N m]
])  # fmt: skip
"""A finger's contact in the palm; only `reason` and `gap` are set where there is none."""
