"""The former way to give depth points to a correction, as contacts without normals."""

import warnings

from numpy.typing import ArrayLike

from handsight.contact import Contacts
from handsight.correction import DepthPoints, PosePrior
from handsight.objects import ObjectModel


def depth_points(model: ObjectModel, points_palm: ArrayLike, vision: PosePrior) -> Contacts | None:
    """Returns points of a depth image as contacts without normals; None where none is near the surface.

    Deprecated: `DepthPoints.of_image` returns them as evidence of their own, for `correct_pose(depth=)`. Raises
    InvalidInput.
    """
    message = "handsight.vision.depth_points is now handsight.correction.DepthPoints.of_image, for correct_pose(depth=)"
    warnings.warn(f"{message}; the old name goes with the next release", DeprecationWarning, stacklevel=2)
    depth = DepthPoints.of_image(model, points_palm, vision)
    return None if depth is None else Contacts(depth.points_palm, sigma_point=depth.sigma)
