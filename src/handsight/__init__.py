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

Every part of the package is an attribute, such as `hs.vision` or `hs.recording`, and is loaded when it is first asked
for. `docs/api.md` has a table of all public names.
"""

import importlib as _importlib
import typing as _typing

if _typing.TYPE_CHECKING:
    from handsight.camera import Camera
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
        DepthPoints,
        Outside,
        PaperMethod,
        Plane,
        PoseEstimate,
        PosePrior,
        SkinEvidence,
        TwoPhase,
        WeightEvidence,
        correct_pose,
        correct_poses,
    )
    from handsight.errors import HandsightError, InvalidInput
    from handsight.objects import ObjectModel
    from handsight.observation import Observation, PoseMeasurement
    from handsight.rig import Rig
    from handsight.tracking import Tracker, TrackerSettings
    from handsight.viewer import view
    from handsight.vision import locate

__all__ = [
    "Camera",
    "Contact",
    "Contacts",
    "DepthPoints",
    "Ellipsoid",
    "HandsightError",
    "InvalidInput",
    "NoContact",
    "ObjectModel",
    "Observation",
    "Outside",
    "PaperMethod",
    "Plane",
    "PoseEstimate",
    "PoseMeasurement",
    "PosePrior",
    "Rig",
    "SkinEvidence",
    "Sphere",
    "Tracker",
    "TrackerSettings",
    "TwoPhase",
    "WeightEvidence",
    "__version__",
    "calibrate_wrench",
    "contact_from_wrench",
    "contacts_from_wrenches",
    "correct_pose",
    "correct_poses",
    "locate",
    "view",
]

_NAMES = {
    "camera": ("Camera",),
    "contact": (
        "Contact",
        "Contacts",
        "Ellipsoid",
        "NoContact",
        "Sphere",
        "calibrate_wrench",
        "contact_from_wrench",
        "contacts_from_wrenches",
    ),
    "correction": (
        "DepthPoints",
        "Outside",
        "PaperMethod",
        "Plane",
        "PoseEstimate",
        "PosePrior",
        "SkinEvidence",
        "TwoPhase",
        "WeightEvidence",
        "correct_pose",
        "correct_poses",
    ),
    "errors": ("HandsightError", "InvalidInput"),
    "objects": ("ObjectModel",),
    "observation": ("Observation", "PoseMeasurement"),
    "rig": ("Rig",),
    "tracking": ("Tracker", "TrackerSettings"),
    "viewer": ("view",),
    "vision": ("locate",),
}
# A name is loaded when it is first asked for: the command's help needs no NumPy.
_ROOM_OF = {name: room for room, names in _NAMES.items() for name in names}
_ROOMS = (
    *(
        "batch",
        "bridge",
        "camera",
        "checks",
        "contact",
        "correction",
        "errors",
        "evaluation",
        "forces",
        "hand",
        "live",
    ),
    *("messages", "objects", "observation", "recording", "rig", "se3", "search", "simulation", "tracking"),
    *("viewer", "vision"),
)
__all__ = sorted([*_ROOM_OF, "__version__"])


def __getattr__(name: str) -> _typing.Any:
    if name in _ROOMS:
        return _importlib.import_module(f"handsight.{name}")
    if name == "__version__":
        value: _typing.Any = _importlib.import_module("importlib.metadata").version("handsight")
    elif name in _ROOM_OF:
        value = getattr(_importlib.import_module(f"handsight.{_ROOM_OF[name]}"), name)
    else:
        old = {"PinholeCamera": "handsight.camera.Camera"}
        return _importlib.import_module("handsight._deprecated").renamed(__name__, old, stacklevel=3)(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_ROOMS})
