"""Know where the object is in the robot's hand, by touch and sight.

The five lines most users need:

    import handsight as hs
    model = hs.ObjectModel.from_file("mustard.ply")
    contacts = hs.Contacts(points_palm, normals_palm, sigma_point=1e-3, sigma_normal=0.1)
    vision = hs.PosePrior.from_sigmas(T_palm_object, sigma_position=0.03, sigma_rotation=0.25)
    estimate = hs.correct_pose(model, contacts, vision=vision)

And those whose robot runs:

    tracker = hs.Tracker(hs.Rig.from_file("rig.yaml"), model)
    estimate = tracker.update(hs.Observation(stamp, joint_positions, wrenches, vision, T_world_palm))
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handsight.contact import (
        Contact,
        Contacts,
        Ellipsoid,
        NoContact,
        Sphere,
        calibrate_wrench,
        contact_from_wrench,
        contacts_from_wrenches,
    )
    from handsight.correction import (
        PaperMethod,
        PoseEstimate,
        PosePrior,
        TwoPhase,
        correct_pose,
        correct_poses,
    )
    from handsight.errors import HandsightError
    from handsight.objects import ObjectModel
    from handsight.observation import Observation
    from handsight.rig import Rig
    from handsight.tracking import Tracker
    from handsight.viewer import view

__all__ = [
    "Contact",
    "Contacts",
    "Ellipsoid",
    "HandsightError",
    "NoContact",
    "ObjectModel",
    "Observation",
    "PaperMethod",
    "PoseEstimate",
    "PosePrior",
    "Rig",
    "Sphere",
    "Tracker",
    "TwoPhase",
    "calibrate_wrench",
    "contact_from_wrench",
    "contacts_from_wrenches",
    "correct_pose",
    "correct_poses",
    "view",
]

# A name is loaded when it is first asked for: the command's help needs no NumPy.
_ROOMS = {
    "PaperMethod": "correction",
    "PoseEstimate": "correction",
    "PosePrior": "correction",
    "TwoPhase": "correction",
    "correct_pose": "correction",
    "correct_poses": "correction",
    "HandsightError": "errors",
    "ObjectModel": "objects",
    "Observation": "observation",
    "Rig": "rig",
    "Tracker": "tracking",
    "view": "viewer",
}
_MODULES = (
    "checks",
    "contact",
    "correction",
    "errors",
    "hand",
    "objects",
    "observation",
    "rig",
    "se3",
    "tracking",
    "viewer",
)


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"handsight.{name}")
    if name not in __all__:
        raise AttributeError(f"module 'handsight' has no attribute {name!r}")
    value = getattr(import_module(f"handsight.{_ROOMS.get(name, 'contact')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
