"""A grasp as a small JSON file beside its recording, and back."""

from pathlib import Path

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.errors import InvalidFile, InvalidInput
from handsight.files import read_bytes, write_errors
from handsight.simulation.grasp_search import GraspSearchResult
from handsight.simulation.motion import SERVOS, Grasp

LARGEST = 1_000_000
"""Of such a file [bytes]."""
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class _Form(msgspec.Struct, forbid_unknown_fields=True):
    """A `_Form` is what the file says: lengths in metres, angles in radians."""

    object: str
    """For people, as are the next four."""
    hold: str
    succeeded: bool = msgspec.field(name="held")
    trials: int
    failures: str
    position_palm: Three
    """Of the middle of the object's bounds, when the fingers begin to close."""
    quaternion_xyzw_palm: Four
    """Of the object's axes in the palm."""
    height: float
    """Of that middle above the table."""
    quaternion_xyzw_world: Four
    """Of the palm's axes in the world."""
    opening: dict[str, float]
    """Targets of the joints' servos at first; 0 for those not named."""
    closed: dict[str, float]


def _check_joints(form: _Form) -> None:
    for name, joints in (("opening", form.opening), ("closed", form.closed)):
        checks.finite(list(joints.values()), name, (len(joints),))
        if others := [joint for joint in joints if joint not in SERVOS]:
            raise InvalidInput(f"{name}: expected joints of the hand, got {others[0]}")


def write_grasp(found: GraspSearchResult, object: str, path: Path) -> None:
    """Writes a grasp that was found; raises NotWritten."""
    grasp = found.grasp
    form = _Form(
        object=object,
        hold=found.hold,
        succeeded=found.succeeded,
        trials=found.trials,
        failures=found.failures,
        position_palm=tuple(grasp.T_palm_middle[:3, 3].tolist()),
        quaternion_xyzw_palm=tuple(se3.quaternion_from_rotation(grasp.T_palm_middle[:3, :3]).tolist()),
        height=float(grasp.height),
        quaternion_xyzw_world=tuple(se3.quaternion_from_rotation(grasp.R_world_palm).tolist()),
        opening=dict(grasp.opening),
        closed=dict(grasp.closed),
    )
    with write_errors(path):
        path.write_bytes(msgspec.json.format(msgspec.json.encode(form), indent=1) + b"\n")


def read_grasp(path: Path) -> Grasp:
    """Returns the grasp of a file that `write_grasp` made; raises InvalidFile, which begins with the file's name."""
    try:
        form = msgspec.json.decode(read_bytes(path, LARGEST), type=_Form)
        T_palm_middle, R_world_palm = (
            se3.from_position_quaternion(
                checks.finite(position, name, (3,)), checks.unit(quaternion, f"quaternion_xyzw_{frame}", (4,))
            )
            for name, position, quaternion, frame in (
                ("position_palm", form.position_palm, form.quaternion_xyzw_palm, "palm"),
                ("", (0.0, 0.0, 0.0), form.quaternion_xyzw_world, "world"),
            )
        )
        _check_joints(form)
        height = checks.positive(form.height, "height")
    except (msgspec.DecodeError, InvalidInput) as error:
        raise InvalidFile(f"{path}: {error}") from None
    if not np.abs(T_palm_middle[:3, 3]).max() < 1:
        raise InvalidFile(f"{path}: position_palm: expected less than a metre, got {form.position_palm}")
    return Grasp(
        T_palm_middle=T_palm_middle,
        opening=form.opening,
        closed=form.closed,
        height=float(height),
        R_world_palm=R_world_palm[:3, :3],
    )
