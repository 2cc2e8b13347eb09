"""Know where the object is in the robot's hand, by touch and sight.

The five lines most users need:

    import handsight as hs
    model = hs.ObjectModel.from_file("mustard.ply")
    contacts = hs.Contacts(points_palm, normals_palm, sigma_point=1e-3, sigma_normal=0.1)
    vision = hs.PosePrior.from_sigmas(T_palm_object, sigma_position=0.03, sigma_rotation=0.25)
    estimate = hs.correct_pose(model, contacts, vision=vision)
"""

from handsight.contact import (
    Contact,
    Contacts,
    Ellipsoid,
    NoContact,
    Sphere,
    calibrate_wrench,
    compensate,
    contact_from_wrench,
    contacts_from_wrenches,
)
from handsight.correction import PaperMethod, PoseEstimate, PosePrior, TwoPhase, correct_pose
from handsight.errors import HandsightError
from handsight.objects import ObjectModel

__all__ = [
    "Contact",
    "Contacts",
    "Ellipsoid",
    "HandsightError",
    "NoContact",
    "ObjectModel",
    "PaperMethod",
    "PoseEstimate",
    "PosePrior",
    "Sphere",
    "TwoPhase",
    "calibrate_wrench",
    "compensate",
    "contact_from_wrench",
    "contacts_from_wrenches",
    "correct_pose",
]
