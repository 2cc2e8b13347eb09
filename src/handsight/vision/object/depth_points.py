"""Depth points as evidence of a correction, in place of the vision pose that they gave."""

import numpy as np
from numpy.typing import ArrayLike

from handsight import checks, se3
from handsight.contact import Contacts
from handsight.correction import PosePrior
from handsight.errors import InvalidInput
from handsight.objects import ObjectModel

MAX_POINTS = 48
"""More points add nothing, because they share their errors."""


def depth_points(model: ObjectModel, points_palm: ArrayLike, vision: PosePrior) -> Contacts | None:
    """Returns points of a depth image as contacts without normals, for a correction together with the contacts of
    fingers.

    points_palm: (n, 3) [m], of the object and of its surroundings, NaN where a pixel has none. vision: the pose that
    the image gave, in the palm, with all that makes it uncertain: noise, the camera's constant error, the pose of the
    palm in the camera. The points share these errors; so each gets a sigma with which all together know no direction
    better than that pose does. They replace it: it must not be a prior as well. The answer has at most `MAX_POINTS` of
    the points within 5 % of the diameter of the surface, evenly; None where there is none. Raises InvalidInput.
    """
    points = np.asarray(points_palm)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        came = f"{points.dtype} of {points.shape}"
        raise InvalidInput(f"points_palm: expected floats of shape (n, 3), got {came}")
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    T = vision.T_palm_object
    surface = model.evaluate(se3.apply(se3.inverse(T), checks.position(points, "points_palm", (None, 3))))
    near = np.flatnonzero(np.abs(surface.distance) < 0.05 * model.diameter)
    if not len(near):
        return None
    count = min(len(near), MAX_POINTS)
    near = near[np.arange(count) * len(near) // count]
    normals, arms = surface.gradient[near] @ T[:3, :3].T, points[near] - T[:3, 3]
    scale = np.repeat([1.0, model.radius], 3)
    by_pose = np.hstack([normals, np.cross(arms, normals)]) / scale
    root = np.linalg.cholesky(vision.covariance * np.outer(scale, scale))
    sigma = float(np.linalg.norm(by_pose @ root, 2))  # the largest singular value
    return Contacts(points[near], sigma_point=sigma)
