"""What cannot be inside the object, checked, as kernels take it: points of the hand."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handsight import checks
from handsight._kernels.records import OUTSIDE
from handsight.contact import Contacts
from handsight.objects import ObjectModel

POINT_SIGMA = (1.5, 1e-3)
"""Of a point of the hand: in sigmas of the contacts' points, and at least this [diameters]. It is as uncertain as the
contacts, through the same kinematics, and the points of one link are wrong together, hence more than that."""
NO_OUTSIDE = np.empty(0, dtype=OUTSIDE)


def outside_records(model: ObjectModel, contacts: Contacts, outside: ArrayLike | None) -> NDArray[Any]:
    """(m,) OUTSIDE of points (m, 3) of the hand; none where the object has no inside."""
    if outside is None or not np.size(outside):
        return NO_OUTSIDE
    points = checks.finite(outside, "outside", (None, 3))
    if not model.closed:
        return NO_OUTSIDE
    variance = np.trace(contacts.covariance[:, :3, :3], axis1=1, axis2=2) / 3
    rows = np.empty(len(points), dtype=OUTSIDE)
    rows["point"] = points
    rows["sigma"] = POINT_SIGMA[0] * max(float(np.median(np.sqrt(variance))), POINT_SIGMA[1] * model.diameter)
    return rows
