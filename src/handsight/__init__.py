"""handsight estimates where an object is in a robot's hand, from touch and vision together.

The lines that most users need:

    import handsight as hs

    model = hs.ObjectModel.from_file("mustard.ply")
    contacts = hs.Contacts(points_palm, normals_palm, sigma_point=1e-3, sigma_normal=0.1)
    vision = hs.PosePrior.from_sigmas(T_palm_object, sigma_position=0.03, sigma_rotation=0.25)
    estimate = hs.correct_pose(model, contacts, vision=vision)

And those of a robot that runs:

    tracker = hs.Tracker(hs.Rig.from_file("rig.yaml"), model)
    vision = hs.PoseMeasurement(T_camera_object)
    estimate = tracker.update(hs.Observation(stamp, joint_positions, wrenches, vision, T_world_palm))

Every part of the package is an attribute, such as `hs.vision` or `hs.recording`, and is loaded when it is first
used. `docs/api.md` has a table of all public names.
"""

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:  # "as" marks a name as exported
    # ruff: noqa: I001 - one import a room
    from handsight.camera import Camera as Camera
    from handsight.contact import (
        Contact as Contact,
        Contacts as Contacts,
        Ellipsoid as Ellipsoid,
        NoContact as NoContact,
        Sphere as Sphere,
        calibrate_wrench as calibrate_wrench,
        contact_from_wrench as contact_from_wrench,
        contacts_from_wrenches as contacts_from_wrenches,
    )
    from handsight.correction import (
        Outside as Outside,
        PaperMethod as PaperMethod,
        Plane as Plane,
        PoseEstimate as PoseEstimate,
        PosePrior as PosePrior,
        SkinEvidence as SkinEvidence,
        WeightEvidence as WeightEvidence,
        correct_pose as correct_pose,
        correct_poses as correct_poses,
    )
    from handsight.errors import HandsightError as HandsightError, InvalidInput as InvalidInput
    from handsight.objects import ObjectModel as ObjectModel
    from handsight.observation import Observation as Observation, PoseMeasurement as PoseMeasurement
    from handsight.rig import Rig as Rig
    from handsight.tracking import Tracker as Tracker, TrackerSettings as TrackerSettings
    from handsight.viewer import view as view
    from handsight.vision import locate as locate

# A name is loaded when it is first used, so that the command's help needs no NumPy.
_NAMES = {
    "camera": "Camera",
    "contact": "Contact Contacts Ellipsoid NoContact Sphere calibrate_wrench contact_from_wrench "
    "contacts_from_wrenches",
    "correction": "Outside PaperMethod Plane PoseEstimate PosePrior SkinEvidence WeightEvidence "
    "correct_pose correct_poses",
    "errors": "HandsightError InvalidInput",
    "objects": "ObjectModel",
    "observation": "Observation PoseMeasurement",
    "rig": "Rig",
    "tracking": "Tracker TrackerSettings",
    "viewer": "view",
    "vision": "locate",
}
_ROOM_OF = {name: room for room, names in _NAMES.items() for name in names.split()}
_ROOMS = {
    *_NAMES,
    *("batch", "bridge", "checks", "evaluation", "forces", "hand", "live", "messages", "recording", "se3"),
    *("search", "simulation"),
}
__all__ = sorted([*_ROOM_OF, "__version__"])


def __getattr__(name: str) -> _typing.Any:
    if name in _ROOMS:
        return _importlib.import_module(f"handsight.{name}")
    if name == "__version__":
        value: _typing.Any = _importlib.import_module("importlib.metadata").version("handsight")
    elif name in _ROOM_OF:
        value = getattr(_importlib.import_module(f"handsight.{_ROOM_OF[name]}"), name)
    else:
        raise AttributeError(f"module 'handsight' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_ROOMS})
